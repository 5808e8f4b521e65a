"""Result files of studies, docs/validation/NAME.json: figures, and by which command, commit and machine they were made.

    python validation/result_files.py NAME report.json "palpate reproduce beam" ["next to other work"]

keeps a report of `palpate reproduce`, `speed.py` or `linear_reductions.py` as the result file NAME, with a note on
the machine. A file holds ``results``, what the study found in SI units, and ``made``, one entry for every command that
wrote it: command, commit, date, machine and code. `docs/figures.py` makes the tables of the docs from these files.
Command and machine of runs until 2026-11-25 were added later; their commit is the one that last changed the figures.

The code of an entry has a digest for each folder of src/palpate that the command imported, and for each script. A
result is older than the code where one of them differs today: `changed` lists these. Comments, docstrings, annotations
and the texts of errors are not in a digest, and neither is `palpate.core` (errors, files, figures).
"""

from __future__ import annotations

import ast
import datetime
import hashlib
import json
import os
import platform
import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "validation"
PACKAGE = "src/palpate"
MECHANICS = f"{PACKAGE}/dynamics"
# code from which no figure follows: errors and files; the writers of results
UNCOUNTED = (f"{PACKAGE}/core", "validation/result_files.py")
# entries of reports that no table has
OMITTED = ("machine", "singular_values", "hankel_singular_values", "summary", "paper", "missing")


def read(name: str, default: Any) -> Any:
    """Return the results of a study, or `default` if there are none yet."""
    path = FOLDER / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))["results"] if path.is_file() else default


def write(name: str, results: Any, command: str | None = None, note: str = "") -> None:
    """Write the results of a study, and by which command, commit, machine and code they were made.

    A note says what else matters to times, by default that the machine had other work.
    """
    path = FOLDER / f"{name}.json"
    made = json.loads(path.read_text(encoding="utf-8"))["made"] if path.is_file() else []
    command, note = command or this_command(), note or other_work()
    entry = {
        "command": command, "commit": commit(), "date": datetime.date.today().isoformat(), "machine": machine(),
        **({"note": note} if note else {}), "code": code(command),
    }  # fmt: skip
    made = [each for each in made if each.get("command") != command]
    path.write_text(text({"made": [*made, entry], "results": results}), encoding="utf-8")


def text(content: dict[str, Any]) -> str:
    """Return JSON with a line for each row of a list, so that a changed row is a changed line."""
    return "{\n" + ",\n".join(f"{json.dumps(name)}: {_lines(value)}" for name, value in content.items()) + "\n}\n"


def _lines(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + ",\n".join(map(json.dumps, value)) + "\n]"
    if isinstance(value, dict) and any(isinstance(each, dict | list) for each in value.values()):
        return "{\n" + ",\n".join(f"{json.dumps(name)}: {_lines(each)}" for name, each in value.items()) + "\n}"
    return json.dumps(value)


def this_command() -> str:
    """Return the command line of this process, with paths below the repository."""
    script = Path(sys.argv[0]).resolve()
    place = script.relative_to(ROOT).as_posix() if script.is_relative_to(ROOT) else script.name
    return shlex.join(["python", place, *(_within(word) for word in sys.argv[1:])])


def _within(word: str) -> str:
    """Return an argument, an absolute path by its name alone."""
    return Path(word).name if Path(word).is_absolute() else word


def commit() -> str:
    """Return the commit of the sources, with "+" if they were changed since; "unknown" outside a clone."""
    try:
        git = ["git", "-C", str(ROOT)]
        head = subprocess.run([*git, "rev-parse", "--short", "HEAD"], check=True, capture_output=True, text=True)
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", "src", "validation"], capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head.stdout.strip() + "+" * (changed.returncode != 0)


def machine() -> str:
    """Return cores, processor and system of this machine."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        names = [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        processor = names[0] if names else processor
    return f"{os.cpu_count()} cores, {processor}, {platform.system()}"


def other_work() -> str:
    """Return a note if more processes wait for this machine's cores than it has; empty where that is not known."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return f"next to other work (load {load:.0f})" if load > (os.cpu_count() or 1) + 0.5 else ""


def code(command: str) -> dict[str, str]:
    """Return the digest of each folder and script that a command of this process depends on, by path.

    A command whose process has imported no mechanics ran it in others: it depends on all folders but those of `app`.
    """
    scripts, folders = set(re.findall(r"[\w/]+\.py", command)), set()
    for module in list(sys.modules.values()):
        file = Path(getattr(module, "__file__", None) or ROOT.parent).resolve()
        if not file.is_relative_to(ROOT):
            continue
        place = file.relative_to(ROOT)
        if place.is_relative_to(PACKAGE):
            folders.add(place.parent.as_posix())
        elif place.parts[0] in ("validation", "benchmarks"):
            scripts.add(place.as_posix())
    if not any(folder.startswith(MECHANICS) for folder in folders):
        every = {file.parent.relative_to(ROOT).as_posix() for file in (ROOT / PACKAGE).rglob("*.py")}
        folders |= {folder for folder in every if not folder.startswith(f"{PACKAGE}/app")}
    counted = {place for place in {*scripts, *folders} if not place.startswith(UNCOUNTED)} - {PACKAGE}
    return {place: digest(ROOT / place) for place in sorted(counted)}


def changed(entry: dict[str, Any]) -> list[str] | None:
    """Return the folders and scripts whose code differs from that of an entry; None if the entry has none."""
    if "code" not in entry:
        return None
    return [place for place, before in entry["code"].items() if digest(ROOT / place) != before]


@cache
def digest(place: Path) -> str:
    """Return a digest of what the modules of a folder, or a script, execute; empty if there is none."""
    files = [place] if place.is_file() else sorted(place.glob("*.py"))
    described = [(file.name, _described(ast.parse(file.read_text(encoding="utf-8")))) for file in files]
    return hashlib.sha256(repr(described).encode()).hexdigest()[:8] if files else ""


def _described(part: Any) -> Any:
    """Return a part of a syntax tree as plain data, the same for all versions of Python."""
    if isinstance(part, list):
        return [_described(each) for each in part if not _is_text(each)]
    if not isinstance(part, ast.AST):
        return repr(part)
    if isinstance(part, ast.Raise):
        return "raise"
    fields = [(name, value) for name, value in ast.iter_fields(part) if name not in ("annotation", "returns")]
    return (type(part).__name__, *((name, _described(value)) for name, value in fields if value not in (None, [])))


def _is_text(part: Any) -> bool:
    """Return True for a statement that is a constant, such as a docstring."""
    return isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)


def main() -> None:
    """Keep a report of a command as a result file."""
    name, report, command, *note = sys.argv[1:]
    content = json.loads(Path(report).read_text(encoding="utf-8"))
    write(name, {key: value for key, value in content.items() if key not in OMITTED}, command, *note)


if __name__ == "__main__":
    main()
