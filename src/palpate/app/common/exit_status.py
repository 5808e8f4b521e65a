"""End of a command: one line on standard error, and an exit status. This module imports only the standard library."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

DONE, FAILED, BAD_INPUT, UNTRUSTED, DEFECT, INTERRUPTED = 0, 1, 2, 3, 70, 130
DEBUG_VARIABLE = "PALPATE_DEBUG"  # environment variable: 1 prints the traceback of an internal error
MAX_MESSAGE_CHARACTERS = 1000  # characters


class RunError(RuntimeError):
    """A command that failed; the message names the results that are kept."""


def complain(message: str, code: int) -> int:
    """Print a message as one line on standard error; return the exit code."""
    with suppress(OSError):
        print(f"palpate: {one_line(message)}", file=sys.stderr)
    return code


def one_line(message: str) -> str:
    """Return a message as one line of printable characters."""
    line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in " ".join(message.split()))
    return line if len(line) <= MAX_MESSAGE_CHARACTERS else line[: MAX_MESSAGE_CHARACTERS - 3] + "..."


def system_error(error: OSError) -> str:
    """Return the message of an error of the operating system, without its number."""
    if error.errno is None or error.strerror is None or error.filename is None:
        return str(error)
    if isinstance(error, FileNotFoundError):
        return f"there is no file {str(error.filename)!r}"
    return f"{str(error.filename)!r}: {error.strerror.lower()}"


def report_defect(error: Exception) -> int:
    """Report an unexpected error, and write its traceback to a file; return the exit code."""
    import tempfile
    import traceback

    if os.environ.get(DEBUG_VARIABLE) == "1":
        traceback.print_exception(error)
        return DEFECT
    where = f"what {DEBUG_VARIABLE}=1 prints"
    with suppress(OSError):
        handle, where = tempfile.mkstemp(prefix="palpate-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write("".join(traceback.format_exception(error)))
    return complain(f"internal error: {type(error).__name__}: {error}; report it with {where}", DEFECT)


def silence_output() -> int:
    """Ignore output to a closed stdout; return the exit code."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED
