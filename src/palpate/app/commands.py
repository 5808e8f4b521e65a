"""What every command of ``palpate`` calls; nothing is imported before it is needed."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

__all__ = ["perform"]

INPUTS = ("data", "file", "model", "script")  # options that name files to read


def perform(options: dict[str, Any]) -> int:
    """Run a command with its options, as the parser gives them; return the exit code."""
    command = options.pop("command")
    commands = {
        "reproduce": _reproduce, "run": _run, "train": _train, "fit": _fit, "check": _check, "bench": _bench,
        "laws": _laws, "view": _view, "replay": _replay, "compare": _compare,
    }  # fmt: skip
    _check_inputs(options)
    return commands[command](options)


def _check_inputs(options: dict[str, Any]) -> None:
    """Refuse folders, pipes and devices as files to read, before anything waits for them."""
    paths = [path for name in INPUTS for path in _listed(options.get(name)) if isinstance(path, Path)]
    if paths:
        from palpate.files import regular_file

        for path in paths:
            with suppress(FileNotFoundError):  # the command says what it misses
                regular_file(path, "file")


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _reproduce(options: dict[str, Any]) -> int:
    if options.pop("example") == "beam":
        from palpate.app.beam.reproduce import reproduce_beam

        return reproduce_beam(**options)
    from palpate.app.membrane.reproduce import reproduce_membrane

    return reproduce_membrane(**options)


def _run(options: dict[str, Any]) -> int:
    if options.pop("scene") == "beam":
        from palpate.app.run.command import run_beam

        return run_beam(**options)
    from palpate.app.run.liver import run_liver

    del options["realtime"]
    return run_liver(**options)


def _bench(options: dict[str, Any]) -> int:
    if options.pop("what") == "page":
        from palpate.app.bench.page import bench_page

        return bench_page(**{name: options[name] for name in ("model", "vertices", "seconds", "out", "as_json")})
    from palpate.app.bench.command import bench

    return bench(**{name: options[name] for name in ("fine", "repeats", "out", "as_json")})


def _laws(options: dict[str, Any]) -> int:
    from palpate.app.laws import laws

    return laws(**options)


def _fit(options: dict[str, Any]) -> int:
    from palpate.app.fit.command import fit_law

    return fit_law(**options)


def _check(options: dict[str, Any]) -> int:
    from palpate.app.check.command import check

    return check(**options)


def _train(options: dict[str, Any]) -> int:
    from palpate.app.train.command import train

    return train(**options)


def _compare(options: dict[str, Any]) -> int:
    from palpate.app.compare.command import compare

    return compare(**options)


def _view(options: dict[str, Any]) -> int:
    from palpate.app.view.command import view

    return view(options.pop("what"), **options)


def _replay(options: dict[str, Any]) -> int:
    from palpate.app.view.replay_command import replay

    return replay(options.pop("file"), **options)
