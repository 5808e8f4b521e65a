"""Result files of studies, docs/validation/NAME.json: figures, and by which command, commit and machine they were made.

    python validation/result_files.py NAME report.json "palpate reproduce beam" ["next to other work"]

keeps a report of `palpate reproduce`, `speed.py` or `linear_reductions.py` as the result file NAME, with a note on
the machine. A file holds ``results``, what the study found in SI units, and ``made``, one entry for every command that
wrote it: command, commit, date and machine. `docs/figures.py` makes the tables of the docs from these files. Entries
without a machine are older than this module; their commit is the one that last changed the figures.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "validation"
# entries of reports that no table has
OMITTED = ("machine", "singular_values", "hankel_singular_values", "summary", "paper", "missing")


def read(name: str, default: Any) -> Any:
    """Return the results of a study, or `default` if there are none yet."""
    path = FOLDER / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))["results"] if path.is_file() else default


def write(name: str, results: Any, command: str | None = None, note: str = "") -> None:
    """Write the results of a study, and by which command, commit and machine (with a note) they were made."""
    path = FOLDER / f"{name}.json"
    made = json.loads(path.read_text(encoding="utf-8"))["made"] if path.is_file() else []
    entry = {
        "command": command or this_command(), "commit": commit(), "date": datetime.date.today().isoformat(),
        "machine": ", ".join(filter(None, [machine(), note])),
    }  # fmt: skip
    made = [each for each in made if each.get("command") != entry["command"]]
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


def main() -> None:
    """Keep a report of a command as a result file."""
    name, report, command, *note = sys.argv[1:]
    content = json.loads(Path(report).read_text(encoding="utf-8"))
    write(name, {key: value for key, value in content.items() if key not in OMITTED}, command, *note)


if __name__ == "__main__":
    main()
