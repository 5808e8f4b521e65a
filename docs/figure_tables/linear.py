"""Linear reductions."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from collections.abc import Sequence

from figure_tables.cells import ERRORS, Row, block, distinct, markdown, significant

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
    lines = []
    for method in dict.fromkeys(entry["method"] for entry in entries):
        own = {entry["modes"]: entry for entry in entries if entry["method"] == method}
        last = own.get(sizes[-1])
        small = [_linear_error(own.get(size), "small", "displacement") for size in sizes]
        responses = [_bounded(own[size].get("response_error")) if size in own else "–" for size in sizes]
        kinds = [_linear_errors(last, load, kinds) for load, kinds in (("small", ERRORS[1:]), ("large", ERRORS))]
        response = "" if set(responses) == {"–"} else " / ".join(responses)
        lines.append([method, " / ".join(small), kinds[0], response, kinds[1]])
    names = ", ".join(map(str, sizes))
    small_load, large_load = (f"{about[load]:g} {about['unit']}" for load in ("small", "large"))
    heads = [
        "method", f"{small_load}: displacement with {names} modes", f"velocity / energy / force, {sizes[-1]}",
        f"frequency response, {names} modes", f"{large_load}: displacement / velocity / energy / force",
    ]  # fmt: skip
    return markdown(heads, lines)


def _linear_errors(entry: Row | None, load: str, kinds: Sequence[str]) -> str:
    errors = [_linear_error(entry, load, kind) for kind in kinds]
    return errors[0] if errors[0] in ("failed", "diverged") else " / ".join(errors)


def _linear_error(entry: Row | None, load: str, kind: str) -> str:
    if entry is None or entry["failed"]:
        return "failed"
    errors = entry["errors"][load]
    return "diverged" if errors is None else _bounded(errors[kind])


def _bounded(error: float | None) -> str:
    if error is None:
        return "–"
    return f"> {100 * MAX_ERROR:.0f}" if error > MAX_ERROR else significant(100 * error)
