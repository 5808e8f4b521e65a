"""The live page from Python: served while a notebook runs, framed by it, and closed with it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import urllib.request
from xml.etree import ElementTree

import pytest
from websockets.sync.client import connect

import palpate as pt
from palpate.app.session.messages import PROTOCOL_VERSIONS
from palpate.app.view import show as show_module

COMPILE_SECONDS = 800.0  # of a busy machine on which no kernel is compiled yet


@pytest.fixture(scope="module")
def solid(bar, tissue):
    return pt.Solid(bar, tissue, fixed="x-")


@pytest.fixture
def page(solid):
    page = pt.show(solid, block=False)
    yield page
    page.close()


def hello_of(page):
    """Return the first message about the body, after those about its preparation."""
    address, token = page.address.split("/#")
    version = max(PROTOCOL_VERSIONS)
    url = address.replace("http", "ws", 1) + "/session"
    with connect(url, subprotocols=[f"palpate.v{version}"], max_size=None) as socket:
        socket.send(json.dumps({"type": "hello", "protocol": version, "token": token}))
        while True:
            message = socket.recv(timeout=COMPILE_SECONDS)
            if isinstance(message, str) and json.loads(message)["type"] in ("hello", "failed"):
                return json.loads(message)


def test_a_body_is_live_on_the_page(page, solid):
    hello = hello_of(page)
    assert hello["type"] == "hello"
    assert hello["title"] == "Solid of 112 nodes"
    assert hello["full"]
    assert hello["tools"]


def test_a_cell_shows_the_page_in_a_frame_that_notebooks_may_hold(page):
    frame = ElementTree.fromstring(page._repr_html_()).find("iframe")
    assert frame.attrib["src"] == page.address.replace("127.0.0.1", "localhost")
    with urllib.request.urlopen(page.address.partition("#")[0]) as answer:
        policy = answer.headers["Content-Security-Policy"]
    ancestors = re.search(r"frame-ancestors ([^;]*);", policy)[1].split()
    assert {"'self'", "http://localhost:*", "http://127.0.0.1:*"} <= {*ancestors}
    assert "*" not in ancestors


def test_a_closed_page_answers_no_more_and_its_engine_has_stopped(solid):
    page = pt.show(solid, block=False)
    hello_of(page)
    page.close()
    page.close()
    assert "page=closed" in repr(page)
    assert "iframe" not in page._repr_html_()
    assert not page._thread.is_alive()
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(page.address.partition("#")[0])


@pytest.mark.parametrize("thing", [3, "nothing.such", pt.box((0.1, 0.1, 0.1), 0.02)])
def test_what_no_page_shows_is_refused(thing):
    with pytest.raises(pt.InputError):
        pt.show(thing)


def test_a_failure_of_the_preparation_is_on_the_page_and_raised_by_wait(solid, monkeypatch):
    def fail(*_, **__):
        raise pt.InputError("body must lie near the origin")

    monkeypatch.setattr("palpate.app.session.session.Session.__init__", fail)
    page = pt.show(solid, block=False)
    with pytest.raises(pt.InputError, match="near the origin"):
        page.wait()


@pytest.mark.slow
def test_a_program_that_shows_a_body_ends_by_itself():
    code = (
        "import palpate as pt\n"
        "cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)\n"
        "tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)\n"
        "page = pt.Solid(cloud, tissue, fixed='x-').show(block=False)\n"
        "print(page.address)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.startswith("http://127.0.0.1:")
    assert "Traceback" not in done.stderr


def test_a_script_waits_and_a_notebook_does_not(solid, monkeypatch):
    waited = []
    monkeypatch.setattr(show_module.LivePage, "wait", lambda self: waited.append(self.close()))
    monkeypatch.setattr(show_module, "open_browser", lambda address: waited.append(address))
    for in_notebook, interactive in ((False, False), (False, True), (True, True)):
        monkeypatch.setattr(show_module, "_front_end", lambda n=in_notebook, i=interactive: (n, i))
        waited.clear()
        pt.show(solid).close()
        assert (None in waited) == (not interactive)
