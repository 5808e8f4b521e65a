"""Compiled code is not read from a folder that others may write."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX's")
@pytest.mark.parametrize(
    ("mode", "fine"), [(0o700, True), (0o755, True), (0o777, False), (0o1777, False), (0o770, False)]
)
def test_a_cache_folder_writable_by_others_is_refused(tmp_path, mode, fine):
    tmp_path.chmod(mode)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", "import palpate"], env=environment, capture_output=True, check=False)
    assert (done.returncode == 0) == fine
    assert fine or b"can be written by others" in done.stderr
