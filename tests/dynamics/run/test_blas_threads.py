"""Steps wake no threads of BLAS: after each call these spin on the cores that the steps need."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

# counts how often the system switched to a thread of BLAS, which sleeps unless a call wakes it
SCRIPT = """
import os, sys, time
import numpy as np
import scipy.linalg

threads = [name for name in os.listdir("/proc/self/task") if int(name) != os.getpid()]

def wakes():
    lines = [line for name in threads for line in open(f"/proc/self/task/{name}/status") if "ctxt_switches" in line]
    return sum(int(line.split()[1]) for line in lines)

def asleep():
    states = [open(f"/proc/self/task/{name}/stat").read().rsplit(")", 1)[1].split()[0] for name in threads]
    return all(state == "S" for state in states)

def wait_until_asleep():
    while True:
        before = wakes()
        time.sleep(0.1)
        if asleep() and wakes() == before:
            return before

def count(action):
    before = wait_until_asleep()
    action()
    return wait_until_asleep() - before

long = np.ones(100_000)
if not threads or count(lambda: long @ long) == 0:
    sys.exit(77)
import palpate as pt

law = pt.materials.MooneyRivlin(C1=500.0, C2=200.0, density=1000.0, poisson=0.45)
cloud = pt.box((0.1, 0.02, 0.02), float(sys.argv[1]))
form = sys.argv[2]
model = pt.Solid(cloud, law, "x-", form=form, stiffness_damping=1e-4)
ball = pt.tools.Contact(pt.tools.Sphere(0.005), lambda t: (0.09, 0.01, 0.0251 - 0.1 * t))
loads = [pt.Gravity((0.0, 0.0, -9.81)), pt.SurfaceForce("x+", force=(0.1, 0.0, 0.0)), ball]
duration = 60 * model.stability.step
print(count(lambda: pt.rollout(model, loads, duration=duration, every=duration / 2, progress=False)))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="requires the threads of a process in /proc")
@pytest.mark.parametrize(
    ("spacing", "form"),
    [
        (0.002, "energy"),
        pytest.param(0.002, "strong", marks=pytest.mark.slow),
        pytest.param(0.0015, "energy", marks=pytest.mark.slow),  # 13,328 nodes: sums of nodal scalars are long, too
    ],
)
def test_runs_wake_no_threads_of_blas(spacing, form):
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "2", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(spacing), form], env=environment, capture_output=True, text=True
    )
    if done.returncode == 77:
        pytest.skip("BLAS has no threads here")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["0"]
