"""Sampled models on motions that they were not trained on."""

from __future__ import annotations

import math

from figure_tables.cells import ERRORS, Row, block, markdown, percent, significant

SHOWN_SIZES = (8, 16, 32, 64, 96)  # numbers of modes


def _errors(found: Row, statistic: str) -> str:
    return "; ".join(significant(100 * found[kind][statistic], 2) for kind in ERRORS)


@block("held_out", command="python validation/held_out.py accuracy")
def held_out_accuracy(studies: Row) -> str:
    """Return the errors of sampled models on motions that they were not trained on, median and 95th percentile."""
    lines = []
    for row in (each for each in studies["accuracy"] if each["modes"] in SHOWN_SIZES):
        sets = [_errors(row["sets"][name], "percentile_95") for name in ("inside", "outside", "buckling")]
        median = _errors(row["sets"]["inside"], "median")
        lines.append([str(row["modes"]), str(row["report"]["nodes"]), median, *sets])
    nodes = studies["accuracy"][0]["report"]["nodes_full"]
    return markdown(["modes", f"nodes of {nodes:,}", "inside, median", "inside", "outside", "buckling"], lines)


@block("held_out", command="python validation/held_out.py stability")
def held_out_stability(studies: Row) -> str:
    """Return failures and the worst balance of energy by step rule, over all numbers of modes."""
    rows = studies["stability"]
    lines = [
        [
            name, f"{rows[0]['modes']} to {rows[-1]['modes']}", str(sum(row[rule]["runs"] for row in rows)),
            str(sum(row[rule]["failed"] for row in rows)), percent(max(row[rule]["worst_balance"] for row in rows), 1),
        ]
        for rule, name in (("explicit", "explicit"), ("implicit", "implicit, 1 ms"))
    ]  # fmt: skip
    return markdown(["steps", "modes", "runs", "diverged", "largest miss of the balance over the work"], lines)


@block("held_out", command="python validation/held_out.py sampling")
def held_out_sampling(studies: Row) -> str:
    """Return the displacement errors of other samplings."""
    kinds = ("sampled energy", "all nodes", "plain force sampling", "Q-DEIM")
    lines = []
    for row in (each for each in studies["sampling"] if not each["run"].startswith("train")):
        cells = [percent(row[kind]) if math.isfinite(row[kind]) else "diverged" for kind in kinds]
        lines.append([f"{row['modes']}, {row['nodes']}", *cells])
    heads = ["modes, nodes", "sampled energy", "all nodes", "nodal forces, positive weights", "Q-DEIM"]
    return markdown(heads, lines)


@block("large_training", command="python validation/large_training.py", timed=True)
def large_training(rows: list[Row]) -> str:
    """Return time and memory of a training at many nodes."""
    lines = [
        [
            f"{row['nodes']:,}", str(row["modes"]), f"{row['seconds']:.0f} s", f"{row['gigabytes']:.1f} GB",
            f"{row['gigabytes_before']:.1f} GB", str(row["sampled"]),
        ]
        for row in rows
    ]  # fmt: skip
    return markdown(["nodes", "modes", "time", "peak memory", "of it before the training", "sampled nodes"], lines)
