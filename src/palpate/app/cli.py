"""The command ``palpate``.

Every command has its parser next to it, in ``parser.py`` of its folder. Only the standard library is imported until one
of them runs, so that ``--help`` and ``--version`` answer at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from palpate import __version__
from palpate.app.documentation import documentation

CLI_DESCRIPTION = """\
Simulate soft tissue in real time: point collocation, model reduction, and a tool at 1 kHz.

first steps:
  palpate reproduce beam    first: run the paper's beam, and read out/beam/report.md
  palpate view beam         second: press and pull the beam on a page in the browser
  palpate view organ.stl    third: press an organ of your own, at once
  palpate new organ.stl     then: write organ.toml, its tissue, supports and tools, for view, run and train
"""
CLI_EPILOG = """\
palpate COMMAND --help describes a command and its options.

exit status: 0 done; 1 a run diverged, a file could not be written, or memory ran out; 2 bad input; 70 a defect of
palpate, whose traceback is left in a file, or printed with PALPATE_DEBUG=1; 130 interrupted.

Pages that help texts call docs/NAME.md are in {folder}.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line, by default that of this process, and return its exit code.

    `argv` are the words after ``palpate``. The code is 0 when all went well, and 2 for bad input. It is 1 when a run
    diverged, a file could not be written or memory ran out. It is 70 for an internal error, a defect of palpate, and
    130 when interrupted.
    """
    try:
        from palpate.app.common.execution import execute

        return execute(build_parser, sys.argv[1:] if argv is None else list(argv))
    except KeyboardInterrupt:  # before the command began
        print("palpate: interrupted", file=sys.stderr)
        return 130


def build_parser() -> Any:
    """Return the parser of all commands, an `argparse.ArgumentParser`."""
    from argparse import RawDescriptionHelpFormatter

    from palpate.app.check.parser import add_check
    from palpate.app.common.arguments import Parser
    from palpate.app.common.compiled_code import add_cache_option
    from palpate.app.export.parser import add_export
    from palpate.app.fit.parser import add_fit
    from palpate.app.laws.parser import add_laws
    from palpate.app.new.parser import add_new
    from palpate.app.run.parser import add_run
    from palpate.app.studies.parser import add_reproduce
    from palpate.app.train.parser import add_train
    from palpate.app.view.parser import add_replay, add_view

    parser = Parser(
        "palpate",
        description=CLI_DESCRIPTION,
        epilog=CLI_EPILOG.format(folder=documentation()).replace("%", "%%"),
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"palpate {__version__}")
    add_cache_option(parser)
    commands = parser.add_subparsers(metavar="COMMAND")
    for add in (
        add_reproduce, add_view, add_new, add_train, add_run, add_replay, add_check, add_fit, add_laws, add_export,
    ):  # fmt: skip
        add(commands)
    return parser
