"""Errors of arguments: their tracebacks end in the user's line, and they name what a call may have."""

from __future__ import annotations

import traceback

import numpy as np
import pytest

import palpate as pt
from palpate.core.faults import check_call


def frames_of(error):
    """Return the frames of a traceback, each with whether it is hidden."""
    return [(frame.f_globals["__name__"], frame.f_locals.get("__tracebackhide__", False)) for frame, _ in walked(error)]


def walked(error):
    return list(traceback.walk_tb(error.__traceback__))


@pytest.mark.parametrize(
    "call",
    [
        lambda: pt.box((0.1, 0.1, 0.1), spacing=-1.0),
        lambda: pt.SurfaceForce("x+", force=5),
        lambda: pt.load("model.vtk"),
        lambda: pt.materials.fit("Yeho", []),
    ],
    ids=["a function", "a load", "a file", "a law"],
)
def test_notebooks_hide_the_frames_of_palpate_and_show_those_of_the_user(call):
    with pytest.raises(pt.InputError) as caught:
        call()
    frames = frames_of(caught.value)
    assert len(frames) > 2
    assert all(hidden == name.startswith("palpate") for name, hidden in frames)


def test_a_function_that_the_user_gives_stays_in_the_traceback():
    def motion(time):
        return pt.box((1, 1, 1), spacing=-time - 1)

    ball = pt.tools.Contact(pt.tools.Sphere(0.01), motion)
    with pytest.raises(pt.InputError) as caught:
        ball.poses(np.zeros(1))
    shown = [frame.f_code.co_name for frame, _ in walked(caught.value) if not frame.f_locals.get("__tracebackhide__")]
    assert shown[-1] == "motion"


@check_call
def stepped(duration, *, step=1.0, tolerance=0.1):
    """Return a duration, or fail inside."""
    if tolerance == 0.0:
        raise TypeError("inside")
    return duration * step


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 1.0, "dt": 0.1}, "must be among duration, step, tolerance, got dt; did you mean step?"),
        ({"duration": 1.0, "tolerence": 0.1}, "got tolerence; did you mean tolerance?"),
        ({"duration": 1.0, "wholly": 0.1}, "got wholly; leave it out"),
        ({}, "must be complete: missing 1 required positional argument: 'duration'"),
    ],
)
def test_a_call_with_unknown_or_missing_arguments_is_refused_with_those_that_exist(options, message):
    with pytest.raises(pt.InputError, match="arguments of stepped") as caught:
        stepped(**options)
    assert message in str(caught.value)
    assert stepped(2.0, step=3.0) == 6.0


def test_too_many_arguments_are_refused_in_the_words_of_python():
    with pytest.raises(pt.InputError, match=r"^stepped takes 1 positional argument but 2 were given$"):
        stepped(1.0, 2.0)


def test_an_error_inside_a_function_is_not_one_of_its_call():
    with pytest.raises(TypeError, match="inside"):
        stepped(1.0, tolerance=0.0)


def test_runs_and_bodies_name_the_argument_that_is_meant(bar, tissue):
    with pytest.raises(pt.InputError, match=r"arguments of rollout must be among .*, got dt; did you mean step\?"):
        pt.rollout(None, duration=1.0, every=0.1, dt=1e-3)
    with pytest.raises(pt.InputError, match=r"arguments of Solid must be among .*, got fixd; did you mean fixed\?"):
        pt.Solid(bar, tissue, fixd="x-")
    with pytest.raises(pt.InputError, match="cloud must be a Cloud, got MooneyRivlin"):
        pt.Solid(tissue, bar)


def test_a_model_without_some_methods_is_abstract_and_one_without_a_stress_says_so():
    with pytest.raises(TypeError, match="abstract class Mine"):
        type("Mine", (pt.typing.Model,), {})()
    model = type("Mine", (pt.typing.Model,), dict.fromkeys(pt.typing.Model.__abstractmethods__))()
    with pytest.raises(pt.InputError, match=r"cauchy_stress must be defined .*, got Mine.*; define it"):
        model.cauchy_stress(np.zeros((1, 3)))
