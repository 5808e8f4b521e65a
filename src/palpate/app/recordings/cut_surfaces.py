"""Surfaces of a recorded body that is cut, snapshot by snapshot."""

from __future__ import annotations

import numpy as np

from palpate.app.recordings.recording import Recording
from palpate.dynamics.solid.cutting.cut import cut_from
from palpate.dynamics.solid.model import EnergySolid
from palpate.realtime.bodies.cut_display import CutFullSurface
from palpate.realtime.bodies.display_surface import DisplaySurface
from palpate.realtime.bodies.full_surface import FullSurface, display_surface


class CutSurfaces:
    """Surfaces of a recording; `whole` is that of the body without a cut."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self._count = recording, 0
        self.whole: DisplaySurface = display_surface(recording.model)
        self._present = self.whole

    def at(self, frame: int) -> DisplaySurface:
        """Return the surface that is drawn at a snapshot; the same object while the cut does not change."""
        cuts = [change for change in self._recording.cuts if change.start <= frame]
        if len(cuts) != self._count:
            self._count, triangles = len(cuts), np.zeros((0, 3, 3))
            for change in cuts:
                triangles = np.concatenate([triangles[: change.kept], change.triangles])
            self._present, model = self.whole, self._recording.model
            if len(triangles) and isinstance(self.whole, FullSurface) and isinstance(model, EnergySolid):
                self._present = CutFullSurface(cut_from(model, 0, triangles), self.whole)
        return self._present
