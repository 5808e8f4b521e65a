"""Choice of a body on the page: the labels of a map of which none was given."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console
from palpate.app.view.server.host import Host, serve
from palpate.app.view.server.label_choice import LabelChoice
from palpate.faults import InputError
from palpate.surface.labels.listing import label_rows
from palpate.surface.labels.reading import is_label_map, read_label_map

__all__ = ["choose_on_page", "label_choice"]

T = TypeVar("T")


def label_choice(file: str, names: Path | None = None) -> LabelChoice | None:
    """Return the choice of a label map of several labels; None for another file.

    Parameters
    ----------
    names : path, optional
        File of names that the map lacks.
    """
    if not is_label_map(file):
        return None
    labels = read_label_map(file, names)
    return LabelChoice(labels.name, label_rows(labels)) if len(labels.segments) > 1 else None


@contextlib.contextmanager
def choose_on_page(
    choice: LabelChoice, read: Callable[[Sequence[str]], T], address: tuple[int, str, bool]
) -> Iterator[tuple[Host, T]]:
    """Serve a choice, and yield the host and what `read` returns for the labels that are chosen.

    A choice that `read` refuses is reported on the page, where another can be made.
    """
    console = Console()
    with serve(choice, console, *address) as host:
        likeliest = choice.rows[0].part
        console.say(f"{len(choice.rows)} labels: choose one on the page, or by --part, such as --part {likeliest!r}")
        while True:
            parts = choice.wait()
            try:
                subject = read(parts)
            except InputError as error:
                console.say(option_names(str(error)))
                host.refuse(str(error))
                continue
            yield host, subject
            return
