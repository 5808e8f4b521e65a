"""Files in the working folder change nothing, and compiled code is not read where others may write."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from palpate.core.working_folder import foreign_writer, make_private

posix = pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX's")


def run_python(program, folder, **environment):
    command = [sys.executable, "-P", "-c", program]
    return subprocess.run(
        command, cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )


@posix
@pytest.mark.parametrize(
    ("mode", "fine"), [(0o700, True), (0o755, True), (0o1755, True), (0o777, False), (0o770, False)]
)
def test_a_cache_folder_of_others_is_refused(tmp_path, mode, fine):
    tmp_path.chmod(mode)
    done = run_python("import palpate", tmp_path, NUMBA_CACHE_DIR=str(tmp_path))
    assert (done.returncode == 0) == fine
    assert fine or "others can write" in done.stderr
    assert not list(tmp_path.glob("palpate-*"))


FOLDERS = """
import os, numba, palpate
made = os.path.isdir(os.environ["NUMBA_CACHE_DIR"])  # before another user makes it
from palpate.compiled.code_cache import code_folder
print(made, os.environ["NUMBA_CACHE_DIR"], numba.config.CACHE_DIR, code_folder())
"""


@posix
def test_a_shared_folder_with_the_sticky_bit_gets_a_private_one_for_all_compiled_code(tmp_path):
    tmp_path.chmod(0o1777)
    private = tmp_path / f"palpate-{os.getuid()}"
    for folder in (tmp_path, tmp_path, private):  # the last as a process that this one starts
        done = run_python(FOLDERS, tmp_path, NUMBA_CACHE_DIR=str(folder))
        assert done.stdout.split() == ["True", str(private), str(private), str(private / "palpate-code")], done.stderr
    status = private.lstat()
    assert (status.st_mode & 0o7777, status.st_uid) == (0o700, os.getuid())
    assert [each.name for each in tmp_path.iterdir()] == [private.name]


@posix
@pytest.mark.parametrize("prepared", ["open folder", "link to an open folder", "folder of another", "link of another"])
def test_a_private_folder_that_others_have_prepared_is_refused(tmp_path, prepared):
    tmp_path.chmod(0o1777)
    private, target = tmp_path / f"palpate-{os.getuid()}", tmp_path / "target"
    target.mkdir(mode=0o700)
    private.symlink_to(target) if "link" in prepared else private.mkdir(mode=0o700)
    if "open" in prepared:
        private.chmod(0o777)  # that of the target of a link
    elif os.getuid() == 0:
        os.lchown(private, 12345, 12345)
    else:
        pytest.skip("only root can give a folder away")
    done = run_python("import palpate", tmp_path, NUMBA_CACHE_DIR=str(tmp_path))
    assert done.returncode != 0
    assert "another user" in done.stderr if "another" in prepared else "others can write" in done.stderr


ROOT, USER, OTHER, NOBODY = 0, 1000, 1001, 65534  # the last stands for root and for others in some containers


@posix
@pytest.mark.parametrize(
    ("owners", "foreign"),
    [
        ((ROOT, ROOT, ROOT, ROOT), None),  # an image that root has filled
        ((ROOT, ROOT, USER, USER), None),
        ((ROOT, USER, USER, ROOT), None),
        ((NOBODY, NOBODY, USER, USER), None),
        ((ROOT, OTHER, USER, USER), "/home"),
        ((ROOT, ROOT, OTHER, OTHER), "/home/cache"),
        ((ROOT, ROOT, USER, OTHER), "/home/cache/a.code"),
        ((ROOT, NOBODY, USER, USER), "/home"),
        ((NOBODY, NOBODY, USER, NOBODY), "/home/cache/a.code"),
    ],
)
def test_code_belongs_to_root_or_the_user_also_where_nobody_can_write(monkeypatch, owners, foreign):
    paths = dict(zip(("/", "/home", "/home/cache", "/home/cache/a.code"), owners, strict=True))
    with monkeypatch.context() as patch:
        patch.setattr(os, "getuid", lambda: USER)
        patch.setattr(os, "stat", lambda path: SimpleNamespace(st_uid=paths[path]))
        patch.setattr(Path, "lstat", lambda path: SimpleNamespace(st_uid=paths[str(path)], st_mode=0o40555))
        found = foreign_writer("/home/cache/a.code")
    assert found == (f"{foreign} belongs to another user" if foreign else "")


@posix
def test_a_cache_folder_under_a_parent_of_others_is_refused(tmp_path):
    (tmp_path / "shared" / "own").mkdir(parents=True)
    (tmp_path / "shared" / "own").chmod(0o700)
    (tmp_path / "shared").chmod(0o777)
    for folder in (tmp_path / "shared" / "own", tmp_path / "shared" / "new"):
        done = run_python("import palpate", tmp_path, NUMBA_CACHE_DIR=str(folder))
        assert done.returncode != 0
        assert "others can write" in done.stderr


@posix
def test_a_missing_cache_folder_is_created_for_its_owner_only(tmp_path):
    done = run_python("import os; os.umask(0); import palpate", tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "a" / "b"))
    assert done.returncode == 0, done.stderr
    assert [(tmp_path / each).stat().st_mode & 0o777 for each in ("a", "a/b")] == [0o700, 0o700]


def test_a_relative_cache_folder_is_refused(tmp_path):
    done = run_python("import palpate", tmp_path, NUMBA_CACHE_DIR=".cache")
    assert "must be an absolute path" in done.stderr
    assert not list(tmp_path.iterdir())


@posix
def test_a_link_into_a_folder_of_others_counts_as_this_folder(tmp_path):
    shared, own, sticky = (tmp_path / name for name in ("shared", "own", "sticky"))
    for folder, mode in ((shared, 0o777), (own, 0o700), (sticky, 0o1777)):
        make_private(folder / "inside")
        folder.chmod(mode)
    (own / "to_shared").symlink_to(shared / "inside")
    (shared / "to_own").symlink_to(own / "inside")
    (sticky / "to_own").symlink_to(own / "inside")
    (own / "loop").symlink_to("loop")
    assert foreign_writer(own / "to_shared") == f"others can write to {shared}"
    assert foreign_writer(shared / "to_own") == f"others can write to {shared}"
    assert foreign_writer(sticky / "to_own") == ""  # others cannot replace the link
    assert foreign_writer(sticky / "inside" / "missing") == ""
    assert foreign_writer(sticky) == f"others can write to {sticky}"
    assert "links" in foreign_writer(own / "loop")


NUMBA = """
import sys
if sys.argv[0] == "-c" and {first}:
    import numba
import palpate.compiled.jit
from numba import njit
from numba.core import config
seen = [config.CACHE_DIR, config.DISABLE_JIT, config.CACHE_LOCATOR_CLASSES]
njit(lambda x: x + 1)(1)
print(seen, config.CACHE_DIR, config.DISABLE_JIT)
import yaml
"""


@pytest.mark.parametrize("first", [False, True])
def test_numba_config_of_the_working_folder_is_ignored(tmp_path, first):
    pytest.importorskip("yaml")
    (tmp_path / ".numba_config.yaml").write_text(
        f"CACHE_DIR: {tmp_path}/cache\nDISABLE_JIT: 1\nCACHE_LOCATOR_CLASSES: evil.Locator\n"
    )
    done = run_python(NUMBA.format(first=first), tmp_path)
    assert done.stdout == "['', 0, '']  0\n", done.stderr
    assert done.stderr == ""
    assert not (tmp_path / "cache").exists()


def test_pymor_defaults_of_the_working_folder_are_not_run(tmp_path):
    pytest.importorskip("pymor")
    (tmp_path / "pymor_defaults.py").write_text("open('ran', 'w')\nd = {}\n")
    program = "from palpate.reduction.lti.pymor_bridge import need_pymor; need_pymor('this'); import pymor, os; "
    done = run_python(program + "print(os.environ.get('PYMOR_DEFAULTS'))", tmp_path)
    assert done.stdout == "None\n", done.stderr
    assert not (tmp_path / "ran").exists()


def test_matplotlib_style_of_the_working_folder_does_not_change_reports(tmp_path):
    pytest.importorskip("matplotlib")
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    program = (
        "import sys\nfrom palpate.app.cli import main\nassert main(['laws']) == 0\n"
        "import matplotlib\nprint(matplotlib.rcParams['text.usetex'], file=sys.stderr)"
    )
    assert run_python(program, tmp_path).stderr == "False\n"


@pytest.mark.slow
def test_workers_and_probes_import_no_module_of_the_working_folder(tmp_path):
    for name in ("selectors", "struct", "tempfile", "pyvista", "vtkmodules"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nraise ImportError\n")
    (tmp_path / "program.py").write_text(
        "import sys\nfrom palpate.app.common.rendering import DrawingError, check_drawing\n"
        "from palpate.app.train.local import WORKER_ENVIRONMENT, serve_runs\n"
        "from palpate.core.processes import Child\n"
        "from contextlib import suppress\n"
        "with suppress(DrawingError):\n    check_drawing()\n"
        "worker = Child(serve_runs, ['x', {'scene': 'beam', 'parameters': {}}], environment=WORKER_ENVIRONMENT)\n"
        "worker.send(['train', 0, 0])\nprint([kind for kind, _ in worker.answers()], worker.wait())\n"
    )
    command = [sys.executable, "-P", str(tmp_path / "program.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == "['stopped'] 0\n", done.stderr
    assert not (tmp_path / "ran").exists()
