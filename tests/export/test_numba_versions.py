"""The oldest Numba that is supported exports the same functions as the present one."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import numpy as np
import pytest
from exported import Library, step_through

ROOT = Path(__file__).parents[2]
NEEDED = ("scipy", "h5py", "platformdirs", "rich", "websockets")


@pytest.fixture(scope="module")
def oldest(tmp_path_factory):
    """The Python of an environment with the oldest Numba."""
    dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    numba = next(each for each in dependencies if each.startswith("numba")).replace(">=", "==") + ".*"
    folder = tmp_path_factory.mktemp("oldest")
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    done = subprocess.run(
        [python, "-m", "pip", "install", "--quiet", numba, *NEEDED], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        pytest.skip(f"{numba} cannot be installed: {done.stderr.strip().splitlines()[-1:]}")
    return python


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="runs a POSIX environment")
def test_the_oldest_numba_exports_the_same(oldest, model_file, exported_folder, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    command = [oldest, "-P", "-m", "palpate", "export", str(model_file), "--c", str(tmp_path / "organ")]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    libraries = [Library(folder, "organ") for folder in (tmp_path / "organ", exported_folder)]
    records = [step_through(library, 400, True)[0] for library in libraries]
    np.testing.assert_array_equal(*records)
