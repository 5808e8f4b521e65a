"""Parsers of ``palpate reproduce beam`` and ``palpate reproduce membrane``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Parser, add_command, add_output, number, whole

MODES = [2, 4, 6, 8, 10, 12]  # the paper's
LEAVES = "Leave a report, figures, the snapshots and a file for ParaView in a folder."


def add_reproduce(commands: Any) -> None:
    """Add the command to those of a parser."""
    text = "run an example of the paper and compare it with the paper's figures"
    reproduce = commands.add_parser("reproduce", help=text, description=f"{text.capitalize()}.")
    examples = reproduce.add_subparsers(required=True, metavar="EXAMPLE")
    _add_beam(examples)
    _add_membrane(examples)


def _add_beam(examples: Any) -> None:
    beam = _add_example(
        examples,
        "beam",
        "the beam under traction: section 6.1, Figures 3 to 5",
        "Run the paper's beam under traction with the full model and with reduced models.",
    )
    add = beam.add_argument
    add("--spacing", type=number, default=0.005, metavar="M", help="distance between nodes [m], at most 0.00666")
    add("--load", type=number, default=100.0, metavar="N", help="largest force [N], reached at 0.5 s")
    add("--poisson", type=number, default=0.49, metavar="NU", help="Poisson's ratio, at most 0.499")


def _add_membrane(examples: Any) -> None:
    membrane = _add_example(
        examples,
        "membrane",
        "the membrane under a tool tip: section 6.2, Figures 7 to 9",
        "Run the paper's circular membrane, whose centre a tool pushes for 0.1 s, with the full model and with "
        "reduced models.",
    )
    add = membrane.add_argument
    add("--spacing", type=number, default=0.005, metavar="M", help="distance between nodes [m], from 0.001 to 0.05")
    add(
        "--after",
        choices=("return", "hold", "release"),
        default="return",
        help="what the tool does after 0.1 s: jump back as in equation (35), stay, or let go",
    )
    text = "radius of the tool [m]; 0 moves the central node only"
    add("--tool-radius", type=number, default=0.0, metavar="M", help=text)
    add("--prestretch", type=number, default=1.0, metavar="S", help="stretch of the mounted sheet, from 1 to 10")
    add("--layout", choices=("rings", "hexagonal"), default="rings", help="arrangement of the nodes")
    text = "random shift of the nodes, in spacings, at most 0.3"
    add("--jitter", type=number, default=0.0, metavar="J", help=text)
    add("--seed", type=whole, default=0, metavar="K", help="seed of the random shift")


def _add_example(examples: Any, name: str, summary: str, description: str) -> Parser:
    parser = add_command(
        examples,
        name,
        "palpate.app.studies.reproduce:reproduce",
        summary=summary,
        description=f"{description} {LEAVES}",
    )
    parser.set_defaults(example=name)
    text = "numbers of modes of the reduced models"
    parser.add_argument("--modes", type=whole, nargs="+", default=MODES, metavar="M", help=text)
    add_output(parser, f"out/{name}")
    return parser
