"""Parameters declared once: the check of a value and its message, the printed line, the option of a command."""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import dataclass

import numpy as np
import pytest

import palpate as pt
from palpate.app.common.arguments import add_parameter
from palpate.core.describe import Described
from palpate.core.parameters import check_parameters, parameter
from palpate.scenes.description import Shape, Training


@dataclass(frozen=True)
class Spring(Described):
    """A spring between two points."""

    stiffness: float = parameter("N/m", help="force over length; of one turn", above=0.0, high=1e6)
    rest: float | None = parameter("m", None, "length at rest", low=0.0)
    until: float = parameter("s", np.inf, "time of release", low=0.0)
    rates: tuple[float, ...] = parameter("1/s", (), low=0.0, most=2)
    linear: bool = parameter("", True, "whether the force is linear")


def test_numbers_are_kept_as_floats_and_print_with_their_units():
    spring = Spring(np.int64(300), rest=1, rates=[1, 2])
    assert isinstance(spring.stiffness, float)
    assert (spring.rest, spring.rates) == (1.0, (1.0, 2.0))
    assert repr(spring) == "Spring(stiffness=300 N/m, rest=1 m, rates=(1, 2) 1/s, linear=yes)"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"stiffness": 0}, "stiffness of a Spring must be in (0, 1e+06] N/m, got 0; give force over length [N/m]"),
        (
            {"stiffness": np.nan},
            "stiffness of a Spring must be in (0, 1e+06] N/m, got nan; give force over length [N/m]",
        ),
        ({"stiffness": "3"}, "stiffness of a Spring must be a number, got '3'; give force over length [N/m]"),
        ({"stiffness": None}, "stiffness of a Spring must be a number, got None; give force over length [N/m]"),
        ({"rest": -1.0}, "rest of a Spring must be in [0, inf) m, got -1.0; give length at rest [m]"),
        ({"until": -np.inf}, "until of a Spring must be in [0, inf) s, got -inf; give time of release [s]"),
        ({"rates": (1.0, -2.0)}, "rates[1] of a Spring must be in [0, inf) 1/s, got -2.0; change it"),
        ({"rates": (1, 2, 3)}, "rates of a Spring must have at most 2 entries, got 3; leave some out"),
        ({"linear": 1}, "linear of a Spring must be True or False, got 1; give one of them"),
    ],
)
def test_a_wrong_value_is_refused_with_its_range_and_what_to_give(given, message):
    with pytest.raises(pt.InputError) as caught:
        Spring(**({"stiffness": 1.0} | given))
    assert str(caught.value) == message


def test_parameters_that_are_left_out_are_not_checked():
    spring = Spring(1.0)
    object.__setattr__(spring, "rest", -1.0)
    check_parameters(spring, left_out=("rest",))
    with pytest.raises(pt.InputError, match="rest must be in"):
        check_parameters(spring)


def test_an_option_has_the_type_range_choices_and_default_of_its_declaration(capsys):
    parser = ArgumentParser()
    for section, name in (
        (Shape, "units"),
        (Shape, "scale"),
        (Shape, "repair"),
        (Training, "depth"),
        (Training, "paths"),
    ):
        add_parameter(parser, section, name)
    assert vars(parser.parse_args([])) == {"units": None, "scale": 1.0, "repair": False, "depth": None, "paths": 12}
    arguments = parser.parse_args(["--depth", "5 mm", "--paths", "3", "--repair", "--units", "cm"])
    assert (arguments.depth, arguments.paths, arguments.repair, arguments.units) == (0.005, 3, True, "cm")
    for words, message in (
        (["--depth", "1"], "must be in (0, 0.2] m, got '1'; give depth of the deepest press, and length of the"),
        (["--paths", "1.5"], "must be a whole number"),
        (["--paths", "0"], "must be in [1, 100000], got 0; give runs to train on"),
        (["--units", "ft"], "invalid choice"),
    ):
        with pytest.raises(SystemExit):
            parser.parse_args(words)
        assert message in capsys.readouterr().err
