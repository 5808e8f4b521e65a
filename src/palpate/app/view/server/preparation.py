"""Progress of the work before a session exists: its phase, and the time left by the last run on this machine."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from palpate.app.common.compile_ahead import CompiledFunctions
from palpate.app.common.compiled_code import code_digest
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import read_json, write_json
from palpate.core.working_folder import cache_folder
from palpate.surface.surface import Surface

MAX_PREVIEW_TRIANGLES = 60_000
AREA_PER_TRIANGLE = 0.35  # of a triangle between vertices of a grid, over the square of its cells
MAX_BODIES = 50  # with durations in the file
COMPILED, COMPILING = "compiled", "compiling"  # kinds of runs
MIN_SECONDS_LEFT = 1.0  # while work is left
Durations = dict[str, float]  # [s] by the text of a phase


class Preparation:
    """Progress of the preparation of a body.

    One thread begins the phases; `message` may be called from any thread. Durations of the last run of the same body on
    this machine, by the name `body`, give the time left. A run that compiles and one that finds all code compiled have
    their own. Their file is by default in the user's cache.

    `surface`, in the frame `space`, is shown meanwhile, with fewer triangles if it has many. `subtitle` is what lies in
    the body; `notes` are lines about how it was made.

    `code_is_compiled` is True if a run of the same body has ended since the sources or the cache of compiled functions
    changed.
    """

    def __init__(
        self,
        title: str,
        body: str,
        surface: Surface | None = None,
        file: Path | None = None,
        subtitle: str = "",
        notes: Sequence[str] = (),
    ) -> None:
        self.title, self._body = title, body
        self._about = {"subtitle": subtitle, "notes": list(notes)}
        self.surface = None if surface is None else coarsen(surface, MAX_PREVIEW_TRIANGLES)
        self.space = "" if surface is None else surface.space
        self._file = file or (cache_folder() or Path(os.devnull)) / "preparation.json"
        self._code = code_digest()
        self._durations: Durations = {}
        self._phase, self._began = "", monotonic()
        self._start = self._began
        self._kept = _read_durations(self._file)
        durations = self._kept.get(body, {})
        self.code_is_compiled = durations.get("code") == self._code
        self._expected: Durations = durations.get(COMPILED if self.code_is_compiled else COMPILING, {})
        self._functions = CompiledFunctions()

    def begin(self, phase: str) -> None:
        """Begin a phase, which ends the one before."""
        now = monotonic()
        if self._phase:
            self._durations[self._phase] = self._durations.get(self._phase, 0.0) + now - self._began
        self._phase, self._began = phase, now

    def end(self) -> None:
        """End the last phase, and keep the durations of all."""
        self.begin("")
        kind = COMPILING if self._functions.count else COMPILED
        before = self._kept.pop(self._body, {})
        self._kept[self._body] = {**before, "code": self._code, kind: self._durations}
        newest = dict(list(self._kept.items())[-MAX_BODIES:])
        with suppress(OSError, InputError):  # the next run has no estimate
            self._file.parent.mkdir(parents=True, exist_ok=True)
            write_json(self._file, newest)
        self.close()

    def close(self) -> None:
        """Stop counting compiled functions."""
        self._functions.close()

    def message(self) -> dict[str, Any]:
        """Return the message ``preparing`` of the protocol."""
        phase, now = self._phase, monotonic()
        fraction = left = None
        if self._expected:
            later = sum(
                seconds for name, seconds in self._expected.items() if name != phase and name not in self._durations
            )
            left = max(later + max(self._expected.get(phase, 0.0) - (now - self._began), 0.0), MIN_SECONDS_LEFT)
            fraction = (now - self._start) / (now - self._start + left)
        return {
            "type": "preparing", "title": self.title, "phase": phase, "seconds": now - self._start,
            "fraction": fraction, "seconds_left": left, "functions_compiled": self._functions.count,
            "space": self.space, **self._about,
        }  # fmt: skip


def _read_durations(file: Path) -> dict[str, Any]:
    """Return the kept durations; empty if the file is missing or damaged."""
    try:
        content = read_json(file, "durations")
    except (FileFormatError, InputError, OSError):
        return {}
    return {name: each for name, each in content.items() if _is_entry(each)}


def _is_entry(each: Any) -> bool:
    if not isinstance(each, dict):
        return False
    phases = [each.get(kind, {}) for kind in (COMPILED, COMPILING)]
    return all(
        isinstance(phase, dict) and all(isinstance(s, int | float) and 0 <= s < 1e6 for s in phase.values())
        for phase in phases
    )


def coarsen(surface: Surface, most: int) -> Surface:
    """Return a surface for display with about a number of triangles at most, by clusters of vertices on a grid."""
    if len(surface.triangles) <= most:
        return surface
    cell = np.sqrt(surface.area / (AREA_PER_TRIANGLE * most))
    places = np.rint((surface.vertices - surface.vertices.min(axis=0)) / cell).astype(np.int64)
    key = (places[:, 0] << 42) | (places[:, 1] << 21) | places[:, 2]
    _, cluster, count = np.unique(key, return_inverse=True, return_counts=True)
    vertices = np.column_stack([np.bincount(cluster, surface.vertices[:, k]) / count for k in range(3)])
    triangles = cluster[surface.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _, once = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return Surface(vertices, triangles[np.sort(once)], surface.name)
