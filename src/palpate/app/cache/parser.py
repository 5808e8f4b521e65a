"""Parser of ``palpate cache``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Command, add_command, add_json

__all__ = ["add_cache"]


def _load() -> Command:
    from palpate.app.cache.command import show_cache

    return show_cache


def add_cache(commands: Any) -> None:
    """Add the command to those of a parser."""
    parser = add_command(
        commands,
        "cache",
        _load,
        summary="show or remove the compiled functions that are kept",
        description="Print the folder of compiled functions, their number and size. palpate compiles a function once "
        "for a user, whatever the clone or environment, and keeps at most 500 MB: what was not used for longest goes "
        "first.",
    )
    parser.add_argument("--empty", action="store_true", help="remove them; the next start compiles again")
    add_json(parser, "the report")
