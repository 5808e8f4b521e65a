"""Calibration of the surface compliance to the tool forces of full-model runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.reactions import contact_outputs
from palpate.dynamics.run.rollout import frame_states
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.basis.snapshots import Run
from palpate.reduction.contact.compliance import SurfaceCompliance, secant_factor
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.fit_compliance import fit_stiffening
from palpate.reduction.training.parallel_runs import in_threads

Trial = tuple[Sequence[Load], Run]
GivenTrial = tuple[Load | Sequence[Load], Run]  # with one load or several

FORCE_PASSES = 2  # corrections of the surface compliance
FORCE_STEP = 1.4  # exponent of a correction, because part of a displacement is that of the modes
MIN_FORCE = 0.1  # of frames in the calibration, as a fraction of the run's largest force
FORCE_SPREAD = 0.02  # relative error of the force above which a frame has reduced weight


def calibrate_contact(model: ReducedModel, repeated: Sequence[Trial]) -> tuple[ReducedModel, dict[str, Any]]:
    """Scale the surface compliance, its stiffening and its bonded scale to the tool forces of full runs.

    The compliance is fitted to displacements under known forces. A step solves the inverse problem, and its forces
    concentrate on nodes that are too compliant. The resulting bias is the same all over a body. Forceps hold their
    nodes in any case, and have a factor of their own.

    Returns the model and a report. Its ``"force_factor"`` is on the compliance under presses. ``"force_ratios"`` are
    median ratios of the impulses of the tools to those of the full model, before each correction and after the last.
    """
    compliance, total_factor, ratios = model.data.compliance, 1.0, []
    assert compliance is not None
    whole_runs = [_FullForces(*trial) for trial in repeated]
    for number in range(FORCE_PASSES + 1):
        model = model.with_data(compliance=compliance)
        sizes_by_run = in_threads(partial(_force_sizes, model), whole_runs)
        ratios.append(float(np.median([mine.sum() / theirs.sum() for mine, theirs in sizes_by_run])))
        if number < FORCE_PASSES:
            are_grasps = np.array([any(isinstance(load, Grasp) for load in loads) for loads, _ in repeated])
            bonded_scale, factor, stiffening = compliance.bonded_scale, 1.0, compliance.stiffening
            if are_grasps.any():
                bonded_scale *= _scale([sizes for sizes, grasp in zip(sizes_by_run, are_grasps, strict=True) if grasp])
            if not are_grasps.all():
                presses = [sizes for sizes, grasp in zip(sizes_by_run, are_grasps, strict=True) if not grasp]
                factor, stiffening = _correction(compliance, np.concatenate(presses, axis=1))
            total_factor *= factor
            compliance = compliance.scaled(factor)._replace(stiffening=stiffening, bonded_scale=bonded_scale / factor)
    return model, {"force_factor": total_factor, "force_ratios": ratios}


def _scale(sizes: Sequence[Floats]) -> float:
    """Return a factor on a compliance from forces (2, t) [N] of reduced and full runs."""
    mine, theirs = np.concatenate(sizes, axis=1)
    return float(np.exp(FORCE_STEP * np.median(np.log(mine / theirs))))


def _correction(compliance: SurfaceCompliance, sizes: Floats) -> tuple[float, Floats]:
    """Return a factor on a compliance, and its stiffening (2,), from forces (2, t) [N] of reduced and full runs.

    The fit is robust: a run with a much larger error than the others, such as a tool at an edge, has
    little influence.
    """
    mine, theirs = sizes
    factors = secant_factor(compliance.stiffening, theirs) * (mine / theirs) ** FORCE_STEP
    return fit_stiffening(theirs, factors, np.ones(len(theirs)), FORCE_SPREAD)


class _FullForces:
    """Loads of a run of the full model, and the magnitudes (f,) [N] of its tool forces."""

    def __init__(self, loads: Sequence[Load], stored: Run) -> None:
        run = stored if isinstance(stored, Trajectory) else Trajectory.load(stored)
        self.loads, self.names = loads, [load.name for load in loads if isinstance(load, Contact | Grasp)]
        if not self.names or not len(run.contact_forces):
            raise InputError("repeated must be runs with contact, got one without; leave it out")
        self.every, self.sizes = float(run.times[1] - run.times[0]), _sizes(self.names, [run.reactions])


def _sizes(names: Sequence[str], forces: Sequence[Mapping[str, Floats]]) -> Floats:
    """Return the sum over tools of the magnitudes of their forces, whose last axis has 3 components."""
    return np.concatenate(
        [np.atleast_1d(sum(np.linalg.norm(frame[name], axis=-1) for name in names)) for frame in forces]
    )


def _force_sizes(model: ReducedModel, run: _FullForces) -> Floats:
    """Return the magnitudes (2, t) [N] of the tool force in the reduced and the full run, where it is not small."""
    prepared, work = model.prepare(run.loads), model.workspace()
    states = frame_states(model, model.state(prepared), prepared, len(run.sizes) - 1, run.every, None, work)
    with np.errstate(all="ignore"):  # non-finite values raise errors that name them
        contact_forces = [contact_outputs(state, prepared)[0] for _, state, *_ in states]
    sizes = np.array([[0.0, *_sizes(run.names, contact_forces)], run.sizes])
    if not 0.0 < sizes[0].sum() < np.inf:
        raise InputError("repeated must be runs with contact on the reduced body, got one without; give more modes")
    return np.asarray(sizes[:, (sizes[1] > MIN_FORCE * sizes[1].max()) & (sizes[0] > 0)])
