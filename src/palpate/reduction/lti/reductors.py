"""Linear reductions of a body by projection; those of pyMOR come by `palpate.lti.to_pymor` and `from_pymor`."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

from palpate.core.faults import InputError, integer_in_range
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.projection_methods import condense, modal, moments
from palpate.reduction.lti.system import LinearSystem

PROJECTION_METHODS = ("modal", "moments", "condensed")


def reduce_linear(
    system: LinearSystem, method: str, modes: int, *, points: Sequence[complex] | None = None
) -> LinearModel:
    """Reduce a linearised body by projection.

    Balanced truncation, rational Krylov methods and others are those of pyMOR: reduce the model of
    `to_pymor`, and convert the result by `from_pymor` (docs/howto/linear.md).

    Parameters
    ----------
    system : LinearSystem
        Linearised at rest.
    method : str
        ``"modal"`` is the slowest modes. ``"moments"`` is a Krylov space that matches moments of the
        transfer function. ``"condensed"`` is the slowest modes and the static responses to all
        inputs: a dense replacement of a large body, for methods of pyMOR.
    modes : int
        Number of displacement coordinates; without those of the static responses.
    points : sequence of complex, optional [1/s]
        Frequencies s of ``"moments"``; by default 0, which gives exact static responses.

    Returns
    -------
    LinearModel

    Raises
    ------
    InputError
        An unknown method, a number of modes out of range, a singular stiffness, or a system that is
        not at rest.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> model = pt.lti.reduce_linear(system, "modal", 6)
    >>> model.count, model.stable
    (6, True)
    """
    if method not in PROJECTION_METHODS:
        raise InputError(
            f"method must be one of {', '.join(map(repr, PROJECTION_METHODS))}, got {method!r}; "
            "for another method reduce pt.lti.to_pymor(model) by a reductor of pyMOR, and convert the result by "
            "pt.lti.from_pymor(rom, model, reductor), with model = pt.lti.reduce_linear(system, 'condensed', 240)"
        )
    if points is not None and method != "moments":
        raise InputError(f"points must be None for method {method!r}, got {points!r}; leave them out")
    integer_in_range("modes", modes, 1, system.order - 1)
    start = perf_counter()
    if method == "moments":
        reduced = moments(system, modes, (0.0,) if points is None else points)
    else:
        reduced = (modal if method == "modal" else condense)(system, modes)
    report = {
        "method": method, "modes": len(reduced.fields), "states": reduced.states,
        "seconds": perf_counter() - start, "unknowns": system.order,
    }  # fmt: skip
    return LinearModel(system, reduced, report)
