"""Loads of a reduced model: checks, and coordinates of the lifting vectors under prescribed motions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Forceps, Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import Load, PreparedLoads, check_kinds, listed, prepare_loads
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.supports import PRESCRIBED
from palpate.dynamics.membrane.model import load_areas
from palpate.faults import InputError
from palpate.reduction.hyper.data import ReducedData

__all__ = ["lifting_coordinates", "prepare_reduced_loads"]


KINDS = (DeadLoad, Gravity, PrescribedMotion, Grasp, Contact, Foundation)  # whose forces the step has
RIGID_TOLERANCE = 1e-3  # largest error of a prescribed motion in the lifting vectors, relative


def prepare_reduced_loads(data: ReducedData, loads: Sequence[Load], *, implicit: bool) -> PreparedLoads:
    """Check loads and prepare them for a reduced model with explicit or implicit steps.

    Raises
    ------
    InputError
        A load is not supported, or was not part of the training.
    """
    check_kinds(loads, KINDS, "loads of a sampled reduced model", "run the full model or palpate.galerkin with it")
    kinematics = data.kinematics
    loads = [
        _forceps(data, load) if isinstance(load, Grasp) and load.name not in data.prescribed else load
        for load in listed(loads)
    ]
    areas = partial(load_areas, data.cloud, kinematics.prestretch) if kinematics.sheet else None
    ready = prepare_loads(data.cloud, data.supports, loads, areas)
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
        expected, given = (
            ", ".join(map(repr, names)) or "no group" for names in (data.prescribed, sorted(moved_groups))
        )
        raise InputError(
            f"loads must prescribe the motion of {expected} as in training, got {given}; "
            "give the model those motions, or train it with these"
        )
    if len({motion.until for motion, _ in ready.motions}) > 1:
        raise InputError("until must be the same for all tools, got several times; give all motions one `until`")
    return ready


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
    """Return the coordinates (t, l) of the lifting vectors at some times.

    Raises
    ------
    InputError
        A prescribed motion is not rigid.
    """
    if not data.lifting_count:
        return np.zeros((len(times), 0))
    order = np.argsort(ready.sites.prescribed)
    motion = ready.schedule(times).motion[:, order].reshape(len(times), -1)
    nodes = np.flatnonzero(ready.sites.kind == PRESCRIBED)
    span = data.basis_vectors[data.modes : data.modes + data.lifting_count, nodes].reshape(data.lifting_count, -1)
    coordinates = np.ascontiguousarray(np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T)
    error = np.abs(coordinates @ span - motion).max()
    if error > RIGID_TOLERANCE * max(float(np.abs(motion).max()), 1e-3 * data.cloud.spacing):
        raise InputError(
            f"displacement of a prescribed group must be rigid, got an error of {error:.3g} m at t = {times[0]:.4g} s; "
            "translate and rotate the group as a rigid tool"
        )
    return coordinates
