"""Former public names give the same values, with a warning at the caller."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.core.deprecation import renamed_attribute
from palpate.realtime.engine import _max_backlog
from palpate.realtime.statistics import Histograms


class Spring:
    """A class with a renamed attribute."""

    stiffness = 3.0
    firmness = renamed_attribute("Spring", "firmness", "stiffness")


def test_a_former_attribute_is_the_new_one_with_a_warning_at_the_caller():
    with pytest.warns(DeprecationWarning, match=r"^Spring.firmness is Spring.stiffness since") as warned:
        assert Spring().firmness == 3.0
    assert [each.filename for each in warned] == [__file__]


def test_statistics_have_their_former_names():
    statistics = pt.Statistics.from_histograms(Histograms.zeros(), 1e-3)
    names = {
        "verdict": "status", "sustained": "is_real_time", "pace": "real_time_factor", "lateness": "wakeup_latency",
    }  # fmt: skip
    for former, name in names.items():
        with pytest.warns(DeprecationWarning, match=f"{former} is Statistics.{name}"):
            assert getattr(statistics, former) == getattr(statistics, name)


def test_states_and_reports_have_their_former_names():
    state = pt.State(np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.warns(DeprecationWarning, match=r"State.incision is State.cut_front"):
        assert state.incision is None
    report = pt.typing.StabilityReport("given", None, np.nan, 0.0, 1.0, 2.0)
    with pytest.warns(DeprecationWarning, match=r"StabilityReport.verdict is StabilityReport.status"):
        assert report.verdict == "stability not examined"


def test_models_and_engines_take_their_former_names():
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    block = pt.Solid(pt.box((0.03, 0.03, 0.015), spacing=0.005), tissue, fixed="z-")
    ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    with pytest.warns(DeprecationWarning, match=r"realtime_model\(scaled_modes=\)"):
        model = pt.realtime_model(block, contact=ball, tailored_modes=0)
    with pytest.warns(DeprecationWarning, match=r"RealtimeModel.max_backlog"):
        assert model.catch_up == model.max_backlog > 0
    with pytest.warns(DeprecationWarning, match=r"Engine\(out_of_training=\)"):
        engine = pt.Engine(model, on_distrust="ignore")
    with pytest.warns(DeprecationWarning, match=r"Engine.swap_data") as warned:
        engine.exchange(model.data)
    assert [each.filename for each in warned] == [__file__]


class EarlierModel:
    """A model of a user with the attribute by which the engine asked for the backlog."""

    catch_up = 2


def test_the_engine_reads_the_former_attribute_of_a_model():
    with pytest.warns(DeprecationWarning, match=r"max_backlog"):
        assert _max_backlog(EarlierModel()) == 2
