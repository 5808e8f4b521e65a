"""The loop is compiled once for a model, for good."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from mass_spring import advance, stiffness
from numba import njit

from palpate.dynamics.compiled import law_njit
from palpate.realtime.loop import _name, loop_of

OTHER_PROCESS = """
import sys
sys.path.append(sys.argv[1])
from mass_spring import mass_spring
from palpate.realtime import Engine
engine = Engine(mass_spring())
engine.start()
loop = engine._runner._loop.func
print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
# it ends although nobody stops the engine
"""


def test_a_second_process_compiles_nothing():
    for attempt in range(2):  # the first may find nothing yet
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", OTHER_PROCESS, str(Path(__file__).parent)],
            capture_output=True, text=True, check=True, timeout=120,
        )  # fmt: skip
        if done.stdout.split() == ["1", "0"]:
            break
        assert attempt == 0, done.stdout
    assert done.stderr == ""


def test_models_of_the_same_functions_share_a_loop():
    assert loop_of(advance, stiffness) is loop_of(advance, stiffness)
    assert loop_of(advance, None) is not loop_of(advance, stiffness)


def test_functions_that_only_differ_in_what_they_close_over_are_not_mistaken_for_each_other():
    def made(number):
        @njit
        def out(data, q, v, target, period, report):
            report[1] = number

        return out

    assert _name(made(1.0)) is None  # nothing in its source tells it from made(2.0): not cached
    named = [_name(law_njit(digest)(made(number).py_func)) for digest, number in (("a" * 64, 1.0), ("b" * 64, 2.0))]
    assert None not in named
    assert named[0] != named[1]
    assert _name(advance) != _name(stiffness)
    assert _name(advance) is not None
