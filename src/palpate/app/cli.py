"""The command ``palpate``.

Only the standard library is imported before a command runs, so that ``--help`` and ``--version`` answer at once.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palpate import __version__
from palpate.app.commands import perform
from palpate.app.documentation import documentation
from palpate.app.ending import BAD_INPUT, DEBUG, DONE, FAILED, INTERRUPTED, Parser, closed, complain, failed, refused
from palpate.app.ending import path as _path
from palpate.app.ending import whole as _whole

__all__ = ["main"]

MODES = [2, 4, 6, 8, 10, 12]  # the paper's
LEAVES = "and leave a report, figures, the snapshots and a file for ParaView in a folder."


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line.

    Parameters
    ----------
    argv : sequence of str, optional
        The words after ``palpate``; by default those of this process.

    Returns
    -------
    int
        0 when all went well, 1 when a run diverged, a file could not be written or memory ran out, 2 for bad input,
        70 for an internal error, a defect of palpate, 130 when interrupted.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    try:
        code = _called(words)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever read the output has enough
        return closed()
    except OSError as error:  # standard output cannot be written
        closed()
        return complain(f"cannot write the output: {error.strerror or error}", FAILED)


def _called(words: list[str]) -> int:
    """Run a command line; return the exit code, with one line on standard error if it is not 0."""
    if why := refused(words):
        return complain(why, BAD_INPUT)
    try:
        options = vars(_parser().parse_args(words))
    except SystemExit as end:  # after --help, --version, or a complaint
        if end.code:
            raise
        return DONE
    try:
        return perform(options)
    except BrokenPipeError:
        raise
    except KeyboardInterrupt as interrupt:
        return complain(" ".join(["interrupted", *map(str, interrupt.args)]), INTERRUPTED)
    except MemoryError:
        return complain("out of memory; take a larger spacing, fewer modes, or fewer snapshots", FAILED)
    except Exception as error:
        return failed(error)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="palpate",
        description="Real-time simulation of hyperelastic soft tissue by point collocation and model reduction.",
        epilog="Exit status: 0 done; 1 a run diverged, a file could not be written, or memory ran out; 2 bad input; "
        f"70 a defect of palpate, whose traceback is left in a file, or printed with {DEBUG}=1; 130 interrupted. "
        f"Pages that help texts call docs/NAME.md are in {str(documentation()).replace('%', '%%')}.",
    )
    parser.add_argument("--version", action="version", version=f"palpate {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    reproduce = commands.add_parser("reproduce", help="run an example of the paper and compare with its figures")
    examples = reproduce.add_subparsers(dest="example", required=True, metavar="EXAMPLE")
    _add_beam(examples)
    _add_membrane(examples)
    _add_run(commands)
    _add_view(commands)
    _add_train(commands)
    _add_fit(commands)
    _add_check(commands)
    _add_compare(commands)
    _add_bench(commands)
    _add_laws(commands)
    return parser


def _add_beam(examples: Any) -> None:
    beam = examples.add_parser(
        "beam",
        help="the beam under traction: section 6.1, Figures 3 to 5",
        description=f"Run the paper's beam under traction with the full model and with reduced ones, {LEAVES}",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = beam.add_argument
    add("--spacing", type=float, default=0.005, metavar="M", help="distance between nodes [m], at most 0.00666")
    add("--load", type=float, default=100.0, metavar="N", help="largest force [N], reached at 0.5 s")
    add("--poisson", type=float, default=0.49, metavar="NU", help="Poisson's ratio, at most 0.499")
    _add_common(beam, Path("out/beam"))


def _add_membrane(examples: Any) -> None:
    membrane = examples.add_parser(
        "membrane",
        help="the membrane under a tool tip: section 6.2, Figures 7 to 9",
        description="Run the paper's circular membrane, its centre pushed by a tool for 0.1 s, with the full model and "
        f"with reduced ones, {LEAVES}",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = membrane.add_argument
    add("--spacing", type=float, default=0.005, metavar="M", help="distance between nodes [m], from 0.001 to 0.05")
    add(
        "--after",
        choices=("return", "hold", "release"),
        default="return",
        help="what the tool does after 0.1 s: jump back as (35) prints, stay, or let go",
    )
    add("--tool-radius", type=float, default=0.0, metavar="M", help="radius of the tool [m]; 0 moves the central node")
    add("--prestretch", type=float, default=1.0, metavar="S", help="stretch of the mounted sheet, from 1 to 10")
    add("--layout", choices=("rings", "hexagonal"), default="rings", help="how the nodes lie")
    add("--jitter", type=float, default=0.0, metavar="J", help="random shift of the nodes in spacings, at most 0.3")
    add("--seed", type=_whole, default=0, metavar="K", help="of the random shift")
    _add_common(membrane, Path("out/membrane"))


def _add_common(parser: argparse.ArgumentParser, out: Path) -> None:
    parser.add_argument("--modes", type=_whole, nargs="+", default=MODES, metavar="M", help="sizes of reduced models")
    _add_results(parser, out)


def _add_results(parser: argparse.ArgumentParser, out: Path) -> None:
    add = parser.add_argument
    add("--out", type=_path, default=out, metavar="FOLDER", help="where the results go")
    add("--json", action="store_true", dest="as_json", help="print the report as JSON instead of a table")


def _add_run(commands: Any) -> None:
    run = commands.add_parser("run", help="run a scene, once or in real time")
    scenes = run.add_subparsers(dest="scene", required=True, metavar="SCENE")
    _add_run_beam(scenes)
    _add_run_liver(scenes)


def _add_run_beam(scenes: Any) -> None:
    beam = scenes.add_parser(
        "beam",
        help="the paper's beam, pulled; or in real time, grasped by a tool",
        description="Run the paper's pull of the beam with the full model, and with --modes with a hyper-reduced one, "
        "too, and leave the trajectories and a report in a folder. With --realtime: train a reduced model whose free "
        "end a tool holds, move the tool, step the model at a fixed rate, and report how the rate was kept.",
    )
    add = beam.add_argument
    add("--spacing", type=float, metavar="M", help="distance between nodes [m] (0.005; in real time 0.00667)")
    add("--load", type=float, metavar="N", help="largest force [N], not in real time (100)")
    add("--poisson", type=float, metavar="NU", help="Poisson's ratio, at most 0.499 (0.49; in real time 0.45)")
    add("--modes", type=_whole, metavar="M", help="size of the reduced model (none; in real time 24)")
    add("--model", type=_path, metavar="FILE", help="in real time: reduced model to load, not to train")
    add("--realtime", action="store_true", help="step at a fixed rate against a tool")
    _add_rate(beam, "in real time: ")
    _add_results(beam, Path("out/run"))


def _add_run_liver(scenes: Any) -> None:
    liver = scenes.add_parser(
        "liver",
        help="a liver that a ball presses, in real time",
        description="Step a reduced model of a liver at a fixed rate while a ball presses it, slides and leaves, again "
        "and again, and report how the rate was kept and the force on the ball. Without --model a small model is "
        "trained at first use, in some minutes, and kept in the user's cache; what was stopped goes on.",
    )
    add = liver.add_argument
    add("--realtime", action="store_true", required=True, help="step at a fixed rate against the ball")
    add("--model", type=_path, metavar="FILE", help="reduced model to load: model.rom of palpate train liver")
    _add_rate(liver, "")
    _add_results(liver, Path("out/run"))


def _add_rate(parser: argparse.ArgumentParser, when: str) -> None:
    add = parser.add_argument
    add("--seconds", type=float, metavar="S", help=f"{when}length of the run [s], at most 600 (10)")
    add("--rate", type=float, metavar="HZ", help=f"{when}steps a second, from 50 to 20000 (1000)")


def _add_train(commands: Any) -> None:
    train = commands.add_parser(
        "train",
        help="make many runs along random paths, and train a reduced model on all of them",
        description="Run a scene's full model along random paths of its tools, each run into a file of its own, and "
        "train a reduced model on them. What was stopped goes on where it was when the same command is given again. "
        "See docs/training.md.",
    )
    add = train.add_argument
    add("scene", metavar="SCENE", help="beam, liver, or module:function of your own")
    add("--set", nargs="+", action="extend", default=[], dest="given", metavar="NAME=X", help="the scene's parameters")
    add("--paths", type=_whole, default=64, metavar="K", help="runs to train on (64)")
    add("--held-out", type=_whole, default=8, metavar="K", help="further runs, to measure errors on (8)")
    add("--seed", type=_whole, default=0, metavar="K", help="of the paths (0)")
    add("--modes", type=_whole, default=24, metavar="M", help="size of the reduced model (24)")
    add(
        "--cubature",
        type=float,
        metavar="TOLERANCE",
        help="what the forces at the sampled nodes may miss of the whole ones in training, relative: the larger, the "
        "fewer nodes and the faster steps; 0 takes every node (liver 0.01, others 0.001)",
    )
    add("--workers", type=_whole, metavar="N", help="processes on this machine, one thread each (1)")
    add("--cluster", metavar="ADDRESS", help="Dask scheduler, or its file, instead of processes here")
    add("--folder", type=_path, default=Path("out/train"), metavar="DIR", help="where all goes (out/train)")
    add("--json", action="store_true", dest="as_json", help="print the report as JSON instead of a table")


def _add_view(commands: Any) -> None:
    view = commands.add_parser(
        "view",
        help="press and pull a body on a page in the browser",
        description="Show a body in real time on a page, where a tool presses, grasps and pulls it. See docs/view.md.",
    )
    add = view.add_argument
    add("what", metavar="SCENE|FILE", help="liver, beam, or a model's file")
    _add_address(view)
    add("--record", type=_path, metavar="FILE.h5", help="record all, and write it here in the end")
    add("--headless", action="store_true", help="no page: a script drives, and statistics are printed")
    add("--seconds", type=float, metavar="S", help="of a headless session (10)")
    add("--script", type=_path, metavar="FILE", help="of a headless session: lines of JSON, see docs/protocol.md")
    add("--json", action="store_true", dest="as_json", help="print the statistics as JSON")
    replay = commands.add_parser(
        "replay",
        help="show or export what palpate view has recorded",
        description="Show a recording on a page, draw it, or run its tool's path on the full model. See docs/view.md.",
    )
    add = replay.add_argument
    add("file", type=_path, metavar="FILE.h5", help="the recording")
    add("--full", action="store_true", help="run the path on the full model, and print how far the recorded one was")
    add("--scene", metavar="MODULE:FUNCTION", help="with --full: your own scene, which the recording must name")
    add("--png", type=_path, metavar="FILE.png", help="draw the moment of the largest force")
    add("--movie", type=_path, metavar="FILE", help="draw all: .gif, or .mp4 with palpate[film]")
    add("--scalar", default="displacement", metavar="NAME", help="displacement, stress or pressure, by colour")
    _add_address(replay)


def _add_address(parser: Any) -> None:
    add = parser.add_argument
    add("--port", type=_whole, default=8765, metavar="N", help="of the page; the next free one if it is busy (8765)")
    add("--host", default="127.0.0.1", metavar="ADDRESS", help="of this machine; others let other machines in")
    add("--no-browser", action="store_false", dest="browser", help="print the address only")


def _add_fit(commands: Any) -> None:
    fit = commands.add_parser(
        "fit",
        help="find a law's parameters from measured curves",
        description="Fit a law to curves of nominal stress from CSV files with units, and leave a report with standard "
        "errors and the law's stability, and a picture, in a folder. See docs/fitting.md for the files.",
    )
    add = fit.add_argument
    add("law", metavar="LAW", help="name of a law, such as NeoHookean or mooney-rivlin")
    add("data", type=_path, nargs="+", metavar="DATA.csv", help="files of curves, fitted together")
    several: dict[str, Any] = {"action": "extend", "nargs": "+", "default": []}
    add("--start", **several, metavar="NAME=X[,X]", help="where to start; how many terms a law of several has")
    add("--bounds", **several, metavar="NAME=LOW,HIGH", help="range of a parameter")
    add("--fix", **several, dest="fixed", metavar="NAME=X[,X]", help="parameters that are not fitted")
    add("--starts", type=_whole, default=8, metavar="K", help="how many starts (8)")
    add("--seed", type=_whole, default=0, metavar="K", help="of the other starts (0)")
    add("--poisson", type=float, default=0.5, metavar="NU", help="0.5 (as it is) or at most 0.499")
    add("--density", type=float, default=1060.0, metavar="RHO", help="of the material [kg/m^3] (1060)")
    _add_results(fit, Path("out/fit"))


def _add_check(commands: Any) -> None:
    check = commands.add_parser(
        "check",
        help="examine an organ's surface and fill it with nodes",
        description="Read a closed surface (STL, OBJ, PLY, OFF, GLB, VTK), say what is wrong with it, fill it with "
        "nodes if nothing is, and leave a report with pictures in a folder. See docs/organs.md.",
    )
    add = check.add_argument
    add("file", type=_path, metavar="FILE", help="the surface")
    add("--spacing", type=float, metavar="M", help="distance between nodes [m] (one that gives some 4,000)")
    add("--part", metavar="NAME", help="which part of a file of several")
    add("--units", choices=("m", "cm", "mm", "in"), help="of the file (guessed, with a warning)")
    add("--repair", action="store_true", help="close small holes, turn triangles, smooth folds, drop specks")
    add("--seed", type=_whole, default=0, metavar="K", help="of the nodes' places (0)")
    _add_results(check, Path("out/check"))


def _add_compare(commands: Any) -> None:
    compare = commands.add_parser(
        "compare", help="linear reductions side by side", description="Costs, stability, errors: docs/linear.md."
    )
    add = compare.add_argument
    add("body", choices=["beam", "liver"], help="the paper's beam, pulled; or the generated liver, a tool at its front")
    add("--modes", type=_whole, nargs="+", default=[4, 8, 16, 24], metavar="M", help="sizes (4 8 16 24)")
    add("--methods", nargs="+", metavar="NAME", help="some of the methods (all)")
    add("--spacing", type=float, metavar="M", help="distance between nodes [m] (beam 0.005, liver 0.012)")
    add("--poisson", type=float, metavar="NU", help="Poisson's ratio (0.49; liver 0.45)")
    add("--condense", type=_whole, metavar="K", help="slowest modes to balance instead of all unknowns (240); 0: all")
    _add_results(compare, Path("out/compare"))


def _add_bench(commands: Any) -> None:
    bench = commands.add_parser(
        "bench",
        help="measure the speed of full and reduced models, or of the page of palpate view",
        description="Measure full and reduced models in turn, and leave the medians in a folder: as JSON, and as a "
        "table in Markdown. All ratios are from one run; nothing else should keep the processors busy. "
        "`palpate bench page` presses a body in a headless Chromium instead.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    bench.add_argument("what", nargs="?", choices=["models", "page"], default="models", help="what is measured")
    bench.add_argument("--model", default="liver", metavar="SCENE", help="page: a scene, or a file of palpate train")
    bench.add_argument(
        "--vertices", type=_whole, default=10_000, metavar="N", help="page: drawn, or all of the surface's own"
    )
    bench.add_argument("--seconds", type=float, default=10.0, metavar="S", help="page: of pressing")
    bench.add_argument("--fine", action="store_true", help="models: measure the beam at 2.5 mm, too (some ten minutes)")
    bench.add_argument("--repeats", type=_whole, default=3, metavar="K", help="models: rounds of the long runs")
    _add_results(bench, Path("out/bench"))


def _add_laws(commands: Any) -> None:
    laws = commands.add_parser(
        "laws",
        help="list the material laws, with parameters, units and ranges",
        description="List every material law: its energy, parameters with units and ranges, and source.",
    )
    laws.add_argument("--json", action="store_true", dest="as_json", help="print the list as JSON")
