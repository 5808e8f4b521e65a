"""Full bodies against quadratic finite elements."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from statistics import median

from figure_tables.cells import Row, block, largest, markdown, percent, signed, span

QUANTITIES = ("frequencies", "sag", "patch", "smooth")


@block("elements", command="python validation/elements.py")
def elements_linear(rows: list[Row]) -> str:
    """Return the largest errors of linear responses in per cent over two seeds, by case and spacing."""
    lines = []
    for case in dict.fromkeys(row["case"] for row in rows):
        cells = []
        for quantity in QUANTITIES:
            sizes = []
            for scale in sorted({row["scale"] for row in rows}, reverse=True):
                own = [row for row in rows if row["case"] == case and row["scale"] == scale]
                errors = [error for row in own for error in row.get(quantity, [])]
                sizes.append(largest(errors) if errors else "–")
            cells.append("–" if set(sizes) == {"–"} else "; ".join(sizes))
        lines.append([case, *cells])
    return markdown(["body", "frequencies: 1,600; 3,000 nodes", *QUANTITIES[1:]], lines)


@block("elements", command="python validation/elements.py")
def elements_balls(rows: list[Row]) -> str:
    """Return the errors of a ball's force in per cent over bodies and seeds, by the ball's radius and depth."""
    every = [(row["case"], ball) for row in rows for ball in row["balls"]]
    lines = []
    for radius in sorted({round(ball["radius"], 2) for _, ball in every}):
        some = [(case, ball) for case, ball in every if round(ball["radius"], 2) == radius]
        first = [ball["errors"][0] for _, ball in some]
        deeper = [error for _, ball in some for error in ball["errors"][1:] if error is not None]
        cells = (f"{100 * median(map(abs, errors)):.1f}; {largest(errors)}" for errors in (first, deeper))
        lines.append([f"{radius:.2f}", str(len({case for case, _ in some})), *cells])
    heads = ["radius over spacing", "bodies", "least depth: median; largest", "deeper: median; largest"]
    return markdown(heads, lines)


@block("patches", command="python validation/patches.py --keep")
def elements_patches(rows: list[Row]) -> str:
    """Return the errors of a small tool's force in per cent: means and standard deviations over places and seeds."""
    curved = [row for row in rows if row["fits"] == "curved"]
    lines = [[row["body"], f"{row['radius']:g}", str(row["count"]), *_scattered(row)] for row in curved]
    depths = ("a quarter of the radius deep", "half", "one radius")
    return markdown(["body", "tool [spacings]", "places", *depths], lines)


def _scattered(row: Row) -> list[str]:
    pairs = zip(row["errors"], row["deviations"], strict=True)
    return [f"{signed(mean, unit='')} ± {100 * deviation:.1f}" for mean, deviation in pairs]


@block("elements_truth", command="python validation/elements.py --truth")
def elements_truth(truth: Row) -> str:
    """Return how far the finite-element responses on the finer mesh are from the extrapolated ones."""
    cases = truth["cases"].values()
    nodes = [max(mesh["nodes"] for mesh in case["meshes"]) for case in cases if case.get("meshes")]
    lines = [[f"{len(nodes)}", span(nodes, lambda count: f"{count:,}")]]
    for quantity in QUANTITIES:
        changes = [case[quantity]["error"] for case in cases if quantity in case]
        lines[0].append("; ".join(percent(value) for value in (median(changes), max(changes))))
    return markdown(["cases", "nodes of Tet10", "frequencies, median; largest", *QUANTITIES[1:]], lines)
