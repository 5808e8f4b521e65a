"""What tests do with the page in a browser, and what they look at."""

from __future__ import annotations

import contextlib
import io
from time import sleep

import pytest
from chromium import find_chromium

__all__ = ["NARROW", "WIDE", "around", "hold", "middle", "needs_chromium", "opening", "picture", "press"]

WIDE, NARROW = (1024, 640), (360, 740)
needs_chromium = pytest.mark.skipif(
    find_chromium() is None, reason="no Chromium on this machine; on Debian: apt-get install chromium"
)


@contextlib.contextmanager
def opening(browser):
    """Yield a function that opens a page and waits for the body; afterwards no tab may have seen an error."""
    tabs = []

    def open_tab(address, size=WIDE, **options):
        tab = browser.open(address, *size, **options)
        tabs.append(tab)
        tab.wait("window.palpate?.ready", 60)
        return tab

    yield open_tab
    errors = [error for tab in tabs for error in tab.errors]
    for tab in tabs:
        tab.close()
    assert not errors


def middle(tab):
    """Where the middle of the body is in the window [px]."""
    place = "(() => { const b = document.getElementById('view').getBoundingClientRect();"
    return tab.evaluate(f"{place} const [x, y] = palpate.project([0, 0, 0]); return [b.x + x, b.y + y]; }})()")


def picture(tab):
    from matplotlib.image import imread

    return imread(io.BytesIO(tab.screenshot()))[..., :3]


def around(image, x, y, half=8):
    return image[int(y) - half : int(y) + half, int(x) - half : int(x) + half].mean(axis=(0, 1))


def press(tab, depth=40, steps=6):
    """Hold on the middle of the body and drag down by some pixels."""
    x, y = middle(tab)
    tab.mouse("Moved", x, y, "none")
    tab.mouse("Pressed", x, y)
    for k in range(1, steps + 1):
        tab.mouse("Moved", x, y + depth * k / steps)
        sleep(0.02)
    return x, y + depth


def hold(tab, at=(0, 0)):
    """Hold some pixels from the middle of what is seen of the body."""
    x, y = tab.evaluate(
        "(() => { const b = document.getElementById('view').getBoundingClientRect(), { sphere } = palpate.scene.body;"
        "const [x, y] = palpate.project(sphere.center.toArray()); return [b.x + x, b.y + y]; })()"
    )
    x, y = x + at[0], y + at[1]
    tab.mouse("Moved", x, y, "none")
    tab.mouse("Pressed", x, y)
    return x, y
