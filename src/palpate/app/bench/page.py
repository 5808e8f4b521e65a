"""``palpate bench page``: how fast the page draws in a real browser that draws in software, and what that costs."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterator
from math import pi, sin
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from palpate.app.bench.chromium import Chromium, Tab, find_chromium
from palpate.app.bench.drawn import FinelyDrawn
from palpate.app.console import Console, print_json, print_plain, quantities_table
from palpate.app.report import machine
from palpate.extras import require
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.files import check_folder, plain, write_json

__all__ = ["FILES", "bench_page"]

FILES = ("report.json",)
SIZE = (640, 480)  # [px] of the window
SETTLED = 3.0  # [s] after the first picture
LONGEST = 600.0  # [s]
SWING, DRAG = 0.7, 18.0  # [s] and [px] of the hand's to and fro
MOVES = 1 / 60  # [s] between two moves of the pointer
RATE, LATENCY = 30.0, 100.0  # aims: distinct pictures per second, [ms] for 95 % of the moves


def bench_page(
    *, model: str = "liver", vertices: int = 10_000, seconds: float = 10.0, out: Path, as_json: bool = False
) -> int:
    """Press a body in the page, in a headless Chromium that draws in software, and tell how fast all of it was.

    Parameters
    ----------
    model : str
        As for `palpate.app.view.opening.opened`.
    vertices : int
        The surface is drawn with so many, from 100 to 10^6: its triangles are divided. One that has more stays.
    seconds : float [s]
        Of pressing, up to 600.
    out : path
        Folder; made if it does not exist.
    as_json : bool
        Print the report as JSON instead of a table.

    Returns
    -------
    int
        0, whether the aims were reached or not.

    Raises
    ------
    InputError
        A parameter out of range, no Chromium, no page in this copy of palpate, or a body that no tool touches.
    OSError
        The report could not be written.
    """
    vertices = integer_in_range("vertices", vertices, 100, 10**6)
    seconds = number_in_range("seconds", seconds, 0.0, LONGEST, open_low=True, unit="s")
    require("websockets", "palpate bench page")
    if find_chromium() is None:
        raise InputError("no Chromium found (chromium or google-chrome); on Debian: apt-get install chromium")
    check_folder(out)
    console = Console()
    show = _show(model, vertices, console)
    show.start()
    try:
        console.say(f"pressing for {seconds:g} s, {len(show.surface.rest):,} vertices drawn ...")
        with _served(show) as address, Chromium() as browser:
            pressed = _pressed(browser.open(address, *SIZE), seconds)
        report = plain({"title": "Page", "machine": machine(), "window": SIZE, **pressed, "engine": show.statistics()})
    finally:
        show.stop()
    report["vertices"] = len(show.surface.rest)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "report.json", report)
    if as_json:
        print_json(report)
    else:
        rows = {name: [value] for name, value in _rows(report).items()}
        print_plain([quantities_table("Page in headless Chromium, drawn in software", ["here"], rows)], out, FILES)
    return 0


def _show(model: str, vertices: int, console: Console) -> FinelyDrawn:
    from palpate.app.view.opening import opened
    from palpate.app.view.session import Session

    body, title = opened(model, console)
    with console.status("making the engine ready (the first run on a machine compiles it: some minutes)"):
        session = Session(body, title)
    if not session.tools:
        raise InputError(f"model = {model!r}: no tool touches this body; give one that was trained with tools")
    return FinelyDrawn(session, vertices)


@contextlib.contextmanager
def _served(show: Any) -> Iterator[str]:
    """Serve a show beside this thread; yields the page's address."""
    from palpate.app.view.stand import Stand

    stand, ready = Stand(show), threading.Event()
    if not stand.page.built:
        raise InputError(f"{stand.page.folder} holds no page; install palpate again: its build bundles the page")
    loop = asyncio.new_event_loop()
    task = loop.create_task(stand.run(ready.set))

    def run() -> None:
        with contextlib.suppress(asyncio.CancelledError):
            loop.run_until_complete(task)
        loop.close()

    thread = threading.Thread(target=run, name="server")
    thread.start()
    try:
        ready.wait()
        yield stand.address
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join()


def _pressed(tab: Tab, seconds: float) -> dict[str, Any]:
    """Hold on the middle of the body and press deeper and less deep for some seconds."""
    tab.wait("window.palpate?.ready", 120.0)
    sleep(SETTLED)
    x, y = tab.evaluate("(() => { const b = document.getElementById('view').getBoundingClientRect();"
                        "return [b.x + 0.45 * b.width, b.y + 0.5 * b.height]; })()")  # fmt: skip
    tab.mouse("Moved", x, y, "none")
    tab.mouse("Pressed", x, y)
    tab.wait("palpate.force > 0", 60.0)
    tab.evaluate("palpate.meter.reset()")
    start = now = monotonic()
    forces: list[float] = []
    while now < start + seconds:
        tab.mouse("Moved", x, y + DRAG * (1 - abs(sin(pi * (now - start) / SWING))))
        if int((now - start) / 0.5) > len(forces):
            forces.append(tab.evaluate("palpate.force"))
        sleep(max(0.0, now + MOVES - monotonic()))
        now = monotonic()
    page = tab.evaluate("({ ...palpate.meter.summary(), ratio: palpate.stage.sharpness.ratio })")
    tab.mouse("Released", x, y)
    return {"page": page, "seconds": now - start, "largest_force": max(forces, default=None), "errors": tab.errors}


def _rows(report: dict[str, Any]) -> dict[str, str]:
    page, engine = report["page"], report["engine"]
    missed = engine["misses"] / max(engine["periods"], 1)
    fast = page["rate"] >= RATE
    prompt = page["p95"] is not None and page["p95"] <= LATENCY
    delays = "-" if page["p95"] is None else f"{page['median']:.0f}; {page['p95']:.0f} ms"
    delays += "" if prompt else ": missed"
    return {
        "vertices drawn": f"{report['vertices']:,}",
        f"pictures with a new state per second (aim: {RATE:g})": f"{page['rate']:.1f}{'' if fast else ': missed'}",
        f"from pointer to drawn deformation, median; 95 % (aim: {LATENCY:g} ms)": delays,
        "moves of the pointer": f"{page['latencies']}",
        "pixels drawn for one of the window": f"{page['ratio'] ** 2:.2g}",
        "engine: computing time of a period, median; 99 %": f"{engine['median_ms']:.3g}; {engine['p99_ms']:.3g} ms",
        "engine: periods that missed their deadline": f"{engine['misses']} of {engine['periods']} ({missed:.2%})",
    }
