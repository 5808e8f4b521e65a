"""The compiled clocks of Windows, with functions that stand in for those of kernel32."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).with_name("windows_functions.c")
SCRIPT = """
import ctypes, sys, time
functions = ctypes.CDLL(sys.argv[1], mode=ctypes.RTLD_GLOBAL)
from palpate.realtime.windows_clock import now, sleep_until
before, inside, after = time.monotonic_ns(), now(), time.monotonic_ns()
assert before - 100 <= inside <= after, (before, inside, after)  # ticks of 100 ns
late = []
for _ in range(20):
    end = now() + 2_000_000
    sleep_until(end)
    late.append(now() - end)
assert min(late) >= -100 and sorted(late)[10] < 2_000_000, late
sleep_until(now() - 10**15)  # the past
assert functions.count_open_timers() == 0
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32" or shutil.which("cc") is None, reason="has no stand-ins")
def test_windows_clocks_call_its_functions(tmp_path):
    library = tmp_path / "functions.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-Wall", "-Werror", SOURCE, "-o", library], check=True)
    done = subprocess.run([sys.executable, "-c", SCRIPT, library], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
