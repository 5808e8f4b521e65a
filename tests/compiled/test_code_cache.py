"""Compiled functions are kept once for a user; without a folder, on a full disk or with damaged code programs run."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections import namedtuple
from pathlib import Path

import numba
import pytest

import palpate
import palpate as pt
from palpate.app.cli import main
from palpate.app.models.spacing_cache import cache_spacing, cached_spacing
from palpate.app.train.scene_folder import training_folder
from palpate.app.view.server.preparation import Preparation
from palpate.compiled import code_cache
from palpate.compiled.code_cache import cached_njit, code_files, code_folder
from palpate.compiled.reference import Reference
from palpate.core.working_folder import cache_folder
from palpate.scenes.open_scene import open_scene


@pytest.fixture
def reasons(monkeypatch):
    monkeypatch.setattr(code_cache, "REASONS", code_cache._Reasons())
    code_cache._checked.cache_clear()
    yield
    code_cache._checked.cache_clear()


@pytest.fixture
def own_folder(tmp_path, monkeypatch, reasons):
    """Compiled code of functions made in the test goes to a folder of its own."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    return tmp_path / "palpate-code"


def double(x):
    return 2 * x


def hits(function) -> int:
    return sum(function.stats.cache_hits.values())


def test_a_function_is_compiled_once(own_folder):
    first, second = cached_njit()(double), cached_njit()(double)
    assert [first(2.0), second(2.0)] == [4.0, 4.0]
    assert [hits(first), hits(second)] == [0, 1]
    assert code_folder() == own_folder
    (file,) = code_files()
    assert file.path.parent == own_folder
    assert second(2) == 4  # another signature
    assert len(code_files()) == 2
    other = cached_njit(fastmath=True)(double)
    assert other(2.0) == 4.0
    assert hits(other) == 0


def test_a_function_runs_without_a_folder_for_its_code_and_one_warning_says_so(reasons, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "file"))
    with pytest.warns(RuntimeWarning, match="compiled code is not kept") as found:
        assert [cached_njit()(double)(2.0) for _ in range(2)] == [4.0, 4.0]
    assert len(found) == 1
    assert "\n" not in str(found[0].message)


def test_a_user_without_a_home_gets_no_folder_in_the_working_folder(reasons, tmp_path, monkeypatch):
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    monkeypatch.setattr(code_cache, "cache_folder", lambda: None)
    monkeypatch.chdir(tmp_path)
    with pytest.warns(RuntimeWarning, match="no home"):
        assert cached_njit()(double)(2.0) == 4.0
    assert not list(tmp_path.iterdir())


def test_code_is_not_read_from_a_folder_of_others(own_folder):
    if os.name != "posix":
        pytest.skip("permissions are POSIX's")
    own_folder.mkdir()
    own_folder.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="others can write"):
        assert cached_njit()(double)(2.0) == 4.0
    assert not [each for each in own_folder.rglob("*") if each.is_file()]


@pytest.fixture
def lock(own_folder, monkeypatch):
    """A function that makes the folder read-only, for root as well, for whom modes do not count."""

    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    def lock_folder():
        access = os.access
        monkeypatch.setattr(os, "access", lambda path, mode, **rest: not mode & os.W_OK and access(path, mode, **rest))
        for holder, name in ((os, "utime"), (Path, "touch"), (Path, "write_bytes"), (Path, "unlink")):
            monkeypatch.setattr(holder, name, refuse)
        code_cache._checked.cache_clear()  # as in a new process

    return lock_folder


def test_code_is_read_where_it_cannot_be_written_and_one_warning_says_that_new_code_is_not_kept(own_folder, lock):
    assert cached_njit()(double)(2.0) == 4.0
    (file,) = code_files()
    os.utime(file.path, (1.0, 1.0))  # the time of the last use cannot be noted
    lock()
    again = cached_njit()(double)
    assert again(2.0) == 4.0  # warnings are errors in tests
    assert hits(again) == 1
    with pytest.warns(RuntimeWarning, match="newly compiled code is not kept.*Read-only file system") as found:
        assert [again(2), again(2.0 + 0.0j)] == [4, 4]  # other signatures
    assert len(found) == 1
    assert [each.path for each in code_files()] == [file.path]


def test_damaged_code_that_cannot_be_replaced_is_named_once(own_folder, lock):
    assert cached_njit()(double)(2.0) == 4.0
    code_files()[0].path.write_bytes(b"damaged")
    lock()
    with pytest.warns(RuntimeWarning, match="Read-only file system"):
        assert cached_njit()(double)(2.0) == 4.0


def test_a_folder_that_cannot_be_emptied_is_shown_with_what_was_removed(own_folder, lock, capsys):
    assert cached_njit()(double)(2.0) == 4.0
    lock()
    assert main(["--cache", "empty"]) == 0
    assert "removed 0 compiled functions" in capsys.readouterr().out
    assert len(code_files()) == 1


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX's")
def test_a_file_that_others_can_write_is_not_read_and_none_is_written(own_folder):
    umask = os.umask(0)
    try:
        assert cached_njit()(double)(2.0) == 4.0
        (file,) = code_files()
        assert file.path.stat().st_mode & 0o022 == 0
        file.path.chmod(0o664)
        again, third = cached_njit()(double), cached_njit()(double)
        assert [again(2.0), third(2.0)] == [4.0, 4.0]
        assert [hits(again), hits(third)] == [0, 1]
    finally:
        os.umask(umask)


def test_a_full_disk_stops_no_function(own_folder, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        assert cached_njit()(double)(2.0) == 4.0
    assert not list(own_folder.iterdir())


@pytest.mark.parametrize("damage", [lambda b: b"", lambda b: b[:-1], lambda b: bytes(5000), lambda b: b[:-9] + b[-8:]])
def test_damaged_code_is_compiled_again(own_folder, damage):
    assert cached_njit()(double)(2.0) == 4.0
    (file,) = code_files()
    file.path.write_bytes(damage(file.path.read_bytes()))
    again, third = cached_njit()(double), cached_njit()(double)
    assert [again(2.0), third(2.0)] == [4.0, 4.0]
    assert [hits(again), hits(third)] == [0, 1]


def test_what_was_not_used_for_longest_goes_first(own_folder, monkeypatch):
    assert cached_njit()(double)(2.0) == 4.0
    (newest,) = code_files()
    for k in range(10):
        path = own_folder / f"old{k}.code"
        path.write_bytes(bytes(1000))
        os.utime(path, (k, k))
    partial = own_folder / "killed.1.partial"
    partial.write_bytes(bytes(10))
    os.utime(partial, (0, 0))
    monkeypatch.setattr(code_cache, "MAX_BYTES", newest.size + 5000)
    monkeypatch.setattr(code_cache, "KEPT_SHARE", (newest.size + 3000) / (newest.size + 5000))
    code_cache._limit(own_folder)
    left = {each.path.name for each in code_files()}
    assert left == {newest.path.name, "old7.code", "old8.code", "old9.code"}


def test_the_use_of_a_file_is_noted_once_a_day(own_folder):
    assert cached_njit()(double)(2.0) == 4.0
    (file,) = code_files()
    os.utime(file.path, (1.0, 1.0))
    assert cached_njit()(double)(2.0) == 4.0
    assert time.time() - code_files()[0].used < 3600


def test_the_option_shows_and_empties_the_folder(own_folder, capsys):
    assert cached_njit()(double)(2.0) == 4.0
    assert main(["--cache"]) == 0
    text = capsys.readouterr().out
    assert "1 compiled functions" in text
    assert str(own_folder) in text
    assert main(["--cache", "json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["functions"] == 1
    assert report["bytes"] > 1000
    assert main(["--cache", "empty"]) == 0
    assert "removed 1 compiled functions" in capsys.readouterr().out
    assert not list(own_folder.iterdir())


def test_no_module_uses_the_cache_of_numba_itself():
    folder = Path(palpate.__file__).parent
    assert not [path for path in folder.rglob("*.py") if re.search(r"njit\(.*cache=True", path.read_text())]


FORCE = """
import numpy as np, palpate as pt
from palpate.compiled.code_cache import code_files
body = pt.Solid(pt.box((0.02, 0.02, 0.02), 0.005), pt.materials.NeoHookean(C1=1e3, density=1e3, poisson=0.45), "z-")
force = body.force(1e-3 * np.sin(300 * body.cloud.points))
print(repr(float(np.abs(force).sum())), len(code_files()), sum(body._internal_force.stats.cache_hits.values()))
"""


def start(**variables: str) -> subprocess.Popen[str]:
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    command = [sys.executable, "-P", "-c", FORCE]
    return subprocess.Popen(
        command, env=environment | variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.slow
@pytest.mark.release
def test_another_clone_and_another_processor_find_their_code_and_equal_forces(tmp_path):
    """A clone at another path compiles nothing; code of another processor is kept next to it."""
    clone = tmp_path / "clone" / "palpate"
    shutil.copytree(Path(palpate.__file__).parent, clone, ignore=shutil.ignore_patterns("__pycache__", "page"))
    home = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}
    first = start(**home).communicate()[0].split()
    other = start(**home, PYTHONPATH=str(clone.parent)).communicate()[0].split()
    assert other == [first[0], first[1], "1"]
    assert first[2] == "0"
    generic = start(**home, NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="").communicate()[0].split()
    assert float(generic[0]) == pytest.approx(float(first[0]), rel=1e-12)
    assert generic[1:] == [str(2 * int(first[1])), "0"]
    assert not list(clone.rglob("*.nb?"))


@pytest.mark.slow
@pytest.mark.release
def test_starts_at_once_and_killed_ones_leave_sound_code(tmp_path):
    home = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path)}
    for delay in (3.0, 8.0):
        killed = start(**home)
        time.sleep(delay)
        killed.kill()
        killed.communicate()
    results = [each.communicate() for each in [start(**home) for _ in range(4)]]
    assert len({out.split()[0] for out, _ in results}) == 1, results
    assert start(**home).communicate()[0].split()[2] == "1"


def test_an_unknown_user_without_a_home_has_no_cache(monkeypatch):
    monkeypatch.setattr("platformdirs.user_cache_path", lambda name: Path("~/.cache") / name)  # not expanded
    assert cache_folder() is None

    def fail(name):
        raise RuntimeError("could not determine the home directory")

    monkeypatch.setattr("platformdirs.user_cache_path", fail)  # of newer versions
    assert cache_folder() is None
    with pytest.raises(pt.InputError, match="home folder"):
        pt.io.fetch_liver()
    with pytest.raises(pt.InputError, match="home folder"):
        training_folder(open_scene("liver"))
    assert cached_spacing("0") is None
    cache_spacing("0", 1e-3)
    Preparation("a body", "a body").close()


@pytest.mark.slow
def test_a_body_is_made_where_nothing_can_be_written():
    done = start(HOME=os.devnull, XDG_CACHE_HOME=os.devnull)
    out, err = done.communicate()
    assert done.returncode == 0, err
    assert out.split()[1:] == ["0", "0"]
    assert err.count("compiled code is not kept") == 1


def test_the_fields_of_a_tuple_behind_a_reference_are_a_part_of_the_key():
    texts = set()
    for fields in ("a b", "b a"):
        record = namedtuple("Record", fields)
        kind = numba.typeof(record(1.0, 2.0))
        texts |= {code_cache._signature_text(each) for each in (kind, Reference(kind), numba.types.Tuple((kind,)))}
    assert len(texts) == 6
