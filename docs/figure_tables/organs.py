"""Organs and campaigns."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, distinct, find, markdown

LITTLE_FORCE = 0.1  # largest force of a path over that of all, below which a path counts as one of little force


@block("organ_models", command="python validation/organ_models.py", timed=True)
def organ_models(entries: list[Row]) -> str:
    """Return times and errors of the models of every surface, with default choices."""
    lines = []
    for each in entries:
        small, large = each["small"], each.get("large")
        lines.append([
            each["organ"], f"{small['nodes']:,}", f"{each['new'] + each['first_force']:.0f} s",
            f"{small['seconds'] / 60:.1f} min", _force_errors(small),
            f"{large['seconds'] / 60:.1f} min" if large else "", _force_errors(large) if large else "",
            f"{(large or small)['megabytes']:.1f} MB",
        ])  # fmt: skip
    heads = [
        "organ", "nodes", "first force", "small model", "force; 95 %; surface", "32 paths", "force; 95 %; surface",
        "file",
    ]  # fmt: skip
    return markdown(heads, lines)


def _force_errors(found: Row) -> str:
    return f"{found['force']:.1%}; {found['force_95']:.1%}; {found['surface_95']:.1%}"


@block("organ_models", command="python validation/organ_models.py --held-out")
def organ_models_little_force(entries: list[Row]) -> str:
    """Return the errors of paths with little force, and of the others."""
    lines = []
    for each in entries:
        paths = each.get("large", {}).get("held_out", [])
        if paths:
            most = max(path["largest"] for path in paths)
            light = [path["force_95"] for path in paths if path["largest"] < LITTLE_FORCE * most]
            others = [path["force_95"] for path in paths if path["largest"] >= LITTLE_FORCE * most]
            spans = [f"{min(errors):.0%} to {max(errors):.0%}" if errors else "" for errors in (light, others)]
            lines.append([each["organ"], f"{most:.2g} N", f"{len(light)} of {len(paths)}", *spans])
    heads = ["organ", "largest force", "paths below a tenth of it", "their force, 95 %", "of the others"]
    return markdown(heads, lines)


@block("organs", command="python validation/organs.py --nodes 3000 10000 30000")
def organs(found: Row) -> str:
    """Return what came of poked organs, a surface and Poisson's ratio a line."""
    cases = [case for case in found["cases"] if case["form"] == "energy"]
    sizes = distinct((case["wished_nodes"] for case in cases), reverse=False)
    lines = []
    for surface, poisson in distinct(((case["surface"], case["poisson"]) for case in cases), reverse=False):
        cells = [_poked(find(cases, surface=surface, poisson=poisson, wished_nodes=size)) for size in sizes]
        lines.append([surface, f"{poisson:g}", *cells])
    return markdown(["surface", "Poisson's ratio", *(f"{size:,} nodes" for size in sizes)], lines)


def _poked(case: Row | None) -> str:
    if case is None:
        return "not run"
    if "energy_at_release" not in case:
        return f"stopped: {case['why'].split(';')[0]}"
    left = case["energy_at_end"] / case["energy_at_release"]
    outcome = f"{left:.0%} left" if case["stable"] else "energy grows"
    return f"{1e3 * case['spacing']:.3g} mm: {outcome}, gap {case['balance']:.2%}"


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
