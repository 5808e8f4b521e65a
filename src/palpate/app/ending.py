"""Words of the command line, and how a command ends: one line on standard error, and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import traceback
from contextlib import suppress
from pathlib import Path
from typing import NoReturn
from unicodedata import category

__all__ = [
    "BAD_INPUT", "DEBUG", "DONE", "FAILED", "INTERRUPTED", "Parser", "closed", "complain", "failed", "path", "refused",
    "whole",
]  # fmt: skip

DONE, FAILED, BAD_INPUT, DEFECT, INTERRUPTED = 0, 1, 2, 70, 130
DEBUG = "PALPATE_DEBUG"  # environment variable: 1 prints the traceback of an internal error
LONGEST_WORD, LONGEST_NAME, LONGEST_COMPLAINT = 4095, 255, 1000  # characters; bytes of a name in a folder
UNPRINTABLE = ("Cc", "Cs")  # categories of characters: controls, halves of surrogate pairs
LARGEST_WHOLE = 2**53  # whole numbers beyond are not exact in the reports


class Parser(argparse.ArgumentParser):
    """A parser whose complaints are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {_line(message)} (see {self.prog} --help)\n")


def complain(message: str, code: int) -> int:
    """Print a message as one line on standard error; return the exit code."""
    with suppress(OSError):
        print(f"palpate: {_line(message)}", file=sys.stderr)
    return code


def _line(message: str) -> str:
    """Return a message as one line of printable characters."""
    line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in " ".join(message.split()))
    return line if len(line) <= LONGEST_COMPLAINT else line[: LONGEST_COMPLAINT - 3] + "..."


def path(text: str) -> Path:
    """Return a path that a file system takes."""
    if not text or any(len(os.fsencode(part)) > LONGEST_NAME for part in text.split("/")):
        raise argparse.ArgumentTypeError(f"must be a path of names of 1 to {LONGEST_NAME} bytes, got {text!r:.60}")
    return Path(text)


def whole(text: str) -> int:
    """Return a whole number that is exact in every report."""
    try:
        number = int(text)
    except ValueError:
        number = LARGEST_WHOLE + 1
    if abs(number) > LARGEST_WHOLE:
        raise argparse.ArgumentTypeError(f"must be a whole number of at most 2^53, got {text!r:.60}")
    return number


def failed(error: Exception) -> int:
    """Say what went wrong in one line; what is none of the known faults is a defect of palpate."""
    from palpate.app.study import ReproduceError
    from palpate.faults import DivergenceError, InputError

    if isinstance(error, InputError | FileNotFoundError):
        return complain(str(error), BAD_INPUT)
    if isinstance(error, ReproduceError | DivergenceError | OSError):
        return complain(str(error), FAILED)
    if os.environ.get(DEBUG) == "1":
        traceback.print_exception(error)
        return DEFECT
    where = f"what {DEBUG}=1 prints"
    with suppress(OSError):
        handle, where = tempfile.mkstemp(prefix="palpate-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write("".join(traceback.format_exception(error)))
    return complain(f"internal error: {type(error).__name__}: {error}; report it with {where}", DEFECT)


def closed() -> int:
    """Let nothing more be written to a standard output that takes nothing; return the exit code."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


def refused(words: list[str]) -> str | None:
    """Return why words are no command line, or None: they are text without control characters."""
    for k, word in enumerate(words):
        if len(word) > LONGEST_WORD or any(category(letter) in UNPRINTABLE for letter in word):
            return (
                f"argument {k + 1} must be printable text of at most {LONGEST_WORD} characters, got "
                f"{word!r:.60}; rename the file or leave such characters out"
            )
    return None
