"""Command line: parsers, types of options, and shared options.

Parsers import the standard library and declarations of parameters only, so that ``palpate --help`` answers at once.
"""

from __future__ import annotations

import argparse
import os
import re
import stat
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn
from unicodedata import category

from palpate.app.common.exit_status import BAD_INPUT, one_line
from palpate.core.faults import FileFormatError
from palpate.surface.formats.first_bytes import refuse_misnamed

COMMAND_KEY, PARSER_KEY = " command", " parser"  # names that no option has
MAX_ARGUMENT_CHARACTERS, MAX_NAME_BYTES = 4095, 255  # characters; bytes of a name in a folder
UNPRINTABLE_CATEGORIES = ("Cc", "Cs")  # categories of characters: controls, halves of surrogate pairs
MAX_EXACT_INTEGER = 2**53  # whole numbers beyond are not exact in the reports
ARGPARSE_MESSAGES = {  # of argparse, in the form of palpate's own messages
    r"argument (\S+): (must .*)": r"\1 \2",
    r"argument (\S+): expected one argument": r"\1 must be followed by a value",
    r"argument (\S+): expected at least one argument": r"\1 must be followed by at least one value",
    r"argument (\S+): ignored explicit argument (.*)": r"\1 must be given without a value, got \2",
    r"argument (\S+): (.*)": r"\1: \2",
    r"the following arguments are required: (.*)": r"\1 must be given",
}


class _Formatter(argparse.HelpFormatter):
    """Formatter of help texts: writes every default in the same form after its sentence."""

    def _get_help_string(self, action: argparse.Action) -> str:
        text, value = action.help or "", action.default
        if "(default:" in text or value in (None, argparse.SUPPRESS, []) or isinstance(value, bool):
            return text
        shown = " ".join(map(str, value)) if isinstance(value, list) else value
        return f"{text} (default: {f'{shown:g}' if isinstance(shown, float) else shown})"


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, with the nearest known word and the help of its command."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        options.setdefault("formatter_class", _Formatter)
        super().__init__(*arguments, **options)
        self.renamed: dict[str, str] = {}  # options of earlier versions, and their successors
        self.moved: dict[str, str] = {}  # former options, and the commands that do the same now
        self.synonyms: dict[str, str] = {}  # arguments of the library, and the options that they come from
        self.assignments: dict[str, str] = {}  # destinations of options with values ``NAME=X``, and these options

    def error(self, message: str) -> NoReturn:
        for pattern, words in ARGPARSE_MESSAGES.items():
            if re.fullmatch(pattern, message, re.DOTALL):
                message = re.sub(pattern, words, message, flags=re.DOTALL)
                break
        if self._choices() and message.endswith("must be given"):
            message = f"{message}: {', '.join(self._choices())}"
        self.exit(BAD_INPUT, f"{self.prog}: {one_line(message)} (see {self.prog} --help)\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        words = list(args or ())
        if not self._choices():  # those of a command with others inside belong to the inner ones
            for word in words[: words.index("--")] if "--" in words else words:
                self._check_option(word)
        options, left = super().parse_known_args(words, namespace)
        if left:
            self.error(f"{left[0]!r:.60} is not expected here")
        return options, left

    def _choices(self) -> list[str]:
        """Return the names of the subcommands."""
        inner = [action for action in self._actions if isinstance(action, argparse._SubParsersAction)]
        return [name for action in inner for name in action.choices]

    def _check_option(self, word: str) -> None:
        """Report an unknown option of the command."""
        name, options = word.partition("=")[0], list(self._option_string_actions)
        if not name.startswith("--") or " " in word or any(each.startswith(name) for each in options):
            return
        if name in self.renamed:
            self.error(f"{name} is now called {self.renamed[name]}; give {self.renamed[name]} instead")
        if name in self.moved:
            self.error(f"{name} is now of another command; use {self.moved[name]}")
        self.error(f"{name!r:.60} is not an option of {self.prog}{suggestion(name, options)}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            choices = [str(choice) for choice in action.choices]
            raise argparse.ArgumentError(
                action, f"must be one of {', '.join(choices)}, got {value!r:.60}{suggestion(str(value), choices)}"
            )


def suggestion(word: str, choices: Sequence[str]) -> str:
    """Return the text "did you mean ...?" with the nearest choice; empty without a near one."""
    from difflib import get_close_matches

    near = get_close_matches(word[:60], choices, 1)
    return f"; did you mean {near[0]}?" if near else ""


def add_command(commands: Any, name: str, function: str, *, summary: str, description: str) -> Parser:
    """Add a command to the subparsers of a parser.

    `function`, ``"module:function"``, runs it: it takes the options by name, and returns the exit code. `summary` is
    its line in the help of all commands, `description` its own help.
    """
    parser: Parser = commands.add_parser(name, help=summary, description=description)
    parser.set_defaults(**{COMMAND_KEY: function, PARSER_KEY: parser})
    return parser


def add_parameter(parser: Any, section: type, name: str, note: str = "", **options: Any) -> None:
    """Add the option of a parameter of a scene file, whose type, range, choices and help are those of its declaration.

    `section` is one of `palpate.scenes.description`; `options` are further arguments of ``add_argument``. A note
    follows the help; with one the option has no default, otherwise that of the declaration.
    """
    from palpate.core.parameters import fields_of

    field, kind = fields_of(section)[name]
    about, unit = field.metadata, field.metadata["unit"]
    keywords: dict[str, Any] = {"help": f"{about['help'].partition(';')[0]}{f' [{unit}]' if unit else ''}{note}"}
    if kind is bool:
        keywords["action"] = "store_true"
    elif about["choices"]:
        keywords["choices"] = about["choices"]
    else:
        whole_number = kind is int
        keywords |= {"type": _parameter_type(about, whole_number), "metavar": unit.upper() or "KX"[not whole_number]}
        keywords |= {} if note else {"default": field.default}
    parser.add_argument(f"--{name.replace('_', '-')}", **keywords | options)


def _parameter_type(about: Mapping[str, Any], is_whole: bool) -> Callable[[str], float]:
    """Return the type of an option: a number in the range of a declaration, or a text with a unit such as ``5mm``."""

    def parse(text: str) -> float:
        from palpate.core.faults import InputError
        from palpate.core.parameters import check_number

        try:
            return int(check_number(whole(text), about)) if is_whole else check_number(text, about)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def add_output(parser: argparse.ArgumentParser, out: str) -> None:
    """Add the options about results that every study has: its folder, and JSON in place of tables."""
    parser.add_argument("--out", type=path, default=Path(out), metavar="FOLDER", help="folder for the results")
    add_json(parser, "the report")


def add_parts(parser: Any) -> None:
    """Add the option that chooses parts of a surface file."""
    text = (
        "part of a file of several, by its name or a pattern such as '*lobe*'; may be repeated (default: the largest "
    )
    text += "closed one, if it is around all others); of a label map also a number, several are one body"
    parser.add_argument("--part", action="append", metavar="NAME", help=text)
    text = "leave out a label that lies in the organ of a label map and would join it; may be repeated"
    parser.add_argument("--without", action="append", default=[], metavar="NAME", help=text)
    text = "names that a label map lacks: JSON, a color table (.ctbl), or lines of a number and a name"
    parser.add_argument("--labels", type=existing_file, metavar="FILE", help=text)


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the option that prints JSON for other programs."""
    parser.add_argument("--json", action="store_true", dest="as_json", help=f"print {what} as JSON, for other programs")


def add_yes(parser: argparse.ArgumentParser) -> None:
    """Add the option that skips the question before work of minutes."""
    text = "begin work of minutes without a question; a script, which has no terminal, is not asked"
    parser.add_argument("-y", "--yes", action="store_true", help=text)


def path(text: str) -> Path:
    """Return a path that a file system accepts."""
    if not text or any(len(os.fsencode(part)) > MAX_NAME_BYTES for part in text.split("/")):
        raise argparse.ArgumentTypeError(f"must be a path of names of 1 to {MAX_NAME_BYTES} bytes, got {text!r:.60}")
    return Path(text)


def existing_file(text: str) -> Path:
    """Return the path of a regular file; a pipe or a device would block its reader."""
    file_path = path(text)
    try:
        kind = os.stat(file_path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise argparse.ArgumentTypeError(f"must be an existing file, got {text!r}; there is no such file") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise argparse.ArgumentTypeError(f"must be a file that can be read, got {text!r} ({why})") from None
    if not stat.S_ISREG(kind):
        try:
            refuse_misnamed(file_path)
        except FileFormatError as error:
            raise argparse.ArgumentTypeError(f"must be a file: {error}") from None
        what = "a folder" if stat.S_ISDIR(kind) else "a pipe, socket or device"
        raise argparse.ArgumentTypeError(f"must be a regular file, got {text!r}, which is {what}")
    return file_path


def whole(text: str) -> int:
    """Return a whole number that is exact in every report."""
    try:
        value = int(text)
    except ValueError:
        value = MAX_EXACT_INTEGER + 1
    if abs(value) > MAX_EXACT_INTEGER:
        raise argparse.ArgumentTypeError(f"must be a whole number of at most 2^53, got {text!r:.60}")
    return value


def number(text: str) -> float:
    """Return a number; the command checks its range."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r:.60}") from None


def unprintable_word(words: Sequence[str]) -> str | None:
    """Return an error text for the first word that is unprintable or too long, or None."""
    for k, word in enumerate(words):
        if len(word) > MAX_ARGUMENT_CHARACTERS or any(category(letter) in UNPRINTABLE_CATEGORIES for letter in word):
            return (
                f"argument {k + 1} must be printable text of at most {MAX_ARGUMENT_CHARACTERS} characters, got "
                f"{word!r:.60}; rename the file or leave such characters out"
            )
    return None


def in_option_words(message: str, parser: Parser, options: Mapping[str, Any]) -> str:
    """Return a message of the library with options of the command in place of arguments.

    ``spacing must be ...`` becomes ``--spacing must be ...``, or ``--set spacing must be ...`` for a setting.
    ``choose one with part='left'`` becomes ``choose one with --part 'left'``.
    """
    names = {
        pair.partition("=")[0]: f"{option} {pair.partition('=')[0]}"
        for place, option in parser.assignments.items()
        for pair in options[place]
    }
    names |= {action.dest: _option_name(action) for action in parser._actions} | parser.synonyms
    pattern = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))

    def keyword(match: re.Match[str]) -> str:
        value = match[2]
        return names[match[1]] + ("" if value in ("", "True") else f" {value}")

    message = re.sub(rf"(?:^|(?<=: ))({pattern})(?= (?:must|=|is|cannot) |:)", lambda match: names[match[1]], message)
    return re.sub(rf"(?<![\w.-])({pattern})=(True|[\w'\"]*)", keyword, message)


def option_names(message: str) -> str:
    """Return a note about a surface with its arguments as options: ``give units= to be sure``, ``scale=0.1``."""
    return re.sub(
        r"\b(part|without|scale|units|labels)=(\S*)", lambda match: f"--{match[1]} {match[2]}".rstrip(), message
    )


def _option_name(action: argparse.Action) -> str:
    if action.option_strings:
        return max(action.option_strings, key=len)
    return action.metavar if isinstance(action.metavar, str) else action.dest.upper()


def split_settings(pairs: Sequence[str]) -> dict[str, str]:
    """Return the names and the texts of settings such as ``poisson=0.4``."""
    from palpate.core.faults import InputError

    settings = {}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign or not name.strip():
            raise InputError(f"--set must be NAME=VALUE, got {pair!r:.60}; give one such as spacing=0.005")
        settings[name.strip()] = text
    return settings


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """Return the settings of texts such as ``poisson=0.4``; a value is one of TOML, or else a text such as ``5 mm``."""
    import tomllib

    from palpate.core.files import check_nesting

    settings: dict[str, Any] = {}
    for name, text in split_settings(pairs).items():
        try:
            check_nesting(text, "TOML")
            settings[name] = tomllib.loads(f"value = {text}")["value"]
        except ValueError:  # also a whole number of thousands of digits, or very deep lists
            settings[name] = text
    return settings
