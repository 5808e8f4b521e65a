"""Contact."""

from __future__ import annotations

import math
from statistics import mean, median

from figure_tables.cells import Row, block, find, markdown, millimetres, percent, signed, significant


@block("contact", command="python validation/contact.py")
def contact_ball(rows: list[Row]) -> str:
    """Return the error of the force on a ball against finite elements."""
    columns = [
        ("energy, 3 mm", "energy", 0.003, False, 0.0), ("aside", "energy", 0.003, False, 0.5),
        ("filled", "energy", 0.003, True, 0.0), ("energy, 2 mm", "energy", 0.002, False, 0.0),
        ("aside", "energy", 0.002, False, 0.5), ("filled", "energy", 0.002, True, 0.0),
        ("strong, 3 mm", "strong", 0.003, False, 0.0), ("strong, 2 mm", "strong", 0.002, False, 0.0),
    ]  # fmt: skip
    radius = 0.02
    lines = []
    for exact in [row for row in rows if row["tool"] == "ball" and row["form"] == "finite elements"]:
        depth = exact["depth"]
        contact_radius = math.sqrt(radius * depth) / 0.002
        cells = []
        for _, form, spacing, filled, shift in columns:
            found = find(rows, tool="ball", form=form, spacing=spacing, filled=filled, shift=shift, depth=depth)
            cells.append(signed(found["force"] / exact["force"] - 1))
        lines.append([f"{100 * depth / radius:.0f} % ({contact_radius:.1f})", *cells])
    return markdown(["indentation, of the radius", *(column[0] for column in columns)], lines)


@block("contact", command="python validation/contact.py --tools punch --spacings 0.003")
def contact_punch(rows: list[Row]) -> str:
    """Return the error of the force on a flat punch against finite elements."""
    punch = [row for row in rows if row["tool"] == "punch"]
    exact = next(row for row in punch if row["form"] == "finite elements")
    lines = [
        [
            f"{row['form']}, {millimetres(row['spacing'])}",
            "filled" if row["filled"] else "between nodes" if row["shift"] else "over a node",
            millimetres(row["depth"]), signed(row["force"] / exact["force"] - 1),
        ]
        for row in punch if row is not exact
    ]  # fmt: skip
    return markdown(["form, spacing", "nodes under the punch", "depth", "error of the force"], lines)


@block("contact", command="python validation/contact.py --tools ball")
def contact_noise(rows: list[Row]) -> str:
    """Return the noise of the force and the gap in the balance of energy."""
    columns = [("energy", 0.003), ("energy", 0.002), ("strong", 0.003), ("strong", 0.002)]
    found = [find(rows, tool="ball", form=form, spacing=h, filled=False, shift=0.0) for form, h in columns]
    lines = [
        ["noise of the force at 1 kHz, of the largest force", *(percent(row["noise"], 1) for row in found)],
        ["largest gap in the balance of energy, of the tool's work", *(percent(row["balance"]) for row in found)],
    ]
    return markdown(["what", *(f"{form}, {millimetres(h)}" for form, h in columns)], lines)


@block("contact", command="python validation/contact.py --tools --spacings --overhead", timed=True)
def contact_overhead(rows: list[Row]) -> str:
    """Return what a ball adds to a step."""
    row = find(rows, tool="overhead")
    cells = [
        f"{row['nodes']:,}", f"{row['surface']:,}", str(row["touching"]), f"{row['step_ms']:.2f} ms",
        f"{1e3 * row['contact_ms']:.0f} µs", percent(row["share"]),
    ]  # fmt: skip
    return markdown(["nodes", "of the surface", "pushed", "step", "the ball adds", "share of the step"], [cells])


@block("squeeze", command="python validation/squeeze.py")
def two_balls(rows: list[Row]) -> str:
    """Return the forces on two balls that squeeze a block, and their error against finite elements."""
    lines = [
        [
            millimetres(row["depth"]), millimetres(row["spacing"]), *(f"{force:.4f} N" for force in row["forces"]),
            f"{row['elements']:.4f} N", signed(row["error"]),
        ]
        for row in rows
    ]  # fmt: skip
    return markdown(["depth of each", "spacing", "first ball", "second ball", "finite elements", "error"], lines)


PRESS_NAMES = {
    "force": "force on the tool against the full model's of the moment, median",
    "force_95": "the same, 95th percentile",
    "surface_95": "surface displacement against the largest, 95th percentile of nodes and frames",
    "farthest_95": "the same of the farthest node",
}


@block("presses", command="python validation/presses.py out/train")
def presses(entries: list[Row]) -> str:
    """Return the errors of a reduced liver on presses and grasps that it was not trained on."""
    rows = entries[-1]["presses"]
    kinds = {kind: [row for row in rows if row["kind"] == kind] for kind in ("press", "grasp")}
    lines = []
    for name, words in PRESS_NAMES.items():
        cells = []
        for own in kinds.values():
            values = [100 * row[name] for row in own]
            cells.append("; ".join(significant(value(values)) for value in (mean, median, max)) + " %")
        lines.append([words, *cells, percent(mean(row[name] for row in rows))])
    counts = [f"{len(kinds['press'])} presses", f"{len(kinds['grasp'])} grasps"]
    return markdown(["", *(f"{count}: mean; median; worst" for count in counts), "mean of all"], lines)


@block("presses", command="python validation/presses.py out/train")
def presses_kept(entries: list[Row]) -> str:
    """Return how many held-out paths keep each aim."""
    aims = {"force": 0.05, "force_95": 0.1, "surface_95": 0.05}
    rows = entries[-1]["presses"]
    lines = []
    for name, aim in aims.items():
        cells = []
        for kind in ("press", "grasp"):
            own = [row for row in rows if row["kind"] == kind]
            cells.append(f"{sum(row[name] < aim for row in own)} of {len(own)}")
        lines.append([PRESS_NAMES[name], percent(aim, 1), *cells])
    return markdown(["error", "aim", "presses that keep it", "grasps that keep it"], lines)
