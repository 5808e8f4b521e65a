"""What was compiled once is found again, and is compiled anew when it must be."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

import palpate as pt
from palpate.dynamics.compiled.cache import KeyedFile, law_digest

SECOND_PROCESS = """
import sys
import palpate as pt
tissue = eval(sys.argv[1])
model = pt.FullModel(pt.box((0.03, 0.015, 0.015), spacing=0.005), tissue, fixed="x-", viscosity=6e-5)
pull = pt.Traction("x+", force=(1.0, 0.0, 0.0))
run = pt.rollout(model, [pull], duration=1e-3, every=2e-4, progress=False)
rom = pt.project(model, run, modes=2)
pt.rollout(rom, [pull], duration=1e-3, every=2e-4, progress=False)
for f in (model._internal_force, model._advance, rom._projected_force, rom._advance):
    print(sum(f.stats.cache_hits.values()), sum(f.stats.cache_misses.values()))
"""


@pytest.mark.parametrize("law", ["MooneyRivlin(C1=20e3, C2=5e3, ", "Ogden(C=(5e3, 300.0), alpha=(1.3, 5.0), "])
def test_a_second_process_compiles_nothing(law):
    made = f"pt.{law}density=1000.0, poisson=0.45)"
    for attempt in range(2):  # the first may find nothing yet
        command = [sys.executable, "-c", SECOND_PROCESS, made]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        counts = done.stdout.split()
        if counts == ["1", "0"] * 4:
            break
        assert attempt == 0, done.stdout
    assert done.stderr == ""


def test_another_law_has_another_digest():
    laws = [(law.first, law.second) for law in (pt.NeoHookean, pt.MooneyRivlin)]
    digests = {law_digest(*law, direct) for law in laws for direct in (False, True)}
    assert len(digests) == 4
    assert law_digest(*laws[0], False) == law_digest(*laws[0], False)


def test_models_of_one_law_share_their_compiled_functions(bar, small_cloud):
    models = [
        pt.FullModel(cloud, pt.NeoHookean(C1=c, density=1000, poisson=0.4), viscosity=0.0)
        for cloud, c in ((bar, 10e3), (small_cloud, 20e3))
    ]
    assert models[0]._advance is models[1]._advance


FORCES = """
import sys
import numpy as np
import palpate as pt
law = pt.NeoHookean(C1=10e3, density=1000, poisson=0.4)
cloud = pt.box((0.02, 0.02, 0.02), 0.005)
for pressure in sys.argv[1:]:
    model = pt.FullModel(cloud, law, viscosity=0.0, pressure=pressure)
    print(repr(float(np.abs(model.force(0.01 * np.sin(200 * cloud.points))).sum())))
"""


def test_code_compiled_by_two_processes_is_not_mixed_up_by_a_third(tmp_path):
    def forces(*pressures):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        command = [sys.executable, "-c", FORCES, *pressures]
        return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout.split()

    split, direct = forces("split"), forces("direct")
    assert split != direct
    assert forces("split", "direct") == split + direct
    assert forces("direct", "split") == direct + split


def test_two_processes_that_save_at_once_do_not_exchange_their_code(tmp_path, monkeypatch):
    """Both read the index before either writes it, as when workers of a campaign compile side by side."""
    caches = [KeyedFile(str(tmp_path), "kernel", (1.0, 1)) for _ in range(2)]
    with monkeypatch.context() as patch:
        patch.setattr(KeyedFile, "_load_index", lambda self: {})
        caches[0].save(("one signature", "digest"), "code of one")
        caches[1].save(("another signature", "digest"), "code of another")
    reader = KeyedFile(str(tmp_path), "kernel", (1.0, 1))
    found = {key: reader.load((key, "digest")) for key in ("one signature", "another signature")}
    assert found["one signature"] in (None, "code of one")
    assert found["another signature"] == "code of another"
