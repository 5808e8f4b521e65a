"""Programs run without a folder for compiled code, with a full disk, and with damaged code."""

from __future__ import annotations

import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import palpate
from palpate import code_cache
from palpate.code_cache import cached_njit


@pytest.fixture
def reasons(monkeypatch):
    monkeypatch.setattr(code_cache, "REASONS", code_cache._Reasons())


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    """Compiled code of functions made in the test goes to a folder of its own."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    return tmp_path


def double(x):
    return 2 * x


def test_a_function_runs_without_a_folder_for_its_code_and_one_warning_says_so(reasons, monkeypatch):
    monkeypatch.setattr(code_cache._SafeImpl, "_locator_classes", [])
    with pytest.warns(RuntimeWarning, match="compiled code is not kept") as found:
        functions = [cached_njit()(double), cached_njit()(double)]
    assert [each(2.0) for each in functions] == [4.0, 4.0]
    assert len(found) == 1
    assert "\n" not in str(found[0].message)


def test_code_is_not_read_from_a_folder_of_others(reasons, own_folder, monkeypatch):
    if os.name != "posix":
        pytest.skip("permissions are POSIX's")
    own_folder.chmod(0o777)
    monkeypatch.setattr(code_cache._SafeImpl, "_locator_classes", code_cache.CACHE_LOCATORS[:1])
    with pytest.warns(RuntimeWarning, match="others can write"):
        assert cached_njit()(double)(2.0) == 4.0
    assert not [each for each in own_folder.rglob("*") if each.is_file()]


def test_a_full_disk_stops_no_function(reasons, own_folder, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._save_data", full)
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        assert cached_njit()(double)(2.0) == 4.0


@pytest.mark.parametrize("content", [b"", b"\x80\x05garbage", bytes(5000)])
def test_damaged_code_is_compiled_again(own_folder, content):
    assert cached_njit()(double)(2.0) == 4.0
    files = [each for each in own_folder.rglob("*") if each.is_file()]
    assert len(files) == 2
    for file in files:
        file.write_bytes(content)
    again = cached_njit()(double)
    assert again(2.0) == 4.0
    assert sum(again.stats.cache_hits.values()) == 0
    third = cached_njit()(double)
    assert third(2.0) == 4.0
    assert sum(third.stats.cache_hits.values()) == 1


def test_no_module_uses_the_cache_of_numba_itself():
    folder = Path(palpate.__file__).parent
    assert not [path for path in folder.rglob("*.py") if re.search(r"njit\(.*cache=True", path.read_text())]


@pytest.mark.slow
def test_a_body_is_made_in_an_installation_that_cannot_be_written(tmp_path):
    copy = tmp_path / "palpate"
    shutil.copytree(Path(palpate.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__", "page"))
    for folder in [copy, *(each for each in copy.rglob("*") if each.is_dir())]:
        (folder / "__pycache__").touch()  # a file, so that nobody can write into it
    program = (
        "import palpate as pt; print(pt.Solid(pt.box((0.02, 0.02, 0.02), 0.005), "
        "pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1e3, poisson=0.45), stiffness_damping=1e-4))"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "HOME": os.devnull, "XDG_CACHE_HOME": os.devnull}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-P", "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Solid(")
    assert done.stderr.count("compiled code is not kept") == 1
