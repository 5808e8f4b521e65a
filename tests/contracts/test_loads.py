"""Every kind of load moves every kind of model, or is refused by name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import pytest
from contract_models import (
    BALL,
    EACH_KIND,
    EVERY,
    KINDS,
    QUICK,
    SPACING,
    hyper_touched,
    hyper_with_tool,
    lift,
    linear_with_tool,
    press,
    pull,
    run,
    solid,
    wave,
)

import palpate as pt
from palpate.compiled.reference import StoredRecord
from palpate.dynamics.loads import prepared as prepared_loads
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import Load

pytestmark = [pytest.mark.quick(kind=QUICK), pytest.mark.each_kind(kind=EACH_KIND)]

TOP = (0.02, 0.0075, 0.015)  # of the free end of the block
ASIDE = np.array([0.3, 0.0, 1.0])

# one of each kind, and of each way to give it; a new kind needs its own here
ON_SOLIDS = {
    pt.SurfaceForce: {
        "force": pt.SurfaceForce("x+", force=lambda t: 0.03 * wave(t) * ASIDE),
        "moment": pt.SurfaceForce("x+", moment=lambda t: 1e-3 * wave(t) * ASIDE),
    },
    pt.Pressure: {"pressure": pt.Pressure("x+", lambda t: 200.0 * wave(t))},
    pt.Gravity: {"gravity": pt.Gravity((0.0, 3.0, -9.81))},
    pt.PrescribedMotion: {"motion": pt.PrescribedMotion("x+", lambda points, t: 2e-6 * wave(t) * ASIDE)},
    pt.tools.Grasp: {"grasp": pt.tools.Grasp(TOP, 1.2 * SPACING, lambda t: np.array(TOP) + 2e-4 * wave(t) * ASIDE)},
    pt.tools.Contact: {"contact": replace(press(side="y"), name="probe")},
    pt.Foundation: {"springs": pt.Foundation("y+", 1e7, 10.0)},
}
ON_SHEETS = {
    pt.SurfaceForce: {
        "force": pt.SurfaceForce("face", force=lambda t: 0.05 * wave(t) * ASIDE),
        "moment": pt.SurfaceForce("face", moment=lambda t: 1e-3 * wave(t) * ASIDE),
    },
    pt.Pressure: {"pressure": pt.Pressure("face", lambda t: 30.0 * wave(t))},
    pt.Gravity: {"gravity": pt.Gravity((0.0, 3.0, -9.81))},
    pt.PrescribedMotion: {"motion": pt.PrescribedMotion("tool", lambda points, t: 2e-4 * wave(t) * ASIDE)},
    pt.tools.Grasp: {"grasp": pt.tools.Grasp((0.0, 0.0), SPACING, lambda t: 2e-4 * wave(t) * ASIDE)},
    pt.tools.Contact: {
        "contact": pt.tools.Contact(
            pt.tools.Sphere(BALL), lambda t: np.array([0.0, 0.0, BALL + 1e-4 - 1e-3 * wave(t)]), name="probe"
        )
    },
    pt.Foundation: {"springs": pt.Foundation("face", 1e6, 10.0)},
}
WAYS = [f"{kind.__name__}, {way}" for kind, ways in ON_SOLIDS.items() for way in ways]


def example(name, model):
    kind, way = name.split(", ")
    table = ON_SOLIDS if model.cloud.points.shape[1] == 3 else ON_SHEETS
    return next(ways[way] for own, ways in table.items() if own.__name__ == kind)


def refused(call, load, way):
    """Return whether a call refuses a load; then its message names the load by its kind, its place, or its way."""
    try:
        call()
    except pt.InputError as error:
        message = str(error)
    else:
        return False
    place = getattr(load, "group", None) or getattr(load, "name", None)
    assert any(name in message for name in (type(load).__name__, way, repr(place))), message
    return True


def kinds_of_loads():
    """Return the members of `Load`; of dead loads palpate's own."""
    dead = {kind for kind in DeadLoad.__subclasses__() if kind.__module__.startswith("palpate.")}
    return set(get_args(Load)) - {DeadLoad} | dead


def test_every_kind_of_load_has_an_example():
    assert kinds_of_loads() == set(ON_SOLIDS) == set(ON_SHEETS)


@pytest.mark.slow
@pytest.mark.parametrize("name", WAYS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_load_moves_the_model_or_is_refused_by_name(kind, name):
    model, base = KINDS[kind].make(), KINDS[kind].loads()
    load, way = example(name, model), name.split(", ")[1]
    others = [own for own in base if not isinstance(load, pt.PrescribedMotion) or type(own) is not type(load)]
    if refused(lambda: model.prepare([*others, load]), load, way):
        return
    runs = [run(model, base, duration=4 * EVERY).displacements]
    # a motion across supports is known when its function is called
    if refused(lambda: runs.append(run(model, [*others, load], duration=4 * EVERY).displacements), load, way):
        assert len(model.supports) > 1
        return
    without, with_it, again = *runs, run(model, base, duration=4 * EVERY).displacements
    assert np.abs(with_it[-1] - without[-1]).max() > 1e-4 * np.abs(without[-1]).max()
    np.testing.assert_array_equal(without, again)  # and it acts in its own run only


@dataclass(frozen=True)
class Wind:
    """A load that no model has forces for."""

    group: str = "x+"


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_kind_of_load_is_refused_until_a_model_has_forces_for_it(kind, monkeypatch):
    """Also by reduced models of a full model that has them."""
    model = KINDS[kind].make()
    with pytest.raises(pt.InputError, match="Wind"):
        model.prepare([*KINDS[kind].loads(), Wind()])
    if kind.startswith(("solid", "membrane")):
        return
    monkeypatch.setattr(prepared_loads, "Load", prepared_loads.Load | Wind)  # as if full models had its forces
    for module in (
        "palpate.reduction.hyper.loads.prepare_loads",
        "palpate.dynamics.solid.base.prepare_loads",
        "palpate.dynamics.solid.energy.prepare_loads",
        "palpate.dynamics.membrane.model.prepare_loads",
    ):
        original = pytest.importorskip(module.rpartition(".")[0]).prepare_loads
        monkeypatch.setattr(
            module,
            lambda cloud, fixed, loads, *rest, _own=original, **options: _own(
                cloud, fixed, [load for load in loads if not isinstance(load, Wind)], *rest, **options
            ),
        )
    with pytest.raises(pt.InputError, match="Wind"):
        model.prepare([*KINDS[kind].loads(), Wind()])


# in real time


def periods(ready, motion, count=12):
    """Return the coordinates after some periods of 1 ms in which the tool goes by a displacement (3,) [m]."""
    q, v, report = ready.rest.copy(), np.zeros_like(ready.rest), np.zeros(8 + len(ready.tool))
    data = StoredRecord(ready.data)  # by address as in the engine, which has compiled that
    for k in range(count):
        pose = np.concatenate([(k + 1) / count * np.asarray(motion), np.zeros(9)])
        ready.advance(data, q, v, ready.tool @ pose, 1e-3, report)
        assert report[0] == 0.0
    return q


WAY = np.array([1e-4, -1e-3, -1e-3])


@pytest.mark.slow
@pytest.mark.parametrize("name", WAYS)
@pytest.mark.parametrize("make", [hyper_with_tool, hyper_touched], ids=["held", "touched"])
def test_in_real_time_a_load_moves_a_sampled_model_or_is_refused_by_name(make, name):
    model, way = make(), name.split(", ")[1]
    load = example(name, model)
    tool = None if make is hyper_with_tool else press(0.0)
    ways = {"contact": {"contact": load}, "foundations": {"contact": tool, "foundations": [load]}}
    acted = []
    for options in ways.values():
        if refused(lambda options=options: pt.realtime_model(model, **options), load, way):
            continue
        ready, still = pt.realtime_model(model, **options), pt.realtime_model(model, contact=tool)
        acted.append(np.abs(periods(ready, WAY) - periods(still, WAY if "foundations" in options else 0 * WAY)).max())
    assert all(change > 1e-9 for change in acted)
    if isinstance(load, pt.Foundation) or (
        make is hyper_touched and isinstance(load, pt.tools.Contact | pt.tools.Grasp)
    ):
        assert len(acted) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", WAYS)
def test_in_real_time_a_load_moves_a_linear_model_or_is_refused_by_name(name):
    full, way = solid("energy"), name.split(", ")[1]
    load = example(name, full)
    tool = isinstance(load, pt.PrescribedMotion | pt.tools.Grasp)

    def ready():
        system = pt.lti.linearise(full, [load] if tool else [lift(), load], ["x+"])
        return pt.realtime_model(pt.lti.reduce_linear(system, "modal", 4))

    assert refused(ready, load, way) != tool
    if tool:
        assert np.abs(periods(ready(), WAY * 1e-2)).max() > 0


@pytest.mark.slow
def test_a_linear_model_in_real_time_requires_one_tool():
    assert np.abs(periods(pt.realtime_model(linear_with_tool()), 1e-2 * WAY)).max() > 0
    with pytest.raises(pt.InputError, match="one PrescribedMotion or Grasp"):
        pt.realtime_model(pt.lti.reduce_linear(pt.lti.linearise(solid("energy"), [pull()], ["x+"]), "modal", 4))
