"""Choice of a body on the page: the labels of a map of which none was given."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import TypeVar

from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console
from palpate.app.view.server.host import Host, serve
from palpate.app.view.server.label_choice import LabelChoice
from palpate.core.faults import InputError
from palpate.surface.labels.listing import label_rows
from palpate.surface.labels.reading import read_label_map

Opened = TypeVar("Opened")


@contextlib.contextmanager
def choose_on_page(
    file: str,
    names: Path | None,
    read: Callable[[Sequence[str], Sequence[str]], Opened],
    address: tuple[int, str, bool, str | None],
) -> Iterator[tuple[Host | tuple[int, str, bool, str | None], Opened]]:
    """Yield what `read` returns for the labels of a map that are chosen on the page, and the host of the page.

    `read` takes the labels, and those that lie in them and do not join. A choice that `read` refuses is reported on the
    page, where another can be made. A map of one label needs no choice, and has the address in place of a host. `names`
    is a file of names that the map lacks.
    """
    labels = read_label_map(file, names)
    if len(labels.segments) == 1:
        yield address, read((), ())
        return
    choice, console = LabelChoice(labels.name, label_rows(labels)), Console()
    with serve(choice, console, *address) as host:
        likeliest = quote(choice.rows[0].part)
        console.say(
            f"{len(choice.rows)} labels: choose on the page, or stop and add --part, such as --part {likeliest}"
        )
        while True:
            parts, without = choice.wait()
            try:
                opened = read(parts, without)
            except InputError as error:
                console.say(option_names(str(error)))
                host.refuse(str(error))
                continue
            yield host, opened
            return
