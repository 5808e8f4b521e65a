"""Short runs of the studies that damage files and kill writers; `make release` has longer ones."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

VALIDATION = Path(__file__).parents[2] / "validation"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the limits of a trial are Linux's"),
]


def run(script, *options):
    command = [sys.executable, str(VALIDATION / script), *options]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "MPLBACKEND": "Agg"})


KINDS = {
    "sealed": ["model", "linear", "trajectory", "stored", "journal", "recording", "recording journal", "manifest"],
    "surfaces": ["stl", "obj", "ply", "off", "glb", "vtk", "vtp", "cost"],
    "labels": ["labels nii", "labels nii.gz", "labels nrrd", "labels mha"],
    "words": ["material", "scene", "curve", "message", "command", "physics"],
}


def check_kinds(kinds, trials):
    done = run("fuzz.py", *kinds, "--trials", f"{trials}", "--seconds", "150", "--seed", "7")
    assert done.returncode == 0, done.stdout + done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert [each["kind"] for each in found] == kinds
    for each in found:
        assert each["trials"] >= trials - 10
        assert each["counts"].get("refused", 0) > 0
        assert set(each["counts"]) <= {"refused", "equal", "accepted"}


def test_a_damaged_or_forged_file_of_some_kinds_is_refused():
    check_kinds(["manifest", "recording", "stl", "labels nrrd", "message"], 20)  # which compile nothing


@pytest.mark.release
@pytest.mark.parametrize("group", KINDS)
def test_damaged_and_forged_files_are_refused(group):
    check_kinds(KINDS[group], 30)


@pytest.mark.release
def test_the_fuzz_study_fails_on_a_loader_without_checks(tmp_path):
    """The study itself: a loader without its check of checksums, and one that raises something else."""
    (tmp_path / "broken.py").write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(VALIDATION)!r})\n"
        "import fuzz, palpate.core.sealed as sealed\n"
        "class Same:\n"
        "    def __init__(self, *_): pass\n"
        "    def update(self, *_): pass\n"
        "    def hexdigest(self): return 'a' * 64\n"
        "    def digest(self): return b'a' * 32\n"
        "sealed.sha256 = Same\n"
        "found = fuzz.study('trajectory', 60.0, 120, 3)\n"
        "print(found['counts'])\n"
        "sys.exit(0 if found['counts'].get('another number') else 1)\n"
    )
    done = subprocess.run([sys.executable, str(tmp_path / "broken.py")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.release
def test_killed_writers_leave_whole_files_or_none():
    done = run("kill_writers.py", "--kills", "4", "--seed", "3")
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == 9


@pytest.mark.release
def test_no_file_of_the_working_folder_runs_or_changes_anything():
    done = run("fuzz.py", "folder", "--trials", "20", "--seconds", "120", "--seed", "7")
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(json.loads(done.stdout)["counts"]) == {"equal"}


@pytest.mark.release
def test_a_full_disk_leaves_the_old_file_or_the_new_one():
    done = run("fault_writers.py", "model", "manifest", "run")
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == 3
