"""Command ``palpate bench page``: measures the page in a headless browser with software rendering."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from math import pi, sin
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from palpate.app.bench.chromium import Chromium, Tab, find_chromium
from palpate.app.bench.subdivided_surface import SubdividedSession
from palpate.app.common.console import Console, quantities_table
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.extras import require
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.files import check_folder, plain

__all__ = ["FILES", "bench_page"]

FILES = REPORTS
WINDOW_SIZE = (640, 480)  # [px] of the window
SETTLING_TIME = 3.0  # [s] after the first frame
MAX_SECONDS = 600.0  # [s]
SWING_PERIOD, DRAG_LENGTH = 0.7, 18.0  # [s] and [px] of the pointer's motion
MOVE_INTERVAL = 1 / 60  # [s] between moves of the pointer
TARGET_RATE, TARGET_LATENCY = 30.0, 100.0  # [Hz] of frames with a new state, [ms] for 95 % of the moves


def bench_page(
    *, model: str = "liver", vertices: int = 10_000, seconds: float = 10.0, out: Path, as_json: bool = False
) -> int:
    """Press a body on the page in a headless Chromium with software rendering, and report rate and latency.

    Parameters
    ----------
    model : str
        Scene or file, as for `palpate.app.models.loader.open_model`.
    vertices : int
        Least number of vertices of the subdivided surface, from 100 to 10^6.
    seconds : float [s]
        Duration of the press, up to 600.
    out : path
        Folder for the report; created if needed.
    as_json : bool
        Print the report as JSON instead of a table.

    Returns
    -------
    int
        0, whether the targets were reached or not.

    Raises
    ------
    InputError
        A parameter is out of range, Chromium or the page is missing, or the model has no tool contact.
    OSError
        The report could not be written.
    """
    vertices = integer_in_range("vertices", vertices, 100, 10**6)
    seconds = number_in_range("seconds", seconds, 0.0, MAX_SECONDS, open_low=True, unit="s")
    require("websockets", "palpate bench page")
    if find_chromium() is None:
        raise InputError("Chromium must be installed, got none; on Debian: apt-get install chromium")
    check_folder(out)
    console = Console()
    source = _make_source(model, vertices, console)
    source.start()
    try:
        console.say(f"pressing for {seconds:g} s, {len(source.surface.rest):,} vertices drawn ...")
        with _serve(source) as address, Chromium() as browser:
            pressed = _press(browser.open(address, *WINDOW_SIZE), seconds)
        report = plain(
            {"title": "Page", "machine": machine(), "window": WINDOW_SIZE, **pressed, "engine": source.statistics()}
        )
    finally:
        source.stop()
    report["vertices"] = len(source.surface.rest)
    out.mkdir(parents=True, exist_ok=True)
    rows = {name: [value] for name, value in _rows(report).items()}
    table = quantities_table("Page in headless Chromium, software rendering", ["here"], rows)
    deliver(report, [table], out, FILES, as_json)
    return 0


def _make_source(model: str, vertices: int, console: Console) -> SubdividedSession:
    from palpate.app.models.loader import open_model
    from palpate.app.view.session.session import Session

    body, title = open_model(model, console)
    with console.status("preparing the engine (the first run on a machine compiles it, in about a minute)"):
        session = Session(body, title)
    if not session.tool_kinds:
        raise InputError(f"model must have tool contact, got {model!r}; use one that was trained with tools")
    return SubdividedSession(session, vertices)


@contextlib.contextmanager
def _serve(source: Any) -> Iterator[str]:
    """Serve a source in another thread; yields the page's address."""
    from palpate.app.view.server.host import Host

    host = Host(source)
    if not host.page.exists:
        raise InputError(f"{host.page.folder} must contain the page, got none; install palpate again, which builds it")
    with host.serving():
        yield host.address


def _press(tab: Tab, seconds: float) -> dict[str, Any]:
    """Press the middle of the body with a periodic depth for a duration."""
    tab.wait("window.palpate?.ready", 120.0)
    sleep(SETTLING_TIME)
    x, y = tab.evaluate("(() => { const b = document.getElementById('view').getBoundingClientRect();"
                        "return [b.x + 0.45 * b.width, b.y + 0.5 * b.height]; })()")  # fmt: skip
    tab.mouse("Moved", x, y, "none")
    tab.mouse("Pressed", x, y)
    tab.wait("palpate.force > 0", 60.0)
    tab.evaluate("palpate.meter.reset()")
    start = now = monotonic()
    forces: list[float] = []
    while now < start + seconds:
        tab.mouse("Moved", x, y + DRAG_LENGTH * (1 - abs(sin(pi * (now - start) / SWING_PERIOD))))
        if int((now - start) / 0.5) > len(forces):
            forces.append(tab.evaluate("palpate.force"))
        sleep(max(0.0, now + MOVE_INTERVAL - monotonic()))
        now = monotonic()
    page = tab.evaluate("({ ...palpate.meter.summary(), ratio: palpate.scene.resolution.ratio })")
    tab.mouse("Released", x, y)
    return {"page": page, "seconds": now - start, "largest_force": max(forces, default=None), "errors": tab.errors}


def _rows(report: dict[str, Any]) -> dict[str, str]:
    page, engine = report["page"], report["engine"]
    missed = engine["misses"] / max(engine["periods"], 1)
    fast_enough = page["rate"] >= TARGET_RATE
    responsive = page["p95"] is not None and page["p95"] <= TARGET_LATENCY
    rate = f"{page['rate']:.1f}{'' if fast_enough else ': missed'}"
    delays = "-" if page["p95"] is None else f"{page['median']:.0f}; {page['p95']:.0f} ms"
    delays += "" if responsive else ": missed"
    return {
        "vertices drawn": f"{report['vertices']:,}",
        f"frames with a new state per second (target: {TARGET_RATE:g})": rate,
        f"latency from pointer to drawn deformation, median; 95 % (target: {TARGET_LATENCY:g} ms)": delays,
        "moves of the pointer": f"{page['latencies']}",
        "rendered pixels per window pixel": f"{page['ratio'] ** 2:.2g}",
        "engine: computing time of a period, median; 99 %": f"{engine['median_ms']:.3g}; {engine['p99_ms']:.3g} ms",
        "engine: periods that missed their deadline": f"{engine['misses']} of {engine['periods']} ({missed:.2%})",
    }
