"""Parser of ``palpate new``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from palpate.app.common.arguments import add_command, add_parameter, add_parts, existing_file, path
from palpate.scenes.description import Body, Shape
from palpate.scenes.spacing import TRAINING_NODES
from palpate.surface.formats.names import listed_formats


def add_new(commands: Any) -> None:
    """Add the command to those of a parser."""
    new = add_command(
        commands,
        "new",
        "palpate.app.new.command:new",
        summary="write a scene file for the surface of an organ",
        description=f"Read a surface ({listed_formats()}), and write a scene file that works, with comments about what "
        "was guessed and why. Then palpate view, check, run and train take the scene file. See "
        "docs/reference/scene_files.md.",
    )
    add = new.add_argument
    add("file", type=existing_file, metavar="FILE", help="file of the surface")
    add("-o", "--out", type=path, default=Path("organ.toml"), metavar="FILE.toml", help="scene file to write")
    add_parts(new)
    add_parameter(new, Shape, "units", " (default: guessed from the volume)")
    add_parameter(new, Shape, "scale")
    add_parameter(new, Body, "spacing", f" (default: one that gives about {TRAINING_NODES:,} nodes)")
    add("--law", metavar="NAME", help="law of the tissue, of those of palpate laws (default: NeoHookean, liver)")
    text = (
        "a support, as for palpate view: x-, back, 'lowest 15%%', 'near X,Y,Z,R' in mm, 'painted FILE'; may be repeated"
    )
    add("--fixed", action="append", default=[], metavar="WHERE", help=text)
