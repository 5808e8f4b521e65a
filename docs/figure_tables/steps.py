"""Stable steps, coverage of bounds, and the force of organs of real-time spacing."""

from __future__ import annotations

import math
from statistics import mean, median

from figure_tables.cells import Row, block, markdown, percent, signed, significant


@block("stable_step", command="python validation/stable_step.py")
def stable_step_limits(found: Row) -> str:
    """Return what limits the stable step of four bodies."""
    lines = [
        [
            f"{row['body']}, {row['nodes']:,} nodes", f"{row['frequency_over_wave']:.2f}",
            f"{row['share_of_four']:.0%}, {row['mass_of_four']:.2f}".replace("%", " %"),
            f"{row['largest_step']:.2f}", f"{row['step_with_least_mass']['0.25']:.2f}",
        ]
        for row in found["limits"]
    ]  # fmt: skip
    heads = [
        "body", "highest frequency, over that of a wave of two spacings",
        "four fastest nodes: share of the vibration, mass over the median", "largest stable step over that of runs",
        "step with masses of at least a quarter of the median, over the step",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("stable_step", command="python validation/stable_step.py --filled")
def stable_step_filled(found: Row) -> str:
    """Return the stable steps of filled bodies without and with transfers of weight."""
    lines = [
        [
            row["body"], f"{row['nodes']:,}", *(f"{1e6 * step:.0f}" for step in row["steps"]),
            f"{row['steps'][1] / row['steps'][0]:.2f}", signed(row["frequency_change"], 2),
            signed(row["displacement_change"], 2),
        ]
        for row in found["filled"]
    ]  # fmt: skip
    heads = [
        "body", "nodes", "step without transfers [µs]", "with [µs]", "ratio", "first frequency", "displacement",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("mass_tailoring", command="python validation/mass_tailoring.py")
def mass_tailoring(found: list[Row]) -> str:
    """Return what more mass for the fastest modes changes."""
    lines = [
        [
            row["body"], f"{row['nodes']:,}", str(row["modes"]), f"{row['nodes_of_shape']:.0f}",
            *(f"{step:.2f}" for step in row["steps"]), f"{100 * row['frequency_change']:.4f} %",
            f"{row['force_change']:.0e}, {row['displacement_change']:.0e}",
            ", ".join(f"{energy:.3f}" for energy in row["energies"]),
        ]
        for row in found
    ]  # fmt: skip
    heads = [
        "body", "nodes", "modes", "nodes of a shape", "step, over that without", "at strains to 0.3", "to 0.6",
        "40 lowest frequencies, largest change", "pressed and at rest: change of force, of displacements",
        "largest energy of a free vibration over its first, in means over 0.1 s: without, with",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("bounds", command="python validation/bounds.py")
def bounds(rows: list[Row]) -> str:
    """Return how many further runs keep their error bounds, and how wide these are."""
    lines = [
        [
            row["body"], str(row["modes"]), row["of"], str(row["held out"]), f"{100 * row['kept']:.1f} %",
            f"{100 * row['unknown']:.1f} %", f"{100 * row['least level']:.0f} %, {100 * row['campaigns']:.0f} %",
            percent(row["error"]), f"{row['bound over error']:.1f}",
            f"{row['rank of runs']:.2f}, {row['rank of frames']:.2f}",
        ]
        for row in rows
    ]  # fmt: skip
    lines.append(["mean of all", "", "", "", f"{100 * mean(row['kept'] for row in rows):.1f} %", "", "", "", "", ""])
    heads = [
        "body", "modes", "error of", "held-out runs", "runs kept", "unknown",
        "level with 90 % confidence, campaigns that keep it", "median largest error of a run",
        "largest bound over largest error", "rank correlation: runs, frames",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("hand", command="python validation/hand.py --keep")
def under_a_hand(rows: list[Row]) -> str:
    """Return how long forces under a hand have a bound, and in how many paths the full body's force is in it."""
    paths = [path for row in rows for path in row["rows"]]
    groups = {f"{row['body']}, {row['nodes']:,} nodes": row["rows"] for row in rows}
    groups |= {f"all: {kind}": [path for path in paths if path["kind"] == kind] for kind in hand_kinds(rows)}
    levels = [f"{100 * row['level']:.0f} %" for row in rows] + [""] * (len(groups) - len(rows))
    lines = [[name, *_hand_cells(each), level] for (name, each), level in zip(groups.items(), levels, strict=True)]
    lines.append(["all", *_hand_cells(paths), ""])
    heads = [
        "body, or kind of path", "time in contact", "with a bound", "paths that keep it", "largest force",
        "mean bound", "largest error", "stated level",
    ]  # fmt: skip
    return markdown(heads, lines)


def hand_kinds(rows: list[Row]) -> list[str]:
    """Return the kinds of paths under a hand, in their order."""
    return list(dict.fromkeys(path["kind"] for row in rows for path in row["rows"]))


def hand_shares(paths: list[Row]) -> tuple[float, float, int, int]:
    """Return the time in contact [s], the share of it with a bound, and the paths that keep it, of how many."""
    touched = [path for path in paths if path["in_contact"] > 0]
    seconds = sum(path["in_contact"] for path in touched)
    known = sum(path["in_contact"] * path["known"] for path in touched) / seconds
    return seconds, known, sum(path["over_bound"] <= 1.0 for path in touched), len(touched)


def _hand_cells(paths: list[Row]) -> list[str]:
    """Return the cells of some paths under a hand."""
    seconds, known, kept, count = hand_shares(paths)
    bounds = [path["mean_bound"] for path in paths if path["mean_bound"] is not None]
    largest = [max(path[name] for path in paths) for name in ("largest_force", "largest_error")]
    return [
        f"{seconds:.0f} s", f"{100 * known:.1f} %", f"{kept} of {count}", f"{significant(largest[0])} N",
        f"{significant(mean(bounds))} N", f"{significant(largest[1])} N",
    ]  # fmt: skip


def _shares(row: Row, name: str) -> str:
    """Return the share of runs that keep their bounds, and that of runs whose bounds are unknown."""
    kept, known = row[name]
    return f"{100 * kept:.1f} %; {100 * (1 - known):.0f} %"


@block("two_tools", command="python validation/two_tools.py")
def two_tools_bounds(rows: list[Row]) -> str:
    """Return how many runs with one tool and with two keep their error bounds."""
    names = ("one by one", "two by one, not counted", "two by one", "one by both", "two by both")
    lines = [
        [
            f"{row['organ']}, {row['nodes']:,} nodes", row["training"], of,
            *(_shares(row[of], name) for name in names), f"{row[of]['widening']:.1f}",
        ]
        for row in rows
        for of in ("force", "displacement")
    ]  # fmt: skip
    heads = [
        "organ", "trained on", "error of", "one tool, calibrated with one: kept; unknown",
        "two, with one, if tools were not counted", "two, with one", "one, with both", "two, with both",
        "bounds of runs with one tool, with both over with one",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("two_tools", command="python validation/two_tools.py")
def two_tools_errors(rows: list[Row]) -> str:
    """Return the errors of forces and surface on runs with one tool and with two."""
    names = ("force", "force_95", "surface_95", "farthest_95", "worst force_95")
    lines = [
        [
            row["organ"], row["training"], str(row["sampled nodes"]),
            *("; ".join(percent(row[kind][name]) for kind in ("one tool", "two tools")) for name in names),
        ]
        for row in rows
    ]  # fmt: skip
    heads = [
        "organ", "trained on", "sampled nodes", "force, median: one tool; two", "force, 95th percentile",
        "surface, 95th percentile", "farthest node, 95th percentile", "force, 95th percentile of the worst run",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("blind", command="python validation/blind.py")
def blind(found: Row) -> str:
    """Return how often an error indicator below 1 hides a large error."""
    lines = [
        [
            row["kind"], str(row["runs"]), f"{percent(row['error'])}; {percent(row['largest_error'])}",
            str(row["large"]), str(row["trusted"]), percent(row["hidden"]), str(row["blind"]),
        ]
        for part in ("organ", "bodies")
        for row in found.get(part, [])
    ]  # fmt: skip
    heads = [
        "runs", "number", "error, median; largest", "that err by 30 %", "trusted throughout",
        "largest error below a number of 1", "blind",
    ]  # fmt: skip
    return markdown(heads, lines)


@block(
    "greedy",
    command="python validation/greedy.py --scene liver --set spacing=0.012 radius=0.026 --held-out 28 --modes 32 "
    "--workers 1 --out out/greedy/liver",
)
def chosen_paths_of_liver(found: Row) -> str:
    """Return the errors of models of a liver trained on chosen and on random paths."""
    lines = [
        [
            str(row["runs"]),
            *(
                f"{percent(row['chosen'][name])}; {percent(row['random'][name])}"
                for name in ("force", "force_95", "surface_95", "largest")
            ),
        ]
        for row in found["liver"]["rows"]
    ]
    heads = [
        "training runs", "force, median: chosen; random", "force, 95th percentile", "surface, 95th percentile",
        "force, worst run",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("spacing_force", command="python validation/spacing_force.py")
def organ_force(rows: list[Row]) -> str:
    """Return the force of a ball on livers of real-time spacing next to that on finer ones."""
    lines = []
    for row in rows:
        (coarse, fine), ball = row["force"], (1e3 * row["radius"], 1e3 * row["depth"])
        lines.append([
            row["organ"], ", ".join(f"{nodes:,}" for nodes in row["nodes"]),
            ", ".join(significant(length, 3) for length in ball),
            f"{math.sqrt(row['radius'] * row['depth']) / row['spacing']:.1f}",
            ", ".join(significant(force, 3) for force in (coarse, fine)), signed(coarse / fine - 1),
            ", ".join(signed(drift) for drift in row["drift"]),
        ])  # fmt: skip
    errors = [abs(row["force"][0] / row["force"][1] - 1) for row in rows]
    lines.append(["median; largest", "", "", "", "", f"{100 * median(errors):.1f}; {100 * max(errors):.1f} %", ""])
    heads = [
        "organ", "nodes", "radius of the ball, depth [mm]", "contact radius / spacing", "force [N]", "error", "drift",
    ]  # fmt: skip
    return markdown(heads, lines)
