"""Cuts of a body by a blade between the steps of a run."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import DivergenceError, InputError, first_few
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.blade_sites import BladeSites
from palpate.dynamics.contact.geometry import contact_work, rotation
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.loads.supports import FREE
from palpate.dynamics.run.model import MANY_STEPS, State
from palpate.dynamics.solid.cutting.cut import cut_from
from palpate.dynamics.solid.cutting.cut_front import (
    CutFront,
    advance_edge,
    after_cut,
    blade_sites,
    edge_limits,
    edge_points,
    front_release_rate,
    next_strip,
    start_cut_front,
)
from palpate.dynamics.solid.cutting.face_pairs import face_pairs, joined_sites, turn_pairs

STEP_WAY = 0.1  # of the edge between two cuts, in spacings
SUPPORT_DISTANCE = 0.5  # from a cut to the nodes that supports and tools hold, in spacings


def blade_of(prepared: PreparedLoads) -> tuple[int, Contact] | None:
    """Return the number of the tool that is a blade, and the tool; None without a blade."""
    blades = [(t, tool) for t, tool in enumerate(prepared.tools) if isinstance(tool.tool, Blade)]
    if len(blades) > 1:
        raise InputError(f"loads must have one Blade at most, got {len(blades)}; make the cuts one after the other")
    return blades[0] if blades else None


def steps_of_blade(prepared: PreparedLoads, state: State, step: float, spacing: float) -> int:
    """Return the steps [s] in which no point of the edge moves by more than a tenth of the spacing."""
    tool = blade_of(prepared)
    if tool is None:
        return MANY_STEPS
    points = edge_points(tool[1].tool, spacing)  # type: ignore[arg-type]
    frames = [_frame(tool[1], time) for time in (state.time, state.time + step)]
    way = np.linalg.norm(points @ (frames[1] - frames[0])[:, :3].T + (frames[1] - frames[0])[:, 3], axis=1).max()
    return max(1, min(MANY_STEPS, int(STEP_WAY * spacing / max(way, 1e-30 * spacing)))) if way > 0 else MANY_STEPS


def _frame(tool: Contact, time: float) -> Floats:
    """Return the frame (3, 4) of a tool at a time [s]."""
    frame = np.zeros((3, 4))
    rotation(tool.poses(np.array([time]))[0], frame)
    return frame


def cut_with_blade(body: Any, state: State, prepared: PreparedLoads) -> tuple[Any, State, PreparedLoads]:
    """Return the body that a blade has cut after some steps, the state, and the loads with the blade's new sites."""
    blade = blade_of(prepared)
    if blade is None:
        return body, state, with_turned_pairs(body, state.coordinates, prepared)
    number, tool = blade
    frame = _frame(tool, state.time)
    held = np.flatnonzero(prepared.sites.kind != FREE)
    largest = 0.0 if state.cut_front is None else state.cut_front.largest_rate
    body, cut_front, sites, released = advance_blade(body, state, tool, frame, held, number)
    if largest < tool.tool.toughness <= cut_front.largest_rate:  # type: ignore[union-attr]
        _warn_of_tearing(tool, state.time)
    state = replace(state, cut_front=cut_front, dissipated=state.dissipated + released)
    if sites is not None:
        prepared = replace(prepared, contacts=prepared.contacts._replace(sites=sites))
    return body, state, prepared


def _warn_of_tearing(tool: Contact, time: float) -> None:
    warnings.warn(
        f"the tissue would tear ahead of Contact {tool.name!r} from {time:.3g} s on: the front releases more energy "
        "per area than the toughness, and the run cuts as far as the blade only; lower the tension, or use the frames "
        "before",
        stacklevel=2,
    )


def with_turned_pairs(body: Any, u: Floats, prepared: PreparedLoads) -> PreparedLoads:
    """Return loads in which the faces of a cut touch each other along the normals of displacements (n, 3)."""
    sites = prepared.contacts.sites
    if not len(sites.kind):
        return prepared
    turned = turn_pairs(sites, body.cut_state, u)
    return replace(prepared, contacts=prepared.contacts._replace(sites=turned))


def with_pairs(body: Any, prepared: PreparedLoads) -> PreparedLoads:
    """Return the loads of a cut body, whose faces touch each other."""
    count, contacts = len(body.cloud), prepared.contacts
    sites, work = face_pairs(body.cut_state, np.zeros((count, 3))), contact_work(contacts.candidates, count)
    return replace(prepared, contacts=contacts._replace(sites=sites, work=work))


def advance_blade(
    body: Any, state: State, tool: Contact, frame: Floats, held: Any, number: int = 0
) -> tuple[Any, CutFront, Any, float]:
    """Return the body that a blade in a frame (3, 4) has cut, the cut front, the new sites or None, and a lost energy.

    The energy [J] is what the body loses at fixed displacements. `held` are nodes (h,) that supports or other tools
    hold.
    """
    blade: Any = tool.tool
    cloud, u, history = body.cloud, state.coordinates, state.history
    cut_state, cut_front = body.cut_state, state.cut_front
    corners = cloud.points[cloud.triangles]
    if cut_front is None:
        cut_front, sites = _start(body, u, tool, frame, number)
        return body, *_with_faces(cut_front, sites, face_pairs(cut_state, u)), 0.0
    cuts = advance_edge(cut_state, cut_front, blade, frame, u, corners)
    if not cuts and (cut_front.hold is None or not len(cut_front.hold.pieces)):  # outside the tissue
        return body, replace(cut_front, release_rate=0.0), None, 0.0
    before = body.evaluate(u, history)
    rate = front_release_rate(body, cut_front, u, before)
    is_front = cut_front.hold is not None and cut_front.hold.is_front
    for edge, pieces, area in cuts:
        strip, triangles, replaced = next_strip(cut_front.strip, cut_front.edge, edge, pieces, cloud.spacing)
        if len(triangles):
            _check_distance(tool, triangles, cloud.points, held, cloud.spacing)
            body = cut_from(body, len(body.cut_surface.triangles) - replaced, triangles)
        cut_front = after_cut(cut_front, edge, strip, area)
    largest = max(rate, cut_front.largest_rate) if is_front else cut_front.largest_rate
    cut_front = replace(cut_front, release_rate=rate, largest_rate=largest)
    if not cuts:
        if cut_front.hold is not None:
            cut_front.hold.limits[:] = edge_limits(blade, rate, cut_front.hold.areas)
        return body, cut_front, None, 0.0
    released = float(body.volumes @ before.energy_density) - body.strain_energy(u, history)
    sites, cut_front, _ = blade_sites(body.cut_state, cut_front, blade, frame, u, corners, number)
    return body, *_with_faces(cut_front, sites, face_pairs(body.cut_state, u)), released


def _start(body: Any, u: Floats, tool: Contact, frame: Floats, number: int) -> tuple[CutFront, BladeSites]:
    """Return the cut front of a blade in a frame (3, 4) and its sites; raise `InputError` for one in the body."""
    blade: Any = tool.tool
    state, corners = body.cut_state, body.cloud.points[body.cloud.triangles]
    sites, cut_front, length = blade_sites(
        state, start_cut_front(state, blade, frame, u), blade, frame, u, corners, number
    )
    if length > 0:
        raise InputError(
            f"motion of Contact {tool.name!r} must start outside the body, got {length:.3g} m of the edge inside; "
            "start it outside and move it in"
        )
    return cut_front, sites


def _with_faces(cut_front: CutFront, sites: BladeSites, pairs: BladeSites) -> tuple[CutFront, BladeSites]:
    """Return the cut front, and the sites of its blade followed by pairs of faces."""
    joined = joined_sites(sites, pairs)
    if cut_front.hold is not None:  # the step writes the slips of the joined sites, and reads the limits
        count = len(cut_front.hold.pieces)
        cut_front = replace(
            cut_front, hold=cut_front.hold._replace(slips=joined.slips[:count], limits=joined.limits[:count])
        )
    return cut_front, joined


def _check_distance(tool: Contact, triangles: Floats, points: Floats, held: Any, spacing: float) -> None:
    """Raise `DivergenceError` for a cut that reaches held nodes."""
    if not len(held):
        return
    samples = np.concatenate([triangles.mean(axis=1), triangles.reshape(-1, 3)])
    distance = np.linalg.norm(points[held, None] - samples[None], axis=2).min(axis=1)
    reached = held[distance < SUPPORT_DISTANCE * spacing]
    if reached.size:
        raise DivergenceError(
            f"Contact {tool.name!r} cuts at nodes {first_few(reached)}, which a support or a tool holds; end its "
            "motion before, or support the body elsewhere"
        )
