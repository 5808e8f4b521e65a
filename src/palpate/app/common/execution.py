"""Run a command line: parse it, import and call the command, convert its errors to an exit status."""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

from palpate.app.common.arguments import COMMAND_KEY, PARSER_KEY, Parser, in_option_words, unprintable_word
from palpate.app.common.exit_status import (
    BAD_INPUT,
    DONE,
    FAILED,
    INTERRUPTED,
    RunError,
    complain,
    report_defect,
    silence_output,
    system_error,
)
from palpate.core.working_folder import guard_matplotlib


def execute(build_parser: Callable[[], Parser], words: Sequence[str]) -> int:
    """Run a command line and return its exit code; there is one line on standard error if it is not 0.

    The commands of the parser were added by `palpate.app.common.arguments.add_command`.
    """
    guard_matplotlib()
    try:
        with _warnings_of_one_line():
            code = _run(build_parser, words)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever read the output has enough
        return silence_output()
    except OSError as error:  # standard output cannot be written
        silence_output()
        return complain(f"cannot write the output: {error.strerror or error}", FAILED)


@contextmanager
def _warnings_of_one_line() -> Iterator[None]:
    """Print warnings without the place in the sources."""
    before = warnings.formatwarning
    warnings.formatwarning = lambda message, *_: f"palpate: warning: {message}\n"
    try:
        yield
    finally:
        warnings.formatwarning = before


def _run(build_parser: Callable[[], Parser], words: Sequence[str]) -> int:
    if why := unprintable_word(words):
        return complain(why, BAD_INPUT)
    parser = build_parser()
    if "_ARGCOMPLETE" in os.environ:
        return _complete(parser)
    try:
        options = vars(parser.parse_args(words))
    except SystemExit as end:  # after --help, --version, or a complaint
        if end.code:
            raise
        return DONE
    if COMMAND_KEY not in options:  # nothing but `palpate`
        parser.print_help()
        return DONE
    return _call(options.pop(PARSER_KEY), options.pop(COMMAND_KEY), options)


def _complete(parser: Parser) -> int:
    """Answer a shell that completes a command line, and run nothing: see docs/reference/cli.md."""
    try:
        import argcomplete
    except ImportError:
        return FAILED
    argcomplete.autocomplete(parser)
    return DONE


def _call(parser: Parser, place: str, options: dict[str, Any]) -> int:
    """Import and run a command, ``"module:function"``."""
    try:
        with _ending_at_interrupt():
            module, function = place.split(":")
            command = getattr(import_module(module), function)
        return int(command(**options))
    except BrokenPipeError:
        raise
    except KeyboardInterrupt as interrupt:
        return complain(" ".join(["interrupted", *map(str, interrupt.args)]), INTERRUPTED)
    except MemoryError:
        return complain("out of memory; take a larger spacing, fewer modes, or fewer snapshots", FAILED)
    except Exception as error:
        return _failed(error, parser, options)


def _failed(error: Exception, parser: Parser, options: Mapping[str, Any]) -> int:
    """Print one line about an error; an unexpected one is a defect of palpate."""
    from palpate.core.faults import ChoiceError, DivergenceError, InputError

    if isinstance(error, ChoiceError):
        print(error.table, file=sys.stderr)
        return complain(
            f"{in_option_words(str(error), parser, options)}: {_with_choice(error, parser, options)}", BAD_INPUT
        )
    if isinstance(error, InputError):
        return complain(in_option_words(str(error), parser, options), BAD_INPUT)
    if isinstance(error, OSError):
        return complain(system_error(error), BAD_INPUT if isinstance(error, FileNotFoundError) else FAILED)
    if isinstance(error, RunError | DivergenceError):
        return complain(str(error), FAILED)
    return report_defect(error)


def _with_choice(error: Any, parser: Parser, options: Mapping[str, Any]) -> str:
    """Return the command that makes the choice of an error."""
    from shlex import quote

    files = [str(options[name]) for name in ("source", "file", "scene", "model") if options.get(name)]
    words = [word for name, value in error.choice.items() for word in (f"--{name}", quote(value))]
    return " ".join([parser.prog, *map(quote, files[:1]), *words])


@contextmanager
def _ending_at_interrupt() -> Iterator[None]:
    """End the program at once at an interrupt; imported modules can swallow `KeyboardInterrupt`."""
    main_thread = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT) if main_thread else None
    if before is not signal.default_int_handler:  # ignored, or a handler of another module
        yield
        return

    def end(number: int, frame: object) -> None:
        with suppress(OSError):
            os.write(2, b"palpate: interrupted\n")
        os._exit(INTERRUPTED)

    signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
