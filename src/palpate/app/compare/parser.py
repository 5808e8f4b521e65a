"""Parser of ``palpate compare``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Command, add_command, add_output, number, whole

__all__ = ["add_compare"]


def _load() -> Command:
    from palpate.app.compare.command import compare

    return compare


def add_compare(commands: Any) -> None:
    """Add the command to those of a parser."""
    compare = add_command(
        commands,
        "compare",
        _load,
        summary="compare linear reductions with each other and with the full body",
        description="Reduce a linearised body by several methods, and measure cost, stability and errors of each "
        "against the full, nonlinear body. Leave a report with figures in a folder. See docs/linear.md.",
    )
    add = compare.add_argument
    text = "the paper's beam, pulled; or the generated liver, with a tool at its front"
    add("body", choices=["beam", "liver"], help=text)
    add("--modes", type=whole, nargs="+", default=[4, 8, 16, 24], metavar="M", help="numbers of modes")
    add("--methods", nargs="+", metavar="NAME", help="methods to compare (default: all but balanced-low-rank)")
    text = "distance between nodes [m] (default: 0.005 for the beam, 0.012 for the liver)"
    add("--spacing", type=number, metavar="M", help=text)
    add("--poisson", type=number, metavar="NU", help="Poisson's ratio (default: 0.49 for the beam, 0.45 for the liver)")
    text = "number of slowest modes to balance instead of all unknowns; 0 balances all (default: 240)"
    add("--condense", type=whole, metavar="K", help=text)
    add_output(compare, "out/compare")
