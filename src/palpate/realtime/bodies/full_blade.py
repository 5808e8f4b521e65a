"""Cuts of a full body in the engine: the body is cut next to the running loop, and swapped between two periods.

A cutter takes the state of a period and cuts the body along the path of the blade
(`palpate.dynamics.solid.cutting.blade_cut`), while the loop goes on with the body before. The new constants then take
their places in the data of the period. A blade in tissue moves at most so fast that it advances by half a spacing in
the mean time of a cut, and no blade moves further than that from where the body was cut last.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.deprecation import renamed_attribute
from palpate.core.faults import CloudError, DivergenceError, InputError
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.blade_sites import AWAY_TOOL, EDGE_SITE, NO_TOOL
from palpate.dynamics.contact.grip import nodes_in_grip
from palpate.dynamics.contact.impulses import WITH_BLADE
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.supports import FREE
from palpate.dynamics.nodal.mass_scaling import without_nodes
from palpate.dynamics.nodal.period import nodal_period
from palpate.dynamics.nodal.period_data import LOST, NO_BLADE, NodalPeriodData
from palpate.dynamics.nodal.tool_path import END, HOME, LAST_CUT
from palpate.dynamics.run.model import State
from palpate.dynamics.solid.cutting.blade_cut import advance_blade
from palpate.dynamics.solid.cutting.cut_front import CutFront
from palpate.dynamics.solid.cutting.face_pairs import face_pairs, turn_pairs
from palpate.dynamics.solid.model import EnergySolid
from palpate.realtime.calls import model_calls

MAX_DISTANCE_OF_A_CUT = 0.5  # largest distance of a blade from where it cut the body last, in spacings
TURN_INTERVAL = 0.05  # [s] between turns of the normals of faces
MEAN_CUTS, FIRST_SECONDS = 5.0, 0.03  # cuts over which their time is averaged, and the first guess [s]
MAX_STROKES = 10  # that can be undone; each keeps a body: 9 kB a node
MIN_VOLUME_RATIO, MAX_STRETCH = 0.4, 3.0  # of tissue that is joined again where a cut has parted it
NO_POSE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


class BladeCutter:
    """Cuts a full body, `model`, with the blade that the engine moves; `data` are those of the running period.

    The engine steps with `advance`, the compiled period of the body (`palpate.dynamics.nodal.period.nodal_period`),
    with cuts from the first blade on. `wrap` makes the data of the engine's model from those of the period.

    `blade` is the number of the tool that is a blade, or NO_BLADE; `cut_front` is the front of its cut, or None. `cuts`
    counts swaps of the body since it was whole, `restorations` the times that it was made whole again. `seconds` [s] is
    the mean time of a cut. `failure` is the reason why the last cut was not made; it is empty if it was.
    """

    incision = renamed_attribute("BladeCutter", "incision", "cut_front")

    def __init__(self, model: EnergySolid, advance: Any, data: NodalPeriodData) -> None:
        self.advance = advance
        self.whole_model, self.model, self.data, self.blade = model, model, data, NO_BLADE
        self.cut_front: CutFront | None = None
        self.cuts, self.restorations, self.failure, self.wrap = 0, 0, "", lambda data: data
        self.lock = threading.RLock()
        self._strokes: deque[EnergySolid] = deque(maxlen=MAX_STROKES)  # the body before each stroke that cut, and now
        self._contact: Contact | None = None
        self.seconds = FIRST_SECONDS
        self._whole = data.body.mass_scaling, data.body.resting_frequency  # of the body without cuts
        self._is_due, self._is_compiled, self._turned = False, False, 0.0

    wrap: Callable[[Any], Any]

    @property
    def totals(self) -> Floats:
        """Cut area [m^2], released energy, and energies dissipated at the edge and by friction [J] of this blade."""
        return np.zeros(4) if self.cut_front is None else self.cut_front.totals

    @property
    def cutting_force(self) -> float:
        """Force [N] with which a push of the blade along its axis cuts: of the pieces of its edge that hold tissue."""
        sites = self.data.tools.contacts.sites
        edge = (sites.kind == EDGE_SITE) & (sites.tool >= 0)
        return float(sites.limits[edge] @ np.abs(sites.directions[edge, 2]))

    @property
    def tears(self) -> bool:
        """Whether the front releases more energy per area than the toughness: tissue would tear ahead of the blade."""
        if self._contact is None or self.cut_front is None or self.cut_front.hold is None:
            return False
        if not self.cut_front.hold.is_front:
            return False
        return self.cut_front.release_rate >= self._contact.tool.toughness > 0.0  # type: ignore[union-attr]

    def set_blade(self, blade: Blade | None, pose: Floats, tool: int = 0) -> None:
        """Set a tool in a pose (7,): a blade, or None for one that does not cut. The engine must be paused."""
        if blade is None and tool != self.blade:
            return
        with self.lock:
            if blade is not None and not self._is_compiled:
                self._compile(blade)
            tools = self.data.tools.contacts.sites.tool
            tools[tools != NO_TOOL] = AWAY_TOOL  # the sites of the blade before
            if blade is not None and not (self._strokes and self._strokes[-1] is self.model):
                self._strokes.append(self.model)
            self._contact = None if blade is None else Contact(blade, (pose[:3], pose[3:]), name="blade")
            self.blade = NO_BLADE if blade is None else tool
            self.cut_front, self.failure, self._is_due = None, "", True

    def _compile(self, blade: Blade) -> None:
        """Compile the period with cuts, and cut a copy of the body from above: nothing is compiled next to the loop."""
        self.advance = nodal_period(self.whole_model.formulation, WITH_BLADE)
        model_calls(self.advance, None, self.data)
        model, frame = self.whole_model, np.eye(3, 4)
        points, spacing = model.cloud.points, model.cloud.spacing
        away = np.linalg.norm((points - points.mean(axis=0))[:, :2], axis=1)
        column = points[away < away.min() + spacing]
        frame[:, 3] = column[column[:, 2].argmax()] - (0.0, 0.0, np.asarray(blade.edge)[:, 2].min() - spacing)
        contact, no_nodes = Contact(blade, (frame[:, 3], (0.0, 0.0, 0.0)), name="blade"), np.zeros(0, dtype=np.int64)
        state = State(np.zeros_like(points), np.zeros_like(points))
        with suppress(CloudError, InputError):  # of a surface that cannot be cut there
            for depth in (0.0, 1.5, 0.5, 0.5):
                frame[2, 3] -= depth * spacing
                model, cut_front, sites, _ = advance_blade(model, state, contact, frame.copy(), no_nodes)
                state = replace(state, cut_front=cut_front)
            turn_pairs(sites, model.cut_state, state.coordinates)
        self._is_compiled = True

    def put_away(self) -> None:
        """Put the blade away, so that `update` returns data without it; the engine must be paused."""
        self.set_blade(None, NO_POSE, self.blade)

    def restore(self) -> None:
        """Return to the whole body; the engine must be paused."""
        with self.lock:
            self.put_away()
            self.model, self.cuts = self.whole_model, 0
            self._strokes.clear()
            self.restorations += 1

    @property
    def strokes(self) -> int:
        """Number of strokes that `undo` can take back: of those that have cut, at most the last ten."""
        kept = tuple(self._strokes)  # without the lock, which a cut holds
        return len(kept) - bool(kept and kept[-1] is self.model)

    def undo(self, coordinates: Floats) -> bool:
        """Return to the body before the last stroke that cut; the engine must be paused, and goes on after `update`.

        A stroke lasts from where a blade is put down until it is put away, as this does, too. The result is whether the
        joined tissue bears the displacements of coordinates (3 n,) [m]: otherwise the body must start from rest.
        """
        with self.lock:
            if not self.strokes:
                raise InputError("undo must follow a stroke that has cut, got none; cut first")
            self.put_away()
            if self._strokes[-1] is self.model:
                self._strokes.pop()
            cut_model, self.model = self.model, self._strokes.pop()
            self.cuts += 1
            if self.model is self.whole_model:
                self.cuts, self.restorations = 0, self.restorations + 1
            u = coordinates.reshape(-1, 3)
            if not _bears(self.model, u):
                return False
            self.data.energies[LOST] += cut_model.strain_energy(u) - self.model.strain_energy(u)  # the latter is larger
            return True

    def update(self, coordinates: Floats) -> Any:
        """Return new data for the engine's loop, or None: the body cut up to where the blade is.

        The coordinates are (3 n,) [m].
        """
        with self.lock:
            if self._contact is None and not self._is_due:
                self._turn_pairs(coordinates)
                return None
            began, released = perf_counter(), 0.0
            sites = None
            if self._contact is not None:
                sites, released = self._advance(self._contact, coordinates)
                if sites is None and not self._is_due:
                    return None
            if sites is None:
                sites = face_pairs(self.model.cut_state, coordinates.reshape(-1, 3))
            self._is_due = False
            is_blade = self._contact is not None
            if self.cut_front is not None:
                self.cut_front = self.cut_front.with_works(*map(float, self.data.tools.contacts.sites.works))
            self.seconds += (perf_counter() - began - self.seconds) / MEAN_CUTS
            self.data.energies[LOST] += released
            mass_scaling, lost = without_nodes(self._whole[0], self.model.cut_state.touched)
            body, tools = self.data.body, self.data.tools
            self.data = self.data._replace(
                body=body._replace(
                    mass_scaling=mass_scaling,
                    resting_frequency=max(lost, self._whole[1]),
                    passes=(self.model.step_body, body.passes[1]),
                    tension_compression_passes=(
                        self.model.tension_compression_step_body,
                        body.tension_compression_passes[1],
                    ),
                ),
                tools=tools._replace(contacts=tools.contacts._replace(sites=sites), blade=self.blade),
                limits=self.data.limits._replace(
                    blade=self._reach(),
                    cut=MAX_DISTANCE_OF_A_CUT * self.model.cloud.spacing if is_blade else np.inf,
                ),
            )
            return self.wrap(self.data)

    def _turn_pairs(self, coordinates: Floats) -> None:
        """Turn the normals along which the faces of the cut touch each other, now and then."""
        sites, now = self.data.tools.contacts.sites, perf_counter()
        if len(sites.kind) and now - self._turned > TURN_INTERVAL:
            self._turned = now
            sites.directions[:] = turn_pairs(sites, self.model.cut_state, coordinates.reshape(-1, 3)).directions

    def _reach(self) -> float:
        """Return the largest displacement [m] of the blade in a step."""
        if self.cut_front is None or self.cut_front.hold is None or not len(self.cut_front.hold.pieces):
            return self.data.limits.tool
        step = self.whole_model.stability.step
        return min(self.data.limits.tool, MAX_DISTANCE_OF_A_CUT * self.model.cloud.spacing * step / self.seconds)

    def _advance(self, contact: Contact, coordinates: Floats) -> tuple[Any, float]:
        """Cut up to the blade; return its new sites or None, and the released energy [J]."""
        u = coordinates.reshape(-1, 3)
        state = State(u, np.zeros_like(u), cut_front=_constant(self.cut_front))
        held = np.union1d(np.flatnonzero(self.data.body.sites.kind != FREE), nodes_in_grip(self.data.tools.grip))
        before, path = self.model, self.data.tools.path[self.blade]
        frame = path[HOME if self.cut_front is None else END].copy()
        try:
            model, cut_front, sites, released = advance_blade(before, state, contact, frame, held, self.blade)
        except (CloudError, DivergenceError, InputError) as error:
            self.failure = str(error)
            if self.cut_front is None:  # cuts nothing, and moves freely
                path[LAST_CUT] = path[END]
            return None, 0.0
        path[LAST_CUT] = frame
        self.cuts += model is not before
        self.model, self.cut_front, self.failure = model, cut_front, ""
        return sites, released


def _bears(model: EnergySolid, u: Floats) -> bool:
    """Return whether tissue has moderate stretches at displacements (n, 3) [m]."""
    if not np.isfinite(u).all():
        return False
    gradient = model.deformation_gradient(u)
    stretches = np.linalg.svd(gradient, compute_uv=False)
    return bool(np.linalg.det(gradient).min() > MIN_VOLUME_RATIO and stretches.max() < MAX_STRETCH)


def _constant(cut_front: CutFront | None) -> CutFront | None:
    """Return a cut front with the present slips of its sites, which the loop goes on to write."""
    if cut_front is None or cut_front.hold is None:
        return cut_front
    return replace(cut_front, hold=cut_front.hold._replace(slips=cut_front.hold.slips.copy()))
