"""The command ``palpate``.

Only the standard library is imported before a command runs, so that ``--help`` and ``--version`` answer at once.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from palpate import __version__

__all__ = ["main"]

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line.

    Parameters
    ----------
    argv : sequence of str, optional
        The words after ``palpate``; by default those of this process.

    Returns
    -------
    int
        0 when all went well, 1 when a run diverged or a file could not be written, 2 for bad input, 130 when
        interrupted.
    """
    options = _parser().parse_args(argv)
    from palpate.app.reproduce import ReproduceError, reproduce_beam
    from palpate.faults import InputError

    try:
        return reproduce_beam(
            spacing=options.spacing,
            load=options.load,
            poisson=options.poisson,
            modes=options.modes,
            out=options.out,
            as_json=options.json,
        )
    except InputError as error:
        return _complain(str(error), BAD_INPUT)
    except (ReproduceError, OSError) as error:
        return _complain(str(error), FAILED)
    except KeyboardInterrupt as interrupt:
        return _complain(" ".join(["interrupted", *map(str, interrupt.args)]), INTERRUPTED)


def _complain(message: str, code: int) -> int:
    print(f"palpate: {' '.join(message.split())}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="palpate",
        description="Real-time simulation of hyperelastic soft tissue by point collocation and model reduction.",
    )
    parser.add_argument("--version", action="version", version=f"palpate {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    reproduce = commands.add_parser("reproduce", help="run an example of the paper and compare with its figures")
    examples = reproduce.add_subparsers(dest="example", required=True, metavar="EXAMPLE")
    beam = examples.add_parser(
        "beam",
        help="the beam under traction: section 6.1, Figures 3 to 5",
        description="Run the paper's beam under traction with the full model and with reduced ones, and leave a "
        "report, figures, the snapshots and a file for ParaView in a folder.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = beam.add_argument
    add("--spacing", type=float, default=0.005, metavar="M", help="distance between nodes [m], at most 0.00666")
    add("--load", type=float, default=100.0, metavar="N", help="largest force [N], reached at 0.5 s")
    add("--poisson", type=float, default=0.49, metavar="NU", help="Poisson's ratio, at most 0.499")
    add("--modes", type=int, nargs="+", default=[2, 4, 6, 8, 10, 12], metavar="M", help="sizes of reduced models")
    add("--out", type=Path, default=Path("out/beam"), metavar="FOLDER", help="where the results go")
    add("--json", action="store_true", help="print the report as JSON instead of a table")
    return parser
