"""Parser of ``palpate check``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Command, add_command, add_output, add_parts, existing_file, number, whole
from palpate.surface.formats.names import listed_formats

__all__ = ["add_check"]


def _load() -> Command:
    from palpate.app.check.command import check

    return check


def add_check(commands: Any) -> None:
    """Add the command to those of a parser."""
    check = add_command(
        commands,
        "check",
        _load,
        summary="examine the surface of an organ and fill it with nodes",
        description=f"Read a closed surface ({listed_formats()}), list its faults, and fill it with nodes if it has "
        "none. Leave a report with pictures in a folder. Of a scene file, also report supports, regions and what the "
        "tool reaches. See docs/organs.md and docs/scenes.md.",
    )
    add = check.add_argument
    add("file", type=existing_file, metavar="FILE", help="file of the surface, or scene file (organ.toml)")
    text = "distance between nodes [m] (default: one that gives about 4,000 nodes)"
    add("--spacing", type=number, metavar="M", help=text)
    add_parts(check)
    text = "unit of length in the file (default: guessed, with a warning)"
    add("--units", choices=("m", "cm", "mm", "in"), help=text)
    add("--scale", type=number, default=1.0, metavar="S", help="factor of all lengths")
    text = "close small holes, turn triangles, smooth folds, and remove specks"
    add("--repair", action="store_true", help=text)
    add("--seed", type=whole, default=0, metavar="K", help="seed of the nodes' positions")
    add_output(check, "out/check")
