"""The oldest Numba that is supported exports the same functions as the present one.

    python validation/oldest_numba.py

makes an environment with that Numba, which the network must provide, exports a block in both, and compares the steps
of the two libraries bit by bit. It takes some ten minutes, and ends with 1 where a bit differs.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

import numpy as np
from exported import Library, export, step_through, train

ROOT = Path(__file__).parents[1]
NEEDED_PACKAGES = ("scipy", "h5py", "platformdirs", "rich", "websockets")
COMPARED_PERIODS = 400


def oldest_environment(folder: Path) -> tuple[Path, str]:
    """Make an environment with the oldest Numba; return its Python and the requirement."""
    dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    numba = next(each for each in dependencies if each.startswith("numba")).replace(">=", "==") + ".*"
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", numba, *NEEDED_PACKAGES], check=True)
    return python, numba


def main() -> int:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python, numba = oldest_environment(folder / "oldest")
        train("NeoHookean", folder / "organ.rom")
        present = export(folder / "organ.rom", "--c", str(folder / "present" / "organ"))
        environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
        command = [python, "-P", "-m", "palpate", "export", str(folder / "organ.rom"), "--c", str(folder / "organ")]
        subprocess.run(command, env=environment, check=True)
        libraries = [Library(folder / "organ", "organ"), Library(present, "organ")]
        records = [step_through(library, COMPARED_PERIODS, True)[0] for library in libraries]
    equal = np.array_equal(*records)
    print(f"{numba}: {COMPARED_PERIODS} periods are {'equal in every bit' if equal else 'different'}")
    return 0 if equal else 1


if __name__ == "__main__":
    sys.exit(main())
