"""Full bodies against quadratic finite elements."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, markdown, percent, signed

QUANTITIES = ("frequencies", "sag", "patch", "smooth")


def _cell(row: Row, quantity: str) -> str:
    errors = row.get(quantity, [])
    return " / ".join(signed(each, unit="") for each in errors) or "–"


@block("elements", command="python validation/elements.py")
def elements_linear(rows: list[Row]) -> str:
    """Return the errors of linear responses in per cent, of each case, spacing and seed."""
    lines = [
        [row["case"], f"{row['nodes']:,}", str(row["seed"]), *(_cell(row, quantity) for quantity in QUANTITIES)]
        for row in rows
    ]
    return markdown(["body", "nodes", "seed", *QUANTITIES], lines)


@block("elements", command="python validation/elements.py")
def elements_balls(rows: list[Row]) -> str:
    """Return the errors of a ball's force in per cent, over its depth."""
    lines = []
    for row in rows:
        for ball in row["balls"]:
            errors = " / ".join("refused" if each is None else signed(each, unit="") for each in ball["errors"])
            depths = " / ".join(f"{1e3 * depth:.3g}" for depth in ball["depths"])
            lines.append([row["case"], f"{row['nodes']:,}", str(row["seed"]), f"{ball['radius']:.2f}", depths, errors])
    return markdown(["body", "nodes", "seed", "radius over spacing", "depths [mm]", "errors of the force"], lines)


@block("patches", command="python validation/patches.py --keep")
def elements_patches(rows: list[Row]) -> str:
    """Return the errors of a small tool's force in per cent: means and standard deviations, by both fits."""
    plain = {(row["body"], row["radius"]): row for row in rows if row["fits"] == "flat"}
    lines = []
    for row in rows:
        if row["fits"] == "curved":
            both = [_scattered(row), _scattered(plain[row["body"], row["radius"]])]
            lines.append([row["body"], f"{row['radius']:g}", str(row["count"]), *both])
    return markdown(["body", "tool", "places", "errors of the force", "with plain fits"], lines)


def _scattered(row: Row) -> str:
    pairs = zip(row["errors"], row["deviations"], strict=True)
    return " / ".join(f"{signed(mean, unit='')} ± {100 * deviation:.1f}" for mean, deviation in pairs)


@block("elements_truth", command="python validation/elements.py --truth")
def elements_truth(truth: Row) -> str:
    """Return the finite-element responses with their changes from a coarser mesh."""
    lines = []
    for name, case in truth["cases"].items():
        cells = [percent(case[quantity]["error"]) if quantity in case else "–" for quantity in QUANTITIES]
        nodes = max((mesh["nodes"] for mesh in case.get("meshes", [])), default=0)
        lines.append([name, f"{nodes:,}", *cells])
    return markdown(["body", "nodes of Tet10", *QUANTITIES], lines)
