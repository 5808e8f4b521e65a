"""The loads of a reduced model: which it takes, and what prescribed motions are to its lifting columns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Forceps, Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import PRESCRIBED, Load, PreparedLoads, check_kinds, listed, prepare_loads
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.membrane.model import load_areas
from palpate.faults import InputError
from palpate.reduction.hyper.data import ReducedData

__all__ = ["lifting_coordinates", "prepare_reduced_loads"]


KINDS = (DeadLoad, Gravity, PrescribedMotion, Grasp, Contact, Foundation)  # whose forces the step has
MISSED = 1e-3  # share of a prescribed motion that the lifting columns may miss


def prepare_reduced_loads(data: ReducedData, loads: Sequence[Load], *, implicit: bool) -> PreparedLoads:
    """Make loads ready for a reduced model, stepped explicitly or not.

    Raises
    ------
    InputError
        Loads that it does not know, or was not trained with.
    """
    check_kinds(loads, KINDS, "loads of a sampled reduced model")
    about = data.kinematics
    loads = [
        _forceps(data, load) if isinstance(load, Grasp) and load.name not in data.prescribed else load
        for load in listed(loads)
    ]
    areas = partial(load_areas, data.cloud, about.prestretch) if about.sheet else None
    ready = prepare_loads(data.cloud, data.fixed, loads, areas)
    if len(ready.sites.pressure_node):
        raise InputError("a reduced model knows no follower pressures yet: use palpate.galerkin for them")
    if ready.tools and (data.prescribed or about.sheet):
        raise InputError(
            "tools (Contact, Grasp) do not touch reduced membranes, nor reduced models that tools hold (driven): "
            "run the full model"
        )
    if ready.tools and (data.compliance is None or implicit):
        raise InputError(
            "tools (Contact, Grasp) touch a reduced model that is stepped explicitly and was trained on runs in which "
            "they do: train it with a Contact, and leave its step out"
        )
    constrained_inverse_mass = {motion.group for motion, _ in ready.motions}
    if constrained_inverse_mass != set(data.prescribed):
        wanted = ", ".join(map(repr, data.prescribed)) or "no group"
        raise InputError(
            f"this reduced model was trained with {wanted} driven, not with {sorted(constrained_inverse_mass) or 'none'}: "
            "give it those motions, or train it with these"
        )
    if len({motion.until for motion, _ in ready.motions}) > 1:
        raise InputError("a reduced model needs all tools to let go at one time; give them the same `until`")
    return ready


def _forceps(data: ReducedData, grasp: Grasp) -> Contact:
    """Return a grasp as the tool that it is on the surface of a reduced model."""
    if grasp.name in data.cloud.groups:
        raise InputError(f"Grasp {grasp.name!r}: {grasp.name!r} is a group of the body; give the grasp another name")
    constrained_inverse_mass = np.concatenate(
        [np.zeros(0, dtype=np.int64), *(data.cloud.group(name) for name in data.fixed)]
    )
    nodes = grasp.with_group(data.cloud).group(grasp.name)
    if np.isin(nodes, constrained_inverse_mass).any():
        raise InputError(f"Grasp {grasp.name!r}: some nodes within {grasp.radius:g} m of it are fixed; hold others")
    return Contact(Forceps(grasp.radius, grasp.point, grasp.until), grasp.motion, name=grasp.name)


def lifting_coordinates(data: ReducedData, ready: PreparedLoads, times: Floats) -> Floats:
    """Return the coordinates (t, l) of the lifting columns at some times.

    Raises
    ------
    InputError
        A motion that is not a rigid tool's.
    """
    if not data.lifted:
        return np.zeros((len(times), 0))
    order = np.argsort(ready.sites.prescribed)
    motion = ready.schedule(times).motion[:, order].reshape(len(times), -1)
    nodes = np.flatnonzero(ready.sites.kind == PRESCRIBED)
    span = data.basis_vectors[data.modes : data.modes + data.lifted, nodes].reshape(data.lifted, -1)
    coordinates = np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T
    missed = np.abs(coordinates @ span - motion).max()
    if missed > MISSED * max(float(np.abs(motion).max()), 1e-3 * data.cloud.spacing):
        raise InputError(
            f"the prescribed motion is not one this reduced model knows: {missed:.3g} m of it is missed at "
            f"t = {times[0]:.4g} s; it can only be moved and turned as a rigid tool"
        )
    return np.asarray(coordinates)
