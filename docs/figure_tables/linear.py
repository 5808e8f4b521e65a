"""Linear reductions."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, distinct, markdown, significant

MAX_ERROR = 10.0  # larger errors are printed as larger than this


@block(
    "compare_beam",
    command="palpate compare beam --modes 4 8 16 24`, now `"
    "python validation/linear_reductions.py beam --modes 4 8 16 24",
)
def linear_beam(report: Row) -> str:
    """Return the errors of linear models [%] under a small and a large load, and of their frequency response."""
    about = report["parameters"]
    entries = [entry | {"method": f"`{entry['method']}`"} for entry in report["methods"]]
    entries += [entry | {"method": report["nonlinear"]["name"]} for entry in report["nonlinear"]["entries"]]
    sizes = distinct((entry["modes"] for entry in entries), reverse=False)
    sizes = [sizes[1], sizes[-1]]
    lines = []
    for method in dict.fromkeys(entry["method"] for entry in entries):
        models = {entry["modes"]: entry for entry in entries if entry["method"] == method}
        small = [_linear_error(models.get(size), "small", "displacement") for size in sizes]
        responses = [_bounded(models[size].get("response_error")) if size in models else "–" for size in sizes]
        response = "" if set(responses) == {"–"} else "; ".join(responses)
        last = models.get(sizes[-1])
        large = [_linear_error(last, "large", kind) for kind in ("displacement", "reaction")]
        lines.append([method, "; ".join(small), response, large[0] if large[0] == large[1] else "; ".join(large)])
    names = "; ".join(map(str, sizes))
    small_load, large_load = (f"{about[load]:g} {about['unit']}" for load in ("small", "large"))
    heads = [
        "method", f"{small_load}: displacement, {names} modes [%]", f"frequency response, {names} modes",
        f"{large_load}: displacement; force, {sizes[-1]} modes",
    ]  # fmt: skip
    return markdown(heads, lines)


def _linear_error(entry: Row | None, load: str, kind: str) -> str:
    if entry is None or entry["failed"]:
        return "failed"
    errors = entry["errors"][load]
    return "diverged" if errors is None else _bounded(errors[kind])


def _bounded(error: float | None) -> str:
    if error is None:
        return "–"
    return f"> {100 * MAX_ERROR:.0f}" if error > MAX_ERROR else significant(100 * error)
