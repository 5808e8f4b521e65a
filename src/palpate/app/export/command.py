"""``palpate export``: compile a model to a library, and print where its files are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palpate.app.common.console import Console
from palpate.app.export.web import export_web
from palpate.app.models.input import open_input
from palpate.core.faults import InputError
from palpate.export.folder import check_new, export_c, identifier
from palpate.export.targets import HOST_TARGET


def export(
    *,
    model: str,
    part: Sequence[str] | None = None,
    labels: Path | None = None,
    without: Sequence[str] = (),
    folder: Path | None = None,
    web: Path | None = None,
    name: str | None = None,
    targets: Sequence[str] | None = None,
    relaxed: bool = False,
    tools: int = 2,
) -> int:
    """Write a library of a model for programs in C, or a page in the folder `web` on which a browser steps it."""
    console = Console()
    if web is not None:
        if name is not None or targets or relaxed:
            raise InputError("web must be alone, got an option of a library; leave name, target and relaxed out")
        check_new(web)
        opened = open_input(model, for_training=True, part=part, labels=labels, without=without)
        reduced = opened.reduced(console)
        with console.status("compiling the step of the model (about a minute)"):
            written = export_web(reduced, web, opened.title, tools)
        _say(console, web, written)
        console.say(f"open it:          python3 -m http.server --directory {web} 8000")
        console.say("                  http://localhost:8000")
        return 0
    assert folder is not None  # the parser requires one
    check_new(folder)
    opened = open_input(model, for_training=True, part=part, labels=labels, without=without)
    reduced = opened.reduced(console)
    chosen = identifier(Path(model).stem) if name is None else name
    with console.status("compiling the step of the model (about a minute)"):
        written = export_c(
            reduced, folder, name=chosen, title=opened.title, targets=list(dict.fromkeys(targets or [HOST_TARGET])),
            strict=not relaxed, tools=tools, say=console.say,
        )  # fmt: skip
    _say(console, folder, written)
    console.say(f"build and run it: cmake -S {folder} -B {folder}/build && cmake --build {folder}/build")
    console.say(f"                  {folder}/build/press")
    return 0


def _say(console: Console, folder: Path, written: dict[str, str]) -> None:
    for file, about in written.items():
        console.say(f"{folder / file}: {about}")
