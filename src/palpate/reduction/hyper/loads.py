"""Loads of a reduced model: checks, and coordinates of the lifting functions under prescribed motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, partial

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.contact.tools import Contact, Forceps, Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import (
    Load,
    LoadSites,
    PreparedLoads,
    check_kinds,
    listed,
    prepare_loads,
    with_held_nodes,
)
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.supports import PRESCRIBED
from palpate.dynamics.membrane.model import load_areas
from palpate.reduction.hyper.body import ReducedBody
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.foundation import Springs, project_springs
from palpate.reduction.hyper.load_share import Response, ResponseSquares, response_squares

PERMITTED_LOADS = (DeadLoad, Gravity, PrescribedMotion, Grasp, Contact, Foundation)  # whose forces the step has
RIGID_TOLERANCE = 1e-3  # largest error of a prescribed motion in the lifting functions, relative


@dataclass(frozen=True, kw_only=True)
class ReducedLoads(PreparedLoads):
    """Loads prepared for a reduced model."""

    body: ReducedBody = field(repr=False, compare=False)
    # returns the static response of the body without foundations; called at the first use of `responses`
    static_response: Callable[[], Response] = field(repr=False, compare=False)
    # (g a + 3, c) array: work of unit amplitudes of dead loads and gravity on the basis vectors, see `load_work`
    work: Floats
    # springs, coordinate_springs: foundations on the trial and test basis, and on the coordinates only
    springs: Springs
    coordinate_springs: Springs

    def forces(self, times: Floats) -> Floats:
        """Return the generalised forces (t, c) of dead loads and gravity at some times [s]."""
        schedule, count = self.schedule(times), len(times)
        values = (schedule.amplitudes.reshape(count, -1), schedule.gravity)
        return np.asarray(np.hstack(values) @ self.work)

    @cached_property
    def responses(self) -> ResponseSquares:
        """Squares of the static responses to the loads, see `palpate.reduction.hyper.load_share`."""
        return response_squares(self.body, self.sites, self.static_response)

    def amplitudes(self, time: float) -> Floats:
        """Return the amplitudes of `responses` at a time [s]: loads, lifting coordinates and their accelerations.

        Accelerations of tools in their rest pose are left out: the body has not moved yet.
        """
        schedule, data = self.schedule(np.array([time])), self.body.data
        motion = np.zeros((2, data.lifting_count))
        if data.lifting_count and self.is_prescribed(np.array([time]))[0]:
            motion[0] = lifting_coordinates(data, self, np.array([time]))[0]
            if motion[0].any():
                motion[1] = self.rates(lambda times: lifting_coordinates(data, self, times), time)[1]
        return np.concatenate([schedule.amplitudes[0].ravel(), schedule.gravity[0], motion.ravel()])


def reduced_loads(body: ReducedBody, prepared: PreparedLoads) -> ReducedLoads:
    """Return loads that were prepared for a body."""
    if (
        not isinstance(prepared, ReducedLoads)
        or prepared.body.data.trial_and_test_basis is not body.data.trial_and_test_basis
    ):
        raise InputError("prepared must come from prepare() of the same reduced model, got those of another one")
    return prepared


def prepare_reduced_loads(
    body: ReducedBody, loads: Load | Sequence[Load], static_response: Callable[[], Response], *, implicit: bool
) -> ReducedLoads:
    """Check loads and prepare them for a reduced model with explicit or implicit steps."""
    loads = listed(loads)
    check_kinds(
        loads, PERMITTED_LOADS, "loads of a sampled reduced model", "run the full model or palpate.galerkin with it"
    )
    data = body.data
    kinematics = data.kinematics
    loads = [
        _forceps(data, load) if isinstance(load, Grasp) and load.name not in data.prescribed else load for load in loads
    ]
    areas = partial(load_areas, data.cloud, kinematics.prestretch) if kinematics.sheet else None
    ready = prepare_loads(data.cloud, data.supports, loads, areas)
    ready = with_held_nodes(ready, body.masses, data.wave_speed / data.cloud.spacing)
    if ready.tools and (data.prescribed or kinematics.sheet):
        raise InputError(
            "loads must hold no Contact or Grasp for a reduced membrane or a model with prescribed groups, got one; "
            "run the full model"
        )
    if ready.tools and (data.compliance is None or implicit):
        raise InputError(
            "loads must hold no Contact or Grasp for a model with implicit steps or without contact in training, "
            "got one; train it with a Contact, and leave step out, so that it is stepped explicitly"
        )
    moved_groups = {motion.group for motion, _ in ready.motions}
    if moved_groups != set(data.prescribed):
        expected, actual = (
            ", ".join(map(repr, names)) or "no group" for names in (data.prescribed, sorted(moved_groups))
        )
        raise InputError(
            f"loads must prescribe the motion of {expected} as in training, got {actual}; "
            "give the model those motions, or train it with these"
        )
    if len({motion.until for motion, _ in ready.motions}) > 1:
        raise InputError("until must be the same for all tools, got several times; give all motions one `until`")
    springs = project_springs(ready.sites, data.trial_and_test_basis, body.mass)
    return ReducedLoads(
        **{entry.name: getattr(ready, entry.name) for entry in fields(ready)},
        body=body,
        static_response=static_response,
        work=load_work(ready.sites, data.trial_and_test_basis, body.masses),
        springs=springs,
        coordinate_springs=springs.of(np.arange(body.count)),
    )


def _forceps(data: ReducedData, grasp: Grasp) -> Contact:
    """Return a grasp as a rigid tool on the contact surface."""
    if grasp.name in data.cloud.groups:
        raise InputError(
            f"name of a Grasp must differ from the groups of the body, got {grasp.name!r}; give it another name"
        )
    fixed_nodes = np.concatenate(
        [np.zeros(0, dtype=np.int64), *(data.cloud.group(support.group) for support in data.supports)]
    )
    nodes = grasp.with_group(data.cloud).group(grasp.name)
    if np.isin(nodes, fixed_nodes).any():
        raise InputError(
            f"Grasp {grasp.name!r} must hold free nodes only, got fixed nodes within {grasp.radius:g} m; move it away"
        )
    return Contact(Forceps(grasp.radius, grasp.point, grasp.until), grasp.motion, name=grasp.name)


def lifting_coordinates(data: ReducedData, ready: PreparedLoads, times: Floats) -> Floats:
    """Return the coordinates (t, l) of the lifting functions at some times."""
    if not data.lifting_count:
        return np.zeros((len(times), 0))
    order = np.argsort(ready.sites.prescribed)
    motion = ready.schedule(times).motion[:, order].reshape(len(times), -1)
    nodes = np.flatnonzero(ready.sites.kind == PRESCRIBED)
    span = data.trial_and_test_basis[data.modes : data.modes + data.lifting_count, nodes].reshape(
        data.lifting_count, -1
    )
    coordinates = np.ascontiguousarray(np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T)
    error = np.abs(coordinates @ span - motion).max()
    if error > RIGID_TOLERANCE * max(float(np.abs(motion).max()), 1e-3 * data.cloud.spacing):
        raise InputError(
            f"displacement of a prescribed group must be rigid, got an error of {error:.3g} m at t = {times[0]:.4g} s; "
            "translate and rotate the group as a rigid tool"
        )
    return coordinates


def load_work(sites: LoadSites, basis_vectors: Floats, masses: Floats) -> Floats:
    """Return the work (g a + 3, m) of unit amplitudes of g dead loads and of unit gravity on (m, n, 3) vectors."""
    works = []
    for g in range(len(sites.dead_start) - 1):
        entries = slice(sites.dead_start[g], sites.dead_start[g + 1])
        works.append(np.einsum("kac,mkc->am", sites.dead_pattern[entries], basis_vectors[:, sites.dead_node[entries]]))
    return np.concatenate([*works, np.einsum("n,mnc->cm", masses, basis_vectors)])
