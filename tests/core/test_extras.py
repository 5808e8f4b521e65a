"""What works without the optional packages, and what the commands that need one say."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.core.extras import EXTRA_BY_PACKAGE, require

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
BLOCKED = sorted({*EXTRA_BY_PACKAGE, "vtk", "vtkmodules", "PIL", "dask"})

# Nothing optional can be imported, as if it were not installed.
BLOCKER = f"""
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {BLOCKED!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocker())
"""

SESSION = """
import numpy as np
import palpate as pt

for module in (pt.io, pt.lti, pt.materials, pt.tools, pt.typing):
    [getattr(module, name) for name in module.__all__]
[getattr(pt, name) for name in pt.__all__]
cloud = pt.box((0.015, 0.015, 0.015), spacing=0.005)
tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000.0, poisson=0.45)
body = pt.Solid(cloud, tissue, fixed="x-", form="energy")
pull = pt.PrescribedMotion("x+", lambda points, time: np.full_like(points, 1e-3 * np.sin(100 * time)))
full = pt.rollout(body, [pull], duration=0.02, every=0.002, file="full.h5")
rom = pt.hyper_reduce(body, full, modes=2, prescribed="x+")
pt.save(rom, "body.rom")
rom = pt.load("body.rom")
print(pt.relative_errors(full, pt.rollout(rom, [pull], duration=0.02, every=0.002)))
with pt.Engine(pt.realtime_model(rom)) as engine:
    while engine.statistics().count < 5:
        pass
"""


def python(code: str, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process without optional packages."""
    return subprocess.run(
        [sys.executable, "-c", BLOCKER + code, *words], cwd=folder, capture_output=True, text=True,
        check=False, timeout=900, env=os.environ | {"PYTHONPATH": str(ROOT / "src")},
    )  # fmt: skip


def test_models_can_be_run_reduced_stored_and_stepped_in_real_time_without_extras(tmp_path):
    done = python(SESSION, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Errors(")


FREE = (["--help"], ["--version"], ["laws"], ["view", "--help"])
NEEDING = {
    "reproduce beam": "plot",
    "reproduce membrane": "plot",
    f"fit NeoHookean {ROOT / 'examples' / 'rubber_treloar.csv'}": "plot",
    "train beam --cluster tcp://localhost:1": "cluster",
    "view beam": "view",
    "replay recording.h5": "view",
    "replay recording.h5 --png press.png": "film",
    "replay recording.h5 --movie press.gif": "film",
    "replay recording.h5 --movie press.mp4": "film",
}

MANY = """
import contextlib, io, json, sys
from palpate.app.cli import main

told = {}
for words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words)
    told[" ".join(words)] = code, out.getvalue(), err.getvalue()
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """Exit code, output and errors of many commands, and the files in their folder afterwards."""
    folder = tmp_path_factory.mktemp("commands")
    (folder / "recording.h5").write_bytes(b"not read")
    done = python(MANY, folder, json.dumps([*FREE, *(words.split() for words in NEEDING)]))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), [path.name for path in folder.iterdir()]


@pytest.mark.parametrize("words", FREE)
def test_basic_commands_run_without_extras(words, told):
    code, out, err = told[0][" ".join(words)]
    assert (code, err) == (0, "")
    assert out


@pytest.mark.parametrize(("words", "extra"), NEEDING.items())
def test_commands_name_a_missing_extra_before_they_begin(words, extra, told):
    commands, left = told
    code, _, err = commands[words]
    assert code == 2, err
    assert re.fullmatch(rf".* requires \w+, which is not installed; pip install 'palpate\[{extra}\]'\n", err)
    assert left == ["recording.h5"]


def test_a_check_without_drawing_packages_writes_its_report(tmp_path):
    corners = np.array(np.meshgrid([0, 0.1], [0, 0.1], [0, 0.1], indexing="ij")).reshape(3, 8).T
    sides = "1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"
    lines = [*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {side}" for side in sides)]
    (tmp_path / "cube.obj").write_text("\n".join(lines) + "\n")
    done = python(MANY, tmp_path, json.dumps([["check", "cube.obj", "--units", "m", "--spacing", "0.02"]]))
    assert done.returncode == 0, done.stderr
    ((code, _, err),) = json.loads(done.stdout).values()
    assert code == 0
    assert "no pictures: drawing surfaces requires pyvista" in err
    assert "pip install 'palpate[film]'" in err
    assert (tmp_path / "out" / "check" / "report.json").is_file()


@pytest.mark.parametrize("package", EXTRA_BY_PACKAGE)
def test_every_missing_package_is_named_with_its_extra(package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(
        pt.InputError, match=rf"^drawing requires {package}, .*palpate\[{EXTRA_BY_PACKAGE[package]}\]'$"
    ):
        require(package, "drawing")


def test_the_extras_that_messages_name_install_their_packages():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    for package, extra in EXTRA_BY_PACKAGE.items():
        assert any(re.match(rf"{package.replace('_', '-')}\b", each) for each in extras[extra]), package
    whole = re.fullmatch(r"palpate\[(.*)\]", extras["all"][0])
    assert whole is not None
    assert set(whole[1].split(",")) == set(EXTRA_BY_PACKAGE.values())
    assert not {re.match(r"[\w-]+", each)[0] for each in project["dependencies"]} & {*EXTRA_BY_PACKAGE, "vtk"}
