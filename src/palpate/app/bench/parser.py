"""Parser of ``palpate bench``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Command, add_command, add_output, number, whole

__all__ = ["add_bench"]


def _load() -> Command:
    return _measure


def _measure(*, what: str, **options: Any) -> int:
    """Measure models or the page, each with its own options."""
    if what == "page":
        from palpate.app.bench.page import bench_page

        return bench_page(**{name: options[name] for name in ("model", "vertices", "seconds", "out", "as_json")})
    from palpate.app.bench.command import bench

    return bench(**{name: options[name] for name in ("fine", "repeats", "out", "as_json")})


def add_bench(commands: Any) -> None:
    """Add the command to those of a parser."""
    bench = add_command(
        commands,
        "bench",
        _load,
        summary="measure the speed of full and reduced models, or of the page of palpate view",
        description="Measure full and reduced models in turn, and leave a report with the medians in a folder. All "
        "ratios come from one run; run nothing else on the processors meanwhile. `palpate bench page` presses a body "
        "on the page in a headless Chromium instead.",
    )
    bench.synonyms["what"] = "--model"  # of the loader of models
    add = bench.add_argument
    add("what", nargs="?", choices=["models", "page"], default="models", help="what to measure")
    text = "page: a scene, or a file of palpate train"
    add("--model", default="liver", metavar="SCENE|FILE", help=text)
    text = "page: least number of vertices drawn"
    add("--vertices", type=whole, default=10_000, metavar="N", help=text)
    add("--seconds", type=number, default=10.0, metavar="S", help="page: duration of pressing [s]")
    text = "models: measure the beam also at 2.5 mm, which takes about ten minutes"
    add("--fine", action="store_true", help=text)
    add("--repeats", type=whole, default=3, metavar="K", help="models: number of rounds of the long runs")
    add_output(bench, "out/bench")
