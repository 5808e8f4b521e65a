"""Forces on tools made those of the full model's runs, by repeating some of them with the reduced one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import InputError
from palpate.reduction.basis.snapshots import Run
from palpate.reduction.contact.compliance import SurfaceCompliance, secant_factor
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.fit_compliance import fit_stiffening

__all__ = ["Trial", "calibrate_contact"]

Trial = tuple[Sequence[Load], Run]

FORCE_PASSES, FORCE_STEP = 2, 1.4  # corrections of the surface's compliance; exponent: part of a depth is the modes'
LEAST_FORCE = 0.1  # of a run's largest: frames by which it is corrected
FORCE_SPREAD = 0.02  # of the force: frames that err by more count by their sign rather than their size


def calibrate_contact(model: ReducedModel, repeated: Sequence[Trial]) -> tuple[ReducedModel, dict[str, Any]]:
    """Scale the compliance of the surface, its hardening and its grip, until tools' forces are those of full runs.

    It is learnt from displacements under known forces. A step asks the other way round, and forces that it finds lean
    on nodes that give way too easily: a bias that is alike all over a body. Forceps hold their nodes wherever they
    lean, and have a factor of their own.

    Parameters
    ----------
    model : ReducedModel
        That knows its surface's compliance.
    repeated : sequence of (loads, trajectory or path)
        Runs of the full model, and their loads.

    Returns
    -------
    model : ReducedModel
    report : dict
        ``"force_factor"`` on the compliance under presses, and ``"force_ratios"``: median ratio of the impulses of a
        run's tools to those of the full model, before each correction and after the last.

    Raises
    ------
    InputError
        No tool touches the body in one of the runs, or none touches the reduced one.
    """
    compliance, whole, ratios = model.data.compliance, 1.0, []
    assert compliance is not None
    for number in range(FORCE_PASSES + 1):
        model = ReducedModel(replace(model.data, compliance=compliance))
        found = [_force_sizes(model, *trial) for trial in repeated]
        ratios.append(float(np.median([mine.sum() / theirs.sum() for mine, theirs in found])))
        if number < FORCE_PASSES:
            held = np.array([any(isinstance(load, Grasp) for load in loads) for loads, _ in repeated])
            bonded_scale, factor, stiffening = compliance.bonded_scale, 1.0, compliance.stiffening
            if held.any():
                bonded_scale *= _scale([sizes for sizes, own in zip(found, held, strict=True) if own])
            if not held.all():
                presses = [sizes for sizes, own in zip(found, held, strict=True) if not own]
                factor, stiffening = _correction(compliance, np.concatenate(presses, axis=1))
            whole *= factor
            compliance = compliance.scaled(factor)._replace(stiffening=stiffening, bonded_scale=bonded_scale / factor)
    return model, {"force_factor": whole, "force_ratios": ratios}


def _scale(sizes: Sequence[Floats]) -> float:
    """Return a factor on a compliance by forces (2, t) [N] of it and of runs, some runs of each."""
    mine, theirs = np.concatenate(sizes, axis=1)
    return float(np.exp(FORCE_STEP * np.median(np.log(mine / theirs))))


def _correction(compliance: SurfaceCompliance, sizes: Floats) -> tuple[float, Floats]:
    """Return a factor on a compliance, and its hardening (2,), by forces (2, t) [N] of it and of runs.

    By most frames: a run that errs far more than the others, where a tool meets an edge, moves it little.
    """
    mine, theirs = sizes
    wanted = secant_factor(compliance.stiffening, theirs) * (mine / theirs) ** FORCE_STEP
    return fit_stiffening(theirs, wanted, np.ones(len(theirs)), FORCE_SPREAD)


def _force_sizes(model: ReducedModel, loads: Sequence[Load], kept: Run) -> Floats:
    """Return the sizes (2, t) [N] of the force on tools, and of that of the full run, where that is not small."""
    run = kept if isinstance(kept, Trajectory) else Trajectory.load(kept)
    names = [load.name for load in loads if isinstance(load, Contact | Grasp)]
    if not names or not len(run.contact_forces):
        raise InputError("repeated: no tool touches the body in one of these runs; give others")
    every = float(run.times[1] - run.times[0])
    own = rollout(model, loads, duration=float(run.times[-1]), every=every, progress=False)
    sizes = np.array([sum(np.linalg.norm(of.reactions[name], axis=1) for name in names) for of in (own, run)])
    if not 0.0 < sizes[0].sum() < np.inf:
        raise InputError("repeated: a tool that touches the full body does not touch the reduced one; give more modes")
    return np.asarray(sizes[:, (sizes[1] > LEAST_FORCE * sizes[1].max()) & (sizes[0] > 0)])
