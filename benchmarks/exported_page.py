"""Periods and pictures a second of a page that `palpate export --web` wrote, in a headless Chromium.

    python benchmarks/exported_page.py FOLDER

A ball presses the middle of the picture for five seconds, drawn in software.
"""

from __future__ import annotations

import functools
import http.server
import sys
import threading
from time import sleep

from chromium import Chromium

STATE = "[palpate.session.state.steps, window.statesSeen ?? 0, performance.now()]"
COUNT_STATES = """
(() => { let last = null; window.statesSeen = 0;
  (function look() { requestAnimationFrame(look); const { state } = palpate.session;
    if (state !== last) { last = state; window.statesSeen += 1; } })(); })()
"""
CENTRE = """(() => { const b = document.getElementById("view").getBoundingClientRect();
  return [b.x + b.width / 2, b.y + b.height * 0.45]; })()"""


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Serves a folder without printing requests."""

    def log_message(self, *words: object) -> None:
        """Print nothing."""


def main(folder: str) -> None:
    handler = functools.partial(QuietHandler, directory=folder)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with Chromium() as browser:
        tab = browser.open(f"http://127.0.0.1:{server.server_port}/")
        tab.wait("window.palpate?.ready", 60)
        tab.evaluate(COUNT_STATES)
        x, y = tab.evaluate(CENTRE)
        tab.mouse("Moved", x, y, "none")
        tab.mouse("Pressed", x, y)
        for k in range(20):
            tab.mouse("Moved", x, y + 2 * k)
            sleep(0.05)
        sleep(1.0)
        before = tab.evaluate(STATE)
        sleep(5.0)
        after = tab.evaluate(STATE)
        seconds = (after[2] - before[2]) / 1e3
        print(
            f"{(after[0] - before[0]) / seconds:.0f} periods/s, {(after[1] - before[1]) / seconds:.0f} pictures/s, "
            f"force {tab.evaluate('palpate.force'):.3g} N"
        )


if __name__ == "__main__":
    main(sys.argv[1])
