"""Options of a body from a surface file, which several commands have."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Parser, add_parameter, add_parts
from palpate.scenes.description import Shape


def add_surface_options(parser: Parser) -> Any:
    """Add the options of a surface file to a parser; return their group."""
    group = parser.add_argument_group("of a surface file")
    add = group.add_argument
    add_parameter(group, Shape, "units", " (default: guessed by size)")
    add_parameter(group, Shape, "scale")
    add_parts(group)
    add("--law", metavar="LAW", help="law of the tissue, see palpate laws (default: liver, 2.2 kPa)")
    text = (
        "part that is held: x-, x+, y-, y+, z-, z+, back, 'lowest 15%%', 'near X,Y,Z,R' in mm or 'painted FILE'; may "
        "be repeated (default: back, the side away from the first view); of a label map also left, right, front, rear, "
        "head, feet"
    )
    add("--fixed", action="append", default=[], metavar="WHERE", help=text)
    return group
