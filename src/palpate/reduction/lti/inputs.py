"""Loads as inputs of a linear system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import Load, PreparedLoads, check_kinds, listed
from palpate.reduction.lti.system import INPUT_LOADS, LinearSystem

RIGID_TOLERANCE = 1e-2  # largest error of a tool's motion in small translations and rotations, relative


@dataclass(frozen=True, kw_only=True)
class LinearLoads(PreparedLoads):
    """Loads prepared for a linear system, whose inputs they are."""

    input_count: int  # number p of inputs other than tools
    force_inputs: tuple[slice, ...]  # inputs of every dead load
    gravity_inputs: slice | None

    def inputs(self, times: Floats) -> Floats:
        """Return the inputs (t, p) of loads other than tools at some times [s]."""
        schedule, values = self.schedule(times), np.zeros((len(times), self.input_count))
        for load, entries in enumerate(self.force_inputs):
            values[:, entries] += schedule.amplitudes[:, load, : entries.stop - entries.start]
        if self.gravity_inputs is not None:
            values[:, self.gravity_inputs] += schedule.gravity
        return values


def _input(load: DeadLoad) -> tuple[str, str, tuple[str, ...]]:
    """Return kind, group and amplitudes of a load, which identify it as an input."""
    return type(load).__name__, load.group, load.labels


def prepare_linear_loads(system: LinearSystem, loads: Load | Sequence[Load]) -> LinearLoads:
    """Check loads and prepare them for a linear system."""
    loads = listed(loads)
    check_kinds(loads, INPUT_LOADS, "loads of a linear model")
    full = system.model
    ready = full.prepare(loads)
    inputs = {_input(load) for load in system.loads if isinstance(load, DeadLoad)}
    weight = any(isinstance(load, Gravity) for load in system.loads)
    for load in ready.loads:
        if isinstance(load, DeadLoad) and _input(load) not in inputs:
            known = ", ".join(f"{name} on {group!r}" for name, group, _ in sorted(inputs)) or "no dead load"
            raise InputError(f"loads must be those of the linear system ({known}), got {load!r:.200}")
        if isinstance(load, Gravity) and not weight:
            raise InputError("loads must not include Gravity for a system without it; linearise with Gravity")
    actual = {name: nodes for name, nodes in ready.supports.items() if name not in full.fixed}
    linear = full.prepare(system.loads)
    expected = {name: nodes for name, nodes in linear.supports.items() if name not in full.fixed}
    same = actual.keys() == expected.keys() and all(np.array_equal(actual[name], expected[name]) for name in expected)
    if not same or any(motion.until < np.inf for motion, _ in ready.motions):
        raise InputError(
            f"loads must prescribe {sorted(expected) or 'no group'} without release, as in the linear system, "
            f"got {sorted(actual) or 'none'}"
        )
    return _with_inputs(system, ready)


def linear_loads(prepared: PreparedLoads) -> LinearLoads:
    """Return loads that were prepared for a linear system."""
    if not isinstance(prepared, LinearLoads):
        raise InputError("prepared must come from prepare() of a linear model, got those of another kind of model")
    return prepared


def _with_inputs(system: LinearSystem, ready: PreparedLoads) -> LinearLoads:
    """Return prepared loads with the inputs of a system that they are."""
    places, place, gravity = {}, 0, None
    for load in system.loads:
        if isinstance(load, DeadLoad):
            places[_input(load)] = slice(place, place + len(load.labels))
            place += len(load.labels)
        elif isinstance(load, Gravity):
            gravity, place = slice(place, place + 3), place + 3
    return LinearLoads(
        **{entry.name: getattr(ready, entry.name) for entry in fields(ready)},
        input_count=system.forces,
        force_inputs=tuple(places[_input(load)] for load in ready.dead_loads),
        gravity_inputs=gravity,
    )


def tool_coordinates(system: LinearSystem, prepared: PreparedLoads, times: Floats) -> Floats:
    """Return the coordinates (t, l) of the tools at some times [s]: translations [m], small rotations [rad]."""
    if not len(system.lifting):
        return np.zeros((len(times), 0))
    prescribed = prepared.sites.prescribed
    motion = prepared.schedule(times).motion.reshape(len(times), -1)
    span = system.lifting[:, prescribed].reshape(len(system.lifting), -1)
    coordinates = np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T
    missed = np.abs(coordinates @ span - motion).max()
    if missed > RIGID_TOLERANCE * max(float(np.abs(motion).max()), 1e-3 * system.model.cloud.spacing):
        raise InputError(
            f"motion of the tool must be small and rigid, got an error of {missed:.3g} m at t = {times[0]:.4g} s"
        )
    return np.asarray(coordinates)


def tool_accelerations(system: LinearSystem, prepared: PreparedLoads, time: float) -> Floats:
    """Return the accelerations (l,) of the tools at a time [s]."""
    if not len(system.lifting):
        return np.zeros(0)
    return prepared.rates(lambda times: tool_coordinates(system, prepared, times), time)[1]
