"""The times of first commands, and the functions that they compile."""

from __future__ import annotations

from figure_tables.cells import Row, block, markdown

NAMES = {
    "demo": "`make demo`",
    "press": "the full body of a liver, 1 s in real time (`palpate run liver --full --realtime`)",
    "test": "`make test`",
}


@block(
    "first_start",
    command="python benchmarks/first_start.py demo` and `python benchmarks/first_start.py press",
    timed=True,
)
def first_start(times: Row) -> str:
    """Return the times of commands in a fresh clone, and again."""
    rows = [
        [
            NAMES[name],
            *(f"{times[name][which]['wall']:.0f} s; {times[name][which]['processor']:.0f} s"
              for which in ("first", "second")),
        ]
        for name in NAMES
        if name in times
    ]  # fmt: skip
    return markdown(["command", "first time: wall; processor", "second time: wall; processor"], rows)


@block("compiled_functions", command="python benchmarks/compiled_functions.py beam reduced touch", timed=True)
def compiled_functions(found: Row) -> str:
    """Return how many functions commands compile from an empty cache."""
    rows = [
        [each["command"] if not each["command"].startswith("palpate") else f"`{each['command']}`",
         str(each["functions"]), str(each["versions"]), f"{each['seconds']:.0f} s"]
        for each in found.values()
    ]  # fmt: skip
    return markdown(["from an empty cache", "functions", "versions", "processor"], rows)
