"""Parser of ``palpate check``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import add_command, add_output, add_parameter, add_parts, existing_file
from palpate.scenes.description import Body, Shape
from palpate.surface.formats.names import listed_formats


def add_check(commands: Any) -> None:
    """Add the command to those of a parser."""
    check = add_command(
        commands,
        "check",
        "palpate.app.check.command:check",
        summary="examine the surface of an organ and fill it with nodes",
        description=f"Read a closed surface ({listed_formats()}), list its faults, and fill it with nodes if it has "
        "none. Leave a report with pictures in a folder. Of a scene file, also report supports, regions and what the "
        "tool reaches. See docs/howto/organs.md and docs/reference/scene_files.md.",
    )
    check.add_argument(
        "file", type=existing_file, metavar="FILE", help="file of the surface, or scene file (organ.toml)"
    )
    add_parameter(check, Body, "spacing", " (default: one that gives about 4,000 nodes)")
    add_parts(check)
    add_parameter(check, Shape, "units", " (default: guessed, with a warning)")
    add_parameter(check, Shape, "scale")
    add_parameter(check, Shape, "repair")
    add_parameter(check, Body, "seed")
    add_output(check, "out/check")
