"""Palpate and its peers."""

from __future__ import annotations

from figure_tables.cells import Row, block, markdown, percent, signed


@block("peers", command="python benchmarks/peers.py", timed=True)
def peers(found: Row) -> str:
    """Return errors and computing times of palpate and its peers."""
    rows = [
        [
            row["case"], row["program"], f"{row['nodes']:,}",
            f"{1e6 * row['step']:.0f} µs" if "step" in row else "none",
            f"{row['seconds_per_second']:.3g} s/s" if "step" in row else f"{row['solve_seconds']:.3g} s, statics",
            signed(row["error"], 2),
        ]
        for row in found["rows"]
    ]  # fmt: skip
    return markdown(["case", "program", "nodes", "step", "computing time", "error"], rows)


@block("peers", command="python benchmarks/peers.py")
def peers_references(found: Row) -> str:
    """Return the references of the comparison: the limit of each law, and how far the finest mesh is away."""
    rows = []
    for case, unit, scale in (("beam", "mm", -1e3), ("block", "N", 1.0)):
        reference = found["references"][case]
        away = abs(reference["meshes"][-1] / reference["laws"]["neo_hookean"] - 1)
        rows += [
            [case, law.replace("_", " "), f"{scale * value:.4g} {unit}", percent(away)]
            for law, value in reference["laws"].items()
        ]
    return markdown(["case", "law", "limit of three meshes", "finest mesh (palpate's law), away by"], rows)
