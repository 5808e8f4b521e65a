"""Parsers of ``palpate run beam`` and ``palpate run liver``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Command, Parser, add_command, add_output, existing_file, number, whole

__all__ = ["add_run"]


def add_run(commands: Any) -> None:
    """Add the command to those of a parser."""
    text = "run a scene, once or in real time, and report its cost"
    run = commands.add_parser("run", help=text, description=f"{text.capitalize()}.")
    scenes = run.add_subparsers(required=True, metavar="SCENE")
    _add_beam(scenes)
    _add_liver(scenes)


def _load_beam() -> Command:
    from palpate.app.run.command import run_beam

    return run_beam


def _load_liver() -> Command:
    from palpate.app.run.liver import run_liver

    return run_liver


def _add_beam(scenes: Any) -> None:
    beam = add_command(
        scenes,
        "beam",
        _load_beam,
        summary="the paper's beam: pulled once, or moved by a tool in real time",
        description="Run the paper's pull of the beam with the full model, and with --modes also with a hyper-reduced "
        "model. Leave the trajectories and a report in a folder. With --realtime, train a reduced model whose free end "
        "a tool moves, step the model at a fixed rate while the tool moves, and report how well the rate was kept.",
    )
    add = beam.add_argument
    text = "distance between nodes [m] (default: 0.005; in real time 0.00667)"
    add("--spacing", type=number, metavar="M", help=text)
    add("--load", type=number, metavar="N", help="largest force [N], not in real time (default: 100)")
    text = "Poisson's ratio, at most 0.499 (default: 0.49; in real time 0.45)"
    add("--poisson", type=number, metavar="NU", help=text)
    text = "number of modes of the reduced model (default: no reduced model; in real time 24)"
    add("--modes", type=whole, metavar="M", help=text)
    add("--model", type=existing_file, metavar="FILE", help="in real time: load this reduced model, train none")
    add("--realtime", action="store_true", help="step at a fixed rate while a tool moves")
    _add_rate(beam, "in real time: ")
    add_output(beam, "out/run")


def _add_liver(scenes: Any) -> None:
    liver = add_command(
        scenes,
        "liver",
        _load_liver,
        summary="a liver that a ball presses, in real time",
        description="Step a reduced model of a liver at a fixed rate while a ball presses it, slides and leaves, again "
        "and again. Report how well the rate was kept, and the force on the ball. Without --model, a small model is "
        "trained at the first start, in some minutes, and kept in the user's cache; if this is stopped, the next start "
        "continues it. With --full, step the full body.",
    )
    add = liver.add_argument
    add("--realtime", action="store_true", required=True, help="step at a fixed rate while the ball moves")
    text = "load this reduced model: model.rom of palpate train liver"
    add("--model", type=existing_file, metavar="FILE", help=text)
    add("--full", action="store_true", help="step the full liver, without a reduced model; nothing is trained")
    add("--spacing", type=number, metavar="M", help="with --full: distance between nodes [m] (default: 0.009)")
    _add_rate(liver, "")
    add_output(liver, "out/run")


def _add_rate(parser: Parser, when: str) -> None:
    add = parser.add_argument
    add("--seconds", type=number, metavar="S", help=f"{when}length of the run [s], at most 600 (default: 10)")
    add("--rate", type=number, metavar="HZ", help=f"{when}steps per second, from 50 to 20000 (default: 1000)")
