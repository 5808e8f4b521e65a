"""``palpate export``: compile a model to a library, and print where its files are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palpate.app.common.console import Console
from palpate.app.models.loader import open_model
from palpate.export.folder import HOST_TARGET, export_c, identifier

__all__ = ["export"]


def export(
    *, model: str, folder: Path, name: str | None = None, targets: Sequence[str] | None = None, relaxed: bool = False
) -> int:
    """Write a library of a model for programs in C.

    Parameters
    ----------
    model : str
        As for `palpate.app.models.loader.open_model`.
    folder, name, targets, relaxed
        As for `palpate.export.folder.export_c`.

    Returns
    -------
    int
        0.

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        No such model, or an option out of range.
    OSError
        A file cannot be written.
    """
    console = Console()
    reduced, title = open_model(model, console)
    chosen = identifier(Path(model).stem) if name is None else name
    with console.status("compiling the step of the model (about a minute)"):
        written = export_c(
            reduced, folder, name=chosen, title=title, targets=list(dict.fromkeys(targets or [HOST_TARGET])),
            strict=not relaxed, say=console.say,
        )  # fmt: skip
    for file, about in written.items():
        console.say(f"{folder / file}: {about}")
    console.say(f"build and run it: cmake -S {folder} -B {folder}/build && cmake --build {folder}/build")
    console.say(f"                  {folder}/build/press")
    return 0
