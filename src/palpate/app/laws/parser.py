"""Parser of ``palpate laws``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import add_command, add_json


def add_laws(commands: Any) -> None:
    """Add the command to those of a parser."""
    laws = add_command(
        commands,
        "laws",
        "palpate.app.laws.command:laws",
        summary="list the material laws with their parameters, units and ranges",
        description="List every material law, law of fibres, relaxation and volumetric part: its energy, its "
        "parameters with units and ranges, and its source.",
    )
    add_json(laws, "the list")
