"""Frequencies, deflections and layouts of membranes."""

from __future__ import annotations

from figure_tables.cells import Row, block, distinct, find, markdown, millimetres, percent, signed

LAYOUTS = (("rings", 0.0), ("hexagonal", 0.0), ("rings", 0.1))


@block("membrane_reduction", command="python validation/membrane_reduction.py")
def membrane_lifting(rows: list[Row]) -> str:
    """Return the displacement error of reduced membranes by lifting, snapshots and basis."""
    sizes = distinct((row["modes"] for row in rows), reverse=False)
    lines = []
    for training, basis in dict.fromkeys((row["training"], row["basis"]) for row in rows):
        lifting, _, snapshots = training.partition(" lifting")
        push = [find(rows, then="hold", training=training, basis=basis, modes=size)["push"] for size in sizes]
        cells = [_displacements(push)]
        for then in ("hold", "release", "return"):
            runs = [find(rows, then=then, training=training, basis=basis, modes=size) for size in sizes]
            if any(run is None for run in runs):
                cells.append("not run")
            else:
                after = [run["after"] for run in runs]
                cells.append(_displacements(after))
        lines.append([lifting, "relative" if snapshots else "as they are", basis, *cells])
    heads = ["lifting of the tool", "snapshots", "basis", "push", 'after "hold"', 'after "release"', 'after "return"']
    return markdown(heads, lines)


def _displacements(errors: list[Row]) -> str:
    values = [error["displacement"] for error in errors]
    if all(error["energy"] > 10 for error in errors):
        return f"energy {min(error['energy'] for error in errors):.0f} times too large or more"
    return " / ".join(percent(value)[:-2] for value in values) + " %"


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
    """Return the errors of the tool's force and of the mean deflection of a pushed sheet."""
    rows = [row for row in studies["statics"] if row["case"] == "poke"]
    lines = []
    for prestretch, radius in dict.fromkeys((r["prestretch"], r["tool_radius"]) for r in rows):
        taut = f"{prestretch:g}" if prestretch > 1 else "none"
        for spacing in distinct(row["spacing"] for row in rows):
            key = {"prestretch": prestretch, "tool_radius": radius, "spacing": spacing}
            found = [find(rows, **key, layout=layout, jitter=jitter) for layout, jitter in LAYOUTS]
            cells = [f"{signed(row['force_error'], unit='')} / {signed(row['mean_error'])}" for row in found]
            lines.append([f"{millimetres(radius)}, {taut}", millimetres(spacing), *cells])
    heads = ["tool radius, prestretch", "spacing", "rings", "triangular", "rings, jitter 0.1"]
    return markdown(heads, lines)


@block("membranes", command="python validation/membranes.py statics")
def membrane_inflated(studies: Row) -> str:
    """Return the error of the height of an inflated sheet."""
    rows = [row for row in studies["statics"] if row["case"] == "inflation"]
    lines = []
    for pressure in distinct((row["pressure"] for row in rows), reverse=False):
        exact = find(rows, pressure=pressure)
        height = 1e3 * exact["height"] / (1 + exact["height_error"])
        for spacing in distinct(row["spacing"] for row in rows):
            found = [find(rows, pressure=pressure, spacing=spacing, layout=a, jitter=b) for a, b in LAYOUTS]
            cells = [signed(row["height_error"], 2) for row in found]
            lines.append([f"{pressure:g} Pa ({height:.2f} mm)", millimetres(spacing), *cells])
    return markdown(["pressure (height)", "spacing", "rings", "triangular", "rings, jitter 0.1"], lines)


@block("membranes", command="python validation/membranes.py nodes")
def membrane_nodes(studies: Row) -> str:
    """Return the radius of the disc that needs the force of a single pushed node."""
    rows = studies["nodes"]
    lines = []
    for spacing in distinct(row["spacing"] for row in rows):
        found = [find(rows, spacing=spacing, layout=layout) for layout in ("rings", "hexagonal")]
        cells = [f"{row['radius_in_spacings']:.2f}; {signed(row['mean_error'], 2)}" for row in found]
        lines.append([millimetres(spacing), *cells])
    return markdown(["spacing", "rings: radius in spacings; mean deflection", "triangular: the same"], lines)


@block("membranes", command="python validation/membranes.py layouts")
def membrane_layouts(studies: Row) -> str:
    """Return the mean deflection of a pushed sheet at 0.1 s on all layouts."""
    rows = studies["layouts"]
    lines = []
    for radius in distinct(row["tool_radius"] for row in rows):
        for spacing in distinct(row["spacing"] for row in rows):
            found = [
                find(rows, tool_radius=radius, spacing=spacing, layout=layout, jitter=jitter)
                for layout, jitter in (*LAYOUTS, ("hexagonal", 0.1))
            ]
            tool = millimetres(radius) if radius else "one node"
            lines.append([tool, millimetres(spacing), *(f"{1e3 * row['mean_deflection']:.2f} mm" for row in found)])
    return markdown(["tool", "spacing", "rings", "triangular", "rings, jitter 0.1", "triangular, jitter 0.1"], lines)


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
            percent(max(row["largest_wrinkled_share"] for row in own)),
        ])  # fmt: skip
    heads = [
        "spacing", "nodes", "runs", "largest growth of energy after the tool's last motion",
        "largest miss of the balance while the tool pushes", "largest wrinkled share",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("axisymmetric", command="python validation/axisymmetric_table.py")
def axisymmetric(found: Row) -> str:
    """Return forces and heights of the axisymmetric solutions, and their difference from finite elements."""
    lines = [
        [
            f"pushed by {1e3 * row['height']:g} mm, tool of {1e3 * row['tool_radius']:g} mm, "
            f"prestretch {row['prestretch']:g}", f"{1e3 * row['force']:.4f} mN",
            f"{1e3 * row['mean_deflection']:.3f} mm", f"{row['elements_difference']:.0e}",
        ]
        for row in found["poke"]
    ]  # fmt: skip
    lines += [
        [
            f"inflated by {row['pressure']:g} Pa", f"height {1e3 * row['height']:.2f} mm",
            f"{1e3 * row['mean_deflection']:.3f} mm", f"{row['elements_difference']:.0e}",
        ]
        for row in found["inflate"]
    ]  # fmt: skip
    return markdown(["case", "force or height", "mean deflection", "difference from 400 finite elements"], lines)
