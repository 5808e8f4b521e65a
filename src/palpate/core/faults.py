"""Exceptions of the package, and checks of arguments.

A message about an argument reads ``<argument> must be <condition>, got <value>; <remedy>``.
"""

from __future__ import annotations

import inspect
import math
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

# names of arguments in other programs, and palpate's
ARGUMENT_ALIASES = {"dt": "step", "time_step": "step", "tol": "tolerance", "maxiter": "max_iterations", "bc": "fixed"}


class InputError(ValueError):
    """Invalid argument: out of range, unknown, or inconsistent with another one.

    Notebooks show its message below the line of the user, without palpate's own frames.

    Examples
    --------
    >>> import palpate as pt
    >>> try:
    ...     pt.box((0.2, 0.02, 0.02), spacing=-0.005)
    ... except pt.InputError as error:
    ...     print(error)
    spacing must be in [1e-09, 1e+09] m, got -0.005
    """

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)
        _hide_frames()


class ChoiceError(InputError):
    """Argument without which a file of several things cannot be used.

    `table` has what there is to choose from, a line each; `choice` the arguments that choose the likeliest.
    """

    def __init__(self, message: str, table: str, choice: Mapping[str, str]) -> None:
        super().__init__(message)
        self.table, self.choice = table, dict(choice)


class CloudError(InputError):
    """Cloud of points that does not support moving least squares.

    Attributes
    ----------
    nodes : (k,) int array
        Nodes at fault; empty if unknown.

    Examples
    --------
    >>> import palpate as pt
    >>> points = pt.box((0.4, 0.4, 0.4), spacing=0.1).points
    >>> points[7] = points[3]
    >>> try:
    ...     pt.moving_least_squares(points, neighbours=42)
    ... except pt.CloudError as error:
    ...     print(sorted(map(int, error.nodes)))
    [3, 7]
    """

    def __init__(self, message: str, nodes: Any = ()) -> None:
        import numpy as np  # here, so that help texts answer without it

        super().__init__(message)
        self.nodes = np.array(nodes, dtype=np.int64)


class FileFormatError(InputError):
    """Invalid file: truncated, corrupt, or of another format.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> path = Path(tempfile.mkdtemp()) / "model.rom"
    >>> _ = path.write_bytes(b"not a model")
    >>> try:
    ...     pt.load(path)
    ... except pt.FileFormatError as error:
    ...     print(type(error).__name__)
    FileFormatError
    """


class UnitWarning(UserWarning):
    """A value is far from that of tissue, as one in another unit is."""


class TrustWarning(RuntimeWarning):
    """An error indicator is above 1: the reduced model was not trained on such states.

    Examples
    --------
    >>> import warnings
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4)
    >>> sideways = pt.SurfaceForce("x+", force=(0, 0.1, 0))
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     run = pt.rollout(model, [sideways], duration=0.01, every=0.001)
    >>> caught[0].category.__name__, bool(run.trust.max() > 1)
    ('TrustWarning', True)
    """


class DivergenceError(RuntimeError):
    """Simulation that left the range of finite states.

    Attributes
    ----------
    trajectory : object
        Results up to the failure.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> force = pt.SurfaceForce("x+", force=(50, 0, 0))
    >>> try:
    ...     pt.rollout(bar, [force], duration=0.1, every=0.01, step=0.01)
    ... except pt.DivergenceError as error:
    ...     print(error.trajectory.complete)
    False
    """

    def __init__(self, message: str, trajectory: object = None) -> None:
        super().__init__(message)
        _hide_frames()
        self.trajectory = trajectory


def _hide_frames() -> None:
    """Mark the frames of palpate by the local variable with which IPython and pytest leave them out of tracebacks."""
    frame = sys._getframe(1)
    while frame.f_back is not None:
        frame = frame.f_back
        name = frame.f_globals.get("__name__", "")
        if name.partition(".")[0] in ("palpate", "contextlib") and frame.f_code.co_name != "<module>":
            frame.f_locals["__tracebackhide__"] = True


def check_call(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Let a function refuse arguments that it does not have, and missing ones, by `InputError`."""

    @wraps(function)
    def call(*arguments: Parameters.args, **options: Parameters.kwargs) -> Result:
        try:
            return function(*arguments, **options)
        except TypeError as error:
            if is_of_call(error):
                raise argument_error(function.__name__, function, options, error) from None
            raise

    return call


def is_of_call(error: TypeError) -> bool:
    """Return whether the call in the present frame has raised an error, and not the function that it calls."""
    return error.__traceback__ is not None and error.__traceback__.tb_next is None


def argument_error(name: str, function: Any, options: Iterable[str], error: TypeError) -> InputError:
    """Return the error of a call of a function with unknown, missing or too many arguments."""
    allowed = [each for each in inspect.signature(function).parameters if each not in ("self", "_", "__")]
    for option in options:
        if option not in allowed:
            near = [ARGUMENT_ALIASES.get(option, ""), *get_close_matches(option, allowed, 1)]
            remedy = next((f"; did you mean {each}?" for each in near if each in allowed), "; leave it out")
            return InputError(f"arguments of {name} must be among {', '.join(allowed)}, got {option}{remedy}")
    reason = str(error).partition("() ")[2] or str(error)
    if reason.startswith("missing"):
        return InputError(f"arguments of {name} must be complete: {reason}")
    return InputError(f"{name} {reason}")


def number_in_range(
    name: str,
    value: float,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    open_low: bool = False,
    open_high: bool = False,
    unit: str = "",
    remedy: str = "",
) -> float:
    """Return `value` as a float in the interval from `low` to `high`, of which an open end is excluded."""
    tail = f"; {remedy}" if remedy else ""
    try:
        if isinstance(cast(object, value), str | bytes):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be a number, got {brief(value)}{tail}") from None
    below = number <= low if open_low else number < low
    above = number >= high if open_high else number > high
    if not math.isfinite(number) or below or above:
        unbounded = low == -high == -math.inf
        inside = interval(low, high, open_low=open_low, open_high=open_high, unit=unit)
        raise InputError(f"{name} must be {'finite' if unbounded else f'in {inside}'}, got {brief(value)}{tail}")
    return number


def interval(low: float, high: float, *, open_low: bool = False, open_high: bool = False, unit: str = "") -> str:
    """Return an interval such as ``(0, inf) Pa``."""
    left = "(" if open_low or low == -math.inf else "["
    right = ")" if open_high or high == math.inf else "]"
    return f"{left}{low:g}, {high:g}{right}{f' {unit}' if unit else ''}"


def integer_in_range(name: str, value: int, low: int, high: float = math.inf) -> int:
    """Return `value` as an int in [low, high]."""
    try:
        valid = not isinstance(value, bool) and int(value) == value and low <= value <= high
    except (TypeError, ValueError, OverflowError):
        valid = False
    if not valid:
        condition = f"an integer in [{low}, {high:g}" + (")" if high == math.inf else "]")
        raise InputError(f"{name} must be {condition}, got {brief(value)}")
    return int(value)


def check_names(owner: str, names: Iterable[str], allowed: Mapping[str, str]) -> None:
    """Refuse arguments that a class does not have; `allowed` has units by name, empty for a pure number."""
    for name in names:
        if name not in allowed:
            permitted = ", ".join(f"{each} [{unit}]" if unit else each for each, unit in allowed.items())
            near = get_close_matches(name, allowed, 1, 0.0)
            remedy = f"; did you mean {near[0]}?" if near else ""
            raise InputError(f"arguments of {owner} must be among {permitted}, got {brief(name)[1:-1]}{remedy}")


def warn_of_unit(name: str, value: float, low: float, high: float, unit: str, remedy: str) -> None:
    """Warn, where the package is called from, of a value that only another unit explains."""
    if low <= value <= high:
        return
    message = f"{name} should be from {low:g} to {high:g} {unit}, got {value:.4g} {unit}; {remedy}"
    warnings.warn(message, UnitWarning, stacklevel=user_level())


def user_level() -> int:
    """Return the level in the stack of the line that calls palpate, for a warning of the caller of this function."""
    level, frame = 0, sys._getframe(0)
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == "palpate":
        level, frame = level + 1, frame.f_back
    return level


def check_arguments(function: Any, arguments: Iterable[str], name: str) -> None:
    """Check that a user's function takes some positional arguments."""
    arguments = list(arguments)
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of compiled functions
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        raise InputError(
            f"{name} must be a function of {' and '.join(arguments)}, got one with the arguments {signature}"
        ) from None


def brief(value: object) -> str:
    """Return the repr of a value on one line, truncated to 60 characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, or deeply nested lists
        text = f"a {type(value).__name__} too long to print"
    return text if len(text) <= 60 else text[:57] + "..."


def first_few(nodes: Any, count: int = 8) -> str:
    """Return the first few node numbers as text."""
    text = ", ".join(str(int(i)) for i in nodes[:count])
    return text + (f" and {len(nodes) - count} more" if len(nodes) > count else "")
