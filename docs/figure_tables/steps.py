"""Stable steps, coverage of bounds, and the force of organs of real-time spacing."""

from __future__ import annotations

from statistics import mean, median

from figure_tables.cells import Row, block, markdown, percent, signed, significant, span


@block("stable_step", command="python validation/stable_step.py")
def stable_step_limits(found: Row) -> str:
    """Return what limits the stable step of four bodies."""
    lines = [
        [
            f"{row['body']}, {row['nodes']:,} nodes", f"{row['largest_step']:.2f}",
            f"{row['share_of_four']:.0%}, {row['mass_of_four']:.2f}".replace("%", " %"),
        ]
        for row in found["limits"]
    ]  # fmt: skip
    heads = [
        "body", "largest stable step over that of runs",
        "four fastest nodes: share of the vibration, mass over the median",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("stable_step", command="python validation/stable_step.py --filled")
def stable_step_filled(found: Row) -> str:
    """Return the stable steps of filled bodies with transfers of weight, over those without."""
    lines = []
    for body in dict.fromkeys(row["body"].split(", ")[0] for row in found["filled"]):
        rows = [row for row in found["filled"] if row["body"].split(", ")[0] == body]
        lines.append([
            body, span((row["nodes"] for row in rows), lambda nodes: f"{nodes:,}"),
            span((row["steps"][1] / row["steps"][0] for row in rows), lambda ratio: f"{ratio:.2f}"),
            span((row["frequency_change"] for row in rows), lambda change: signed(change, 2)),
            span((row["displacement_change"] for row in rows), lambda change: signed(change, 2)),
        ])  # fmt: skip
    return markdown(["body", "nodes", "step over that without", "first frequency", "displacement"], lines)


@block("mass_tailoring", command="python validation/mass_tailoring.py")
def mass_tailoring(found: list[Row]) -> str:
    """Return what more mass for the fastest modes changes."""
    lines = [
        [
            row["body"], f"{row['nodes']:,}", str(row["modes"]), *(f"{step:.2f}" for step in row["steps"]),
            f"{100 * row['frequency_change']:.4f} %", f"{row['force_change']:.0e}", f"{max(row['energies']):.3f}",
        ]
        for row in found
    ]  # fmt: skip
    heads = [
        "body", "nodes", "modes", "step, over that without", "at strains to 0.3", "to 0.6",
        "40 lowest frequencies, largest change", "force at rest, change", "energy of a free vibration over its first",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("bounds", command="python validation/bounds.py")
def bounds(rows: list[Row]) -> str:
    """Return how many further runs keep their error bounds, and how wide these are, over the models of a body."""
    lines = []
    for body, runs in dict.fromkeys((_kind_of_body(row), row["held out"]) for row in rows):
        some = [row for row in rows if (_kind_of_body(row), row["held out"]) == (body, runs)]
        lines.append([
            body, str(len({row["modes"] for row in some})), str(runs),
            span((row["kept"] for row in some), lambda share: f"{100 * share:.1f}"),
            span((row["unknown"] for row in some), lambda share: f"{100 * share:.0f}"),
            span((row["error"] for row in some), lambda share: significant(100 * share)),
            span((row["bound over error"] for row in some), lambda ratio: f"{ratio:.1f}"),
            span((row["rank of runs"] for row in some), lambda rank: f"{rank:.2f}"),
        ])  # fmt: skip
    lines.append(["mean of all", "", "", f"{100 * mean(row['kept'] for row in rows):.1f}", "", "", "", ""])
    heads = [
        "body", "models", "held-out runs", "runs kept [%]", "unknown [%]", "median largest error of a run [%]",
        "largest bound over largest error", "rank correlation of runs",
    ]  # fmt: skip
    return markdown(heads, lines)


def _kind_of_body(row: Row) -> str:
    """Return the name of a body without its spacing."""
    return row["body"].split(", ")[0] if row["body"].endswith("mm") else row["body"]


@block("hand", command="python validation/hand.py --keep")
def under_a_hand(rows: list[Row]) -> str:
    """Return how long forces under a hand have a bound, and in how many paths the full body's force is in it."""
    lines = [
        [f"{row['body']}, {row['nodes']:,} nodes", *_hand_cells(row["rows"]), f"{100 * row['level']:.0f} %"]
        for row in rows
    ]
    lines.append(["all", *_hand_cells([path for row in rows for path in row["rows"]]), ""])
    heads = [
        "body", "time with a bound", "paths that keep it", "largest force; mean bound; largest error [N]",
        "stated level",
    ]  # fmt: skip
    return markdown(heads, lines)


def hand_shares(paths: list[Row]) -> tuple[float, float, int, int]:
    """Return the time in contact [s], the share of it with a bound, and the paths that keep it, of how many."""
    touched = [path for path in paths if path["in_contact"] > 0]
    seconds = sum(path["in_contact"] for path in touched)
    known = sum(path["in_contact"] * path["known"] for path in touched) / seconds
    return seconds, known, sum(path["over_bound"] <= 1.0 for path in touched), len(touched)


def _hand_cells(paths: list[Row]) -> list[str]:
    """Return the cells of some paths under a hand."""
    _, known, kept, count = hand_shares(paths)
    bounds = [path["mean_bound"] for path in paths if path["mean_bound"] is not None]
    force, error = (max(path[name] for path in paths) for name in ("largest_force", "largest_error"))
    newtons = "; ".join(significant(value) for value in (force, mean(bounds), error))
    return [f"{100 * known:.1f} %", f"{kept} of {count}", newtons]


def _shares(row: Row, name: str) -> str:
    """Return the share of runs that keep their bounds, and that of runs whose bounds are unknown."""
    kept, known = row[name]
    return f"{100 * kept:.1f} %; {100 * (1 - known):.0f} %"


@block("two_tools", command="python validation/two_tools.py")
def two_tools_bounds(rows: list[Row]) -> str:
    """Return how many runs with one tool and with two keep their error bounds, of models trained on one."""
    names = ("two by one, not counted", "one by both", "two by both")
    lines = [
        [
            f"{row['organ']}, {row['nodes']:,} nodes", of, *(_shares(row[of], name) for name in names),
            f"{row[of]['widening']:.1f}",
        ]
        for row in rows if row["training"] == "one tool"
        for of in ("force", "displacement")
    ]  # fmt: skip
    heads = [
        "organ", "error of", "two tools, bound of one, not counted: kept; unknown", "one, bound of both",
        "two, bound of both", "widening for one tool",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("two_tools", command="python validation/two_tools.py")
def two_tools_errors(rows: list[Row]) -> str:
    """Return the errors of forces and surface on runs with one tool and with two."""
    names = ("force", "force_95", "surface_95", "worst force_95")
    lines = [
        [
            row["organ"], row["training"],
            *("; ".join(significant(100 * row[kind][name]) for kind in ("one tool", "two tools")) for name in names),
        ]
        for row in rows
    ]  # fmt: skip
    heads = [
        "organ", "trained on", "force [%], median: one tool; two", "95th percentile", "surface, 95th percentile",
        "force, 95th percentile of the worst run",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("blind", command="python validation/blind.py")
def blind(found: Row) -> str:
    """Return how often an error indicator below 1 hides a large error."""
    lines = [
        [
            row["kind"], str(row["runs"]), f"{percent(row['error'])}; {percent(row['largest_error'])}",
            str(row["trusted"]), percent(row["hidden"]), str(row["blind"]),
        ]
        for part in ("organ", "bodies")
        for row in found.get(part, [])
    ]  # fmt: skip
    heads = [
        "runs", "number", "error, median; largest", "trusted throughout", "largest error below a number of 1",
        "blind",
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
            ", ".join(significant(force, 3) for force in (coarse, fine)), signed(coarse / fine - 1),
        ])  # fmt: skip
    errors = [abs(row["force"][0] / row["force"][1] - 1) for row in rows]
    lines.append(["median; largest", "", "", "", f"{100 * median(errors):.1f}; {100 * max(errors):.1f} %"])
    heads = ["organ", "nodes", "radius of the ball, depth [mm]", "force [N]", "error"]
    return markdown(heads, lines)
