"""Messages of the host: a busy port, a public address, no page, no browser."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
import urllib.request

import pytest

from palpate.app.common.console import Console
from palpate.app.view.server import host
from palpate.app.view.server.address import LOOPBACK, open_listener
from palpate.app.view.server.page import Page


@pytest.fixture
def served(session, monkeypatch, capsys):
    """A function that serves a session until clients are answered, and returns what was said, by line."""

    async def run(own, ready):
        ready()
        own._listener.close()

    def serve(port=18970, address=LOOPBACK, browser=True):
        monkeypatch.setattr(host.Host, "run", run)
        host.serve_source(session, Console(), port, address, browser)
        for thread in threading.enumerate():
            if thread.name == "palpate browser":
                thread.join()
        return capsys.readouterr().err.splitlines()

    return serve


def test_a_busy_port_is_named(served):
    busy = open_listener(LOOPBACK, 18970)
    port = busy.getsockname()[1]
    first, second, *_ = served(port, browser=False)
    busy.close()
    taken = int(first.rpartition(" ")[2])
    assert first == f"port {port} is busy; using {taken}"
    assert port < taken < port + 20
    assert second.startswith(f"open http://{LOOPBACK}:{taken}/#")


def test_without_a_browser_the_address_is_printed(served, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("palpate.app.view.server.address.sys.platform", "linux")
    address, no_browser = served()
    assert "/#" in address
    assert no_browser == "no browser was found: open the address yourself"


def test_an_address_that_other_machines_reach_prints_a_warning(served, monkeypatch):
    monkeypatch.setattr(host, "is_loopback", lambda name: False)
    assert served(browser=False)[0].startswith(f"WARNING: other machines can reach {LOOPBACK}")


def test_an_installation_without_the_page_prints_so(served, monkeypatch, tmp_path):
    monkeypatch.setattr(host, "Page", lambda names, **given: Page(names, tmp_path, **given))
    assert served(browser=True)[0].startswith("the page was not built")


def test_the_address_is_answered_until_interrupted(session, monkeypatch, capsys):
    own = host.Host(session, port=18970)

    async def visit():
        ready = asyncio.Event()
        serving = asyncio.create_task(own.run(ready.set))
        await ready.wait()
        page = await asyncio.to_thread(lambda: urllib.request.urlopen(own.address, timeout=300).read())
        serving.cancel()
        return page

    assert b"<!doctype html" in asyncio.run(visit()).lower()

    def interrupted(own):
        raise KeyboardInterrupt

    monkeypatch.setattr(host.Host, "wait", interrupted)
    host.serve_source(session, Console(), 18970, LOOPBACK, False)  # ends without a word
    assert "Traceback" not in capsys.readouterr().err


BOX = """OFF
8 12 0
0 0 0
8 0 0
8 6 0
0 6 0
0 0 4
8 0 4
8 6 4
0 6 4
""" + "".join(
    f"3 {a} {b} {c}\n3 {a} {c} {d}\n"
    for a, b, c, d in [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
)

OPENING = """
import sys
from palpate.app.view import command
from palpate.app.view.server import host
from palpate.app.view.server.preparation import Preparation

opened = command.open_input(sys.argv[1], units="cm")
preparation = Preparation(opened.title, "box", command._first_surface(opened, True))
mechanics = ("palpate.dynamics.solid", "palpate.dynamics.nodal", "palpate.reduction", "palpate.realtime.engine")
print(len(preparation.surface.triangles), [name for name in sys.modules if name.startswith(mechanics)])
"""


def test_a_surface_is_shown_before_mechanics_are_imported(tmp_path):
    (tmp_path / "box.off").write_text(BOX)
    command = [sys.executable, "-c", OPENING, str(tmp_path / "box.off")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == "12 []\n", done.stderr
