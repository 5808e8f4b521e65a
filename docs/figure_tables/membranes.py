"""Frequencies, deflections and layouts of membranes."""

from __future__ import annotations

from figure_tables.cells import Row, block, distinct, find, markdown, millimetres, percent, signed, significant

SHOWN_SIZES = (8, 20)  # numbers of modes
LAYOUTS = (("rings", 0.0), ("hexagonal", 0.0), ("rings", 0.1))


@block("membrane_reduction", command="python validation/membrane_reduction.py")
def membrane_lifting(rows: list[Row]) -> str:
    """Return the displacement error of reduced membranes with a fitted lifting function, and with the default."""
    sizes = [size for size in distinct((row["modes"] for row in rows), reverse=False) if size in SHOWN_SIZES]
    lines = []
    every = list(dict.fromkeys((row["training"], row["basis"]) for row in rows))
    for training, basis in (every[0], every[-1]):
        lifting, _, snapshots = training.partition(" lifting")
        push = [find(rows, then="hold", training=training, basis=basis, modes=size)["push"] for size in sizes]
        cells = [_displacements(push)]
        for then in ("hold", "return"):
            runs = [find(rows, then=then, training=training, basis=basis, modes=size) for size in sizes]
            if any(run is None for run in runs):
                cells.append("not run")
            else:
                after = [run["after"] for run in runs]
                cells.append(_displacements(after))
        lines.append([lifting, "relative" if snapshots else "as they are", basis, *cells])
    heads = ["lifting of the tool", "snapshots", "basis", "push", 'after "hold"', 'after "return"']
    return markdown(heads, lines)


def _displacements(errors: list[Row]) -> str:
    values = [error["displacement"] for error in errors]
    if all(error["energy"] > 10 for error in errors):
        return "energy too large"
    return "; ".join(percent(value)[:-2] for value in values) + " %"


@block("membranes", command="python validation/membranes.py frequencies")
def membrane_frequencies(studies: Row) -> str:
    """Return the largest error of the first four frequencies of a taut sheet."""
    lines = []
    for spacing in (0.01, 0.005):
        cells = []
        for layout, jitter in LAYOUTS:
            key = {"spacing": spacing, "layout": layout, "jitter": jitter}
            rows = [row for row in studies["frequencies"] if all(row[k] == v for k, v in key.items())]
            cells.append(percent(max(abs(error) for row in rows for error in row["errors"])))
        lines.append([millimetres(spacing), *cells])
    return markdown(["spacing", "rings", "triangular", "rings, jitter 0.1"], lines)


@block("membranes", command="python validation/membranes.py statics")
def membrane_pushed(studies: Row) -> str:
    """Return the errors of the tool's force on a pushed sheet."""
    rows = [row for row in studies["statics"] if row["case"] == "poke"]
    lines = []
    for prestretch, radius in dict.fromkeys((r["prestretch"], r["tool_radius"]) for r in rows):
        taut = f"{prestretch:g}" if prestretch > 1 else "none"
        cells = []
        for layout, jitter in LAYOUTS:
            key = {"prestretch": prestretch, "tool_radius": radius, "layout": layout, "jitter": jitter}
            pair = [find(rows, **key, spacing=spacing) for spacing in (0.005, 0.0025)]
            cells.append("; ".join(signed(row["force_error"], unit="") for row in pair))
        lines.append([f"{millimetres(radius)}, {taut}", *cells])
    heads = ["tool radius, prestretch", "rings, 5; 2.5 mm [%]", "triangular", "rings, jitter 0.1"]
    return markdown(heads, lines)


@block("membranes", command="python validation/membranes.py statics")
def membrane_inflated(studies: Row) -> str:
    """Return the error of the height of an inflated sheet."""
    rows = [row for row in studies["statics"] if row["case"] == "inflation"]
    lines = []
    for pressure in distinct((row["pressure"] for row in rows), reverse=False):
        exact = find(rows, pressure=pressure)
        height = 1e3 * exact["height"] / (1 + exact["height_error"])
        pairs = []
        for layout, jitter in LAYOUTS:
            key = {"pressure": pressure, "layout": layout, "jitter": jitter}
            pair = [find(rows, **key, spacing=spacing) for spacing in (0.005, 0.0025)]
            pairs.append("; ".join(signed(row["height_error"], 2, "") for row in pair))
        lines.append([f"{pressure:g} Pa ({height:.2f} mm)", *pairs])
    return markdown(["pressure (height)", "rings, 5; 2.5 mm [%]", "triangular", "rings, jitter 0.1"], lines)


@block("membranes", command="python validation/membranes.py stability")
def membrane_stability(studies: Row) -> str:
    """Return energies and balances of the runs of the sheet."""
    rows = studies["stability"]
    lines = []
    for spacing in distinct(row["spacing"] for row in rows):
        own = [row for row in rows if row["spacing"] == spacing]
        lines.append([
            millimetres(spacing), ", ".join(f"{n:,}" for n in distinct((r["nodes"] for r in own), reverse=False)),
            str(len(own)), percent(max(row["growth_after"] for row in own)),
            percent(max(row["miss_pushing"] for row in own)),
        ])  # fmt: skip
    heads = [
        "spacing", "nodes", "runs", "largest growth of energy after the tool's last motion",
        "largest miss of the balance while the tool pushes",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("axisymmetric", command="python validation/axisymmetric_table.py")
def axisymmetric(found: Row) -> str:
    """Return the range of the axisymmetric solutions, and their difference from finite elements along the meridian."""
    lines = []
    for kind, name, scale, unit in (("poke", "force", 1e3, "mN"), ("inflate", "height", 1e3, "mm")):
        rows = found[kind]
        values = [scale * row[name] for row in rows]
        lines.append([
            {"poke": "pushed by 10 mm", "inflate": "inflated"}[kind], str(len(rows)),
            f"{name}, {significant(min(values), 3)} to {significant(max(values), 3)} {unit}",
            f"{max(row['elements_difference'] for row in rows):.0e}",
        ])  # fmt: skip
    return markdown(["sheet", "cases", "solution", "largest difference from 400 finite elements"], lines)
