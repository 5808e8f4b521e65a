"""Clients that harm the server: each kind alone, and all together. They stand in validation/hostile.py."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from pathlib import Path

import pytest

VALIDATION = Path(__file__).parents[4] / "validation"


def script(name):
    """Return a script of validation/ as a module."""
    specification = importlib.util.spec_from_file_location(name, VALIDATION / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    specification.loader.exec_module(module)
    return module


hostile, soak = script("hostile"), script("soak")

pytestmark = pytest.mark.slow


@pytest.mark.each_kind(kind=["reads_nothing", "floods", "half_a_handshake", "huge_frames", "many_connections", "lies"])
@pytest.mark.parametrize("kind", list(hostile.KINDS))
def test_a_hostile_client_does_not_delay_others(site, session, kind, caplog, until):
    """An honest client hears statistics twice a second all the time, and the session is never paused as asleep."""
    command = [sys.executable, str(VALIDATION / "hostile.py"), site.address]
    with subprocess.Popen([*command, "5", kind]) as harm:
        told = subprocess.run([*command, "4"], capture_output=True, text=True, check=True)
        harm.wait(300)
    felt = hostile.json.loads(told.stdout)
    assert felt["came"] == 3  # nobody honest was turned away
    assert felt["states"] > 1
    until(lambda: not site.server.viewers)
    until(lambda: not site.server._connections)
    until(lambda: session.pause_reason == "viewers left")  # the pause waits for the end of a period
    assert not caplog.records


@pytest.mark.release
def test_all_hostile_clients_together_neither_stop_the_server_nor_use_up_memory(model):
    quiet, harmed = soak.soak(model, 20.0, list(hostile.KINDS))
    assert harmed["came"] == 3
    assert harmed["periods"] > 0
    assert harmed["memory_most_MB"] < quiet["memory_most_MB"] + 60.0


def test_a_client_that_does_not_read_is_disconnected_after_seconds(site, until):
    """By the limits that the server has, not by shortened ones."""
    command = [sys.executable, str(VALIDATION / "hostile.py"), site.address, "60", "reads_nothing"]
    with subprocess.Popen(command) as harm:
        until(lambda: site.server.viewers)
        first = site.server.viewers[0]
        while first in site.server.viewers:  # for ever, if the server never closes the connection
            assert harm.poll() is None
            time.sleep(0.1)
        harm.kill()
