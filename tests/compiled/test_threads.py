"""Threading layers of Numba: engine and run at once without OpenMP, and children of forks."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.threads import THREADING_LAYER

BLOCK = """
import os, time
import palpate as pt
tissue = pt.materials.MooneyRivlin(C1=20e3, C2=0.0, density=1000.0, poisson=0.4)
cloud = pt.box((0.02, 0.015, 0.015), spacing=0.005)
block = pt.Solid(cloud, tissue, fixed="x-", mass_damping=40)
"""
TOGETHER = """
ball = pt.tools.Contact(pt.tools.Sphere(0.012), (0.01, 0.0075, 0.028))
with pt.Engine(pt.realtime_model(block, contact=ball)) as engine:
    engine.set_pose((0, 0, -0.003))
    for _ in range(20):
        pt.equilibrium(block, [pt.Gravity((0, 0, -9.81))])
    assert engine.read().state == "running", engine.read().state
from palpate.compiled.threads import loops_share_threads
print(loops_share_threads(), pt.equilibrium(block, [pt.Gravity((0, 0, -9.81))]).displacements.tobytes().hex())
"""


@pytest.mark.slow
@pytest.mark.release  # compiles all again for another threading layer
def test_without_openmp_an_engine_and_a_run_work_together():
    """Numba's layer workqueue would end the process."""
    environment = {**os.environ, "NUMBA_THREADING_LAYER": "workqueue"}
    command = [sys.executable, "-c", BLOCK + TOGETHER]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    shared, bits = done.stdout.split()
    assert shared == "False"
    space = {}
    exec(BLOCK, space)  # the same body here
    rest = pt.equilibrium(space["block"], [pt.Gravity((0, 0, -9.81))])
    assert bits == rest.displacements.tobytes().hex()  # threads change no bit


def press(_=0):
    cloud = pt.box((0.02, 0.015, 0.015), spacing=0.005)
    tissue = pt.materials.MooneyRivlin(C1=20e3, C2=0.0, density=1000.0, poisson=0.4)
    return float(np.abs(pt.Solid(cloud, tissue, fixed="x-").weights.sum()))


@pytest.mark.skipif(THREADING_LAYER != "omp" or sys.platform != "linux", reason="only OpenMP on Linux breaks in forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_says_why_it_cannot_run():
    press()
    with multiprocessing.get_context("fork").Pool(1) as pool, pytest.raises(pt.InputError, match="spawn"):
        pool.map_async(press, [0]).get(300)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_other_children_run(method):
    expected = press()
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.map_async(press, [0]).get(300) == [expected]
