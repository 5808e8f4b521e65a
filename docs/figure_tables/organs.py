"""Organs and campaigns."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, distinct, markdown


@block("organ_models", command="python validation/organ_models.py", timed=True)
def organ_models(entries: list[Row]) -> str:
    """Return times and errors of the models of every surface, with default choices."""
    lines = []
    for each in entries:
        small, large = each["small"], each.get("large")
        lines.append([
            each["organ"], f"{small['nodes']:,}", f"{each['new'] + each['first_force']:.0f} s",
            f"{small['seconds'] / 60:.1f} min", _force_errors(small), _force_errors(large) if large else "",
        ])  # fmt: skip
    return markdown(["organ", "nodes", "first force", "training", "force; 95 %; surface", "with 32 paths"], lines)


def _force_errors(found: Row) -> str:
    return f"{found['force']:.1%}; {found['force_95']:.1%}; {found['surface_95']:.1%}"


@block("organs", command="python validation/organs.py --nodes 3000 10000 30000")
def organs(found: Row) -> str:
    """Return what came of poked organs, a surface a line."""
    cases = [case for case in found["cases"] if case["form"] == "energy"]
    lines = []
    for surface in distinct((case["surface"] for case in cases), reverse=False):
        rows = [case for case in cases if case["surface"] == surface]
        nodes = distinct((row["wished_nodes"] for row in rows), reverse=False)
        stable = sum(bool(row.get("stable")) for row in rows)
        gap = max(row.get("balance", float("inf")) for row in rows)
        lines.append([surface, f"{nodes[0]:,} to {nodes[-1]:,}", f"{stable} of {len(rows)}", f"{gap:.2%}"])
    return markdown(["surface", "nodes", "stable", "largest gap of the energy balance"], lines)


@block("out_of_core", command="python validation/out_of_core.py", timed=True)
def out_of_core(rows: list[Row]) -> str:
    """Return memory and accuracy of the modes of snapshots in files."""
    of = {"strain": "du/dX", "displacement": "u"}
    lines = [
        [
            f"{row['modes']} of {of[row['method']]}", f"{row['nodes']:,}", f"{row['snapshots']:,}",
            f"{row['gigabytes']:.2f} GB, {row['gigabytes_before']:.2f} GB", f"{row['bytes_of_files'] / 1e9:.1f} GB",
            f"{row['seconds']:.0f} s", f"{row['missed']:.7e}", f"{row['best']:.7e}",
            f"{row['singular_values_off']:.0e}" if "singular_values_off" in row else "–",
        ]
        for row in rows
    ]  # fmt: skip
    heads = [
        "modes", "nodes", "snapshots", "peak memory, of it the model", "files", "time", "error of the modes",
        "of the best", "largest error of a singular value",
    ]  # fmt: skip
    return markdown(heads, lines)
