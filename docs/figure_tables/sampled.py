"""Sampled models on motions that they were not trained on."""

from __future__ import annotations

import math

from figure_tables.cells import ERRORS, Row, block, markdown, percent, significant


def _errors(found: Row, statistic: str) -> str:
    return " / ".join(significant(100 * found[kind][statistic], 2) for kind in ERRORS)


@block("held_out", command="python validation/held_out.py accuracy")
def held_out_accuracy(studies: Row) -> str:
    """Return the errors of sampled models on motions that they were not trained on, 95th percentile."""
    lines = []
    for row in studies["accuracy"]:
        sets = [_errors(row["sets"][name], "percentile_95") for name in ("inside", "outside", "buckling")]
        lines.append([str(row["modes"]), str(row["report"]["nodes"]), *sets])
    nodes = studies["accuracy"][0]["report"]["nodes_full"]
    return markdown(["modes", f"nodes of {nodes:,}", "inside", "outside", "buckling"], lines)


@block("held_out", command="python validation/held_out.py accuracy")
def held_out_medians(studies: Row) -> str:
    """Return the median errors on motions inside, and the errors over a whole run."""
    lines = []
    for row in studies["accuracy"]:
        inside = row["sets"]["inside"]
        over = [significant(100 * inside[f"{kind}_rms"]["percentile_95"], 2) for kind in ("displacement", "velocity")]
        failed = sum(each["failed"] for each in row["sets"].values())
        runs = sum(each["runs"] for each in row["sets"].values())
        lines.append([str(row["modes"]), _errors(inside, "median"), " / ".join(over), f"{failed} of {runs}"])
    return markdown(["modes", "median, inside", "whole run, 95th percentile: displacement / velocity", "failed"], lines)


@block("held_out", command="python validation/held_out.py trust")
def held_out_trust(studies: Row) -> str:
    """Return Spearman's correlation of the error with the distance, the residual norm and the error indicator."""
    names = ("distance", "residual norm", "trust")
    columns = [("all", "so_far"), ("all", "now"), ("all", "of_runs")]
    columns += [(name, "so_far") for name in ("inside", "outside", "buckling")]
    lines = []
    for row in studies["trust"]:
        cells = [" / ".join(f"{row[of][f'{name}_{when}']:.2f}" for name in names) for of, when in columns]
        lines.append([str(row["modes"]), *cells])
    heads = [
        "modes", "all 20 runs, number so far", "number of the moment", "largest number and error of each run",
        "inside, so far", "outside, so far", "buckling, so far",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("held_out", command="python validation/held_out.py stability")
def held_out_stability(studies: Row) -> str:
    """Return failures and the worst balance of energy by number of modes and step rule."""
    lines = []
    for row in studies["stability"]:
        cells = [
            f"{row[rule]['failed']} of {row[rule]['runs']}; {percent(row[rule]['worst_balance'], 1)}"
            for rule in ("explicit", "implicit")
        ]
        lines.append([str(row["modes"]), str(row["nodes"]), *cells])
    heads = [
        "modes",
        "nodes",
        "explicit: failed; largest miss of the balance over the work",
        "implicit, 1 ms: the same",
    ]
    return markdown(heads, lines)


@block("held_out", command="python validation/held_out.py stepping", timed=True)
def held_out_stepping(studies: Row) -> str:
    """Return the cost and the errors of steps."""
    lines = [
        [
            str(row["modes"]), row["rule"], f"{significant(1e3 * row['step'])} ms", significant(row["seconds"]),
            percent(row["velocity_error"]), percent(row["displacement_error"]),
        ]
        for row in studies["stepping"]["cost"]
    ]  # fmt: skip
    heads = ["modes", "rule", "step", "seconds", "velocity error of the steps", "displacement error"]
    return markdown(heads, lines)


@block("held_out", command="python validation/held_out.py enrichment")
def held_out_enrichment(studies: Row) -> str:
    """Return the errors of bases of 32 fields on motions inside."""
    lines = [[row["basis"], _errors(row["inside"], "percentile_95")] for row in studies["enrichment"]]
    return markdown(["basis", "inside"], lines)


@block("held_out", command="python validation/held_out.py sampling")
def held_out_sampling(studies: Row) -> str:
    """Return the displacement errors of other samplings."""
    kinds = ("sampled energy", "all nodes", "plain force sampling", "Q-DEIM")
    lines = []
    for row in studies["sampling"]:
        cells = [percent(row[kind]) if math.isfinite(row[kind]) else "diverged" for kind in kinds]
        motion = "trained" if row["run"].startswith("train") else "inside"
        lines.append([f"{row['modes']}, {row['nodes']}", motion, *cells])
    heads = ["modes, nodes", "motion", "sampled energy", "all nodes", "nodal forces, positive weights", "Q-DEIM"]
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
