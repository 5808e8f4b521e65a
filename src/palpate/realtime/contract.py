"""What a model gives to be stepped in real time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.faults import InputError

__all__ = ["FORCES", "KINETIC", "STATUS", "STEPS", "STRAIN", "TRUST", "Realtime", "check_contract"]

# where a report holds what
STATUS, TRUST, STEPS, KINETIC, STRAIN, FORCES = 0, 1, 2, 3, 4, 8


class Realtime(NamedTuple):
    """A body of m coordinates, held by a tool of l coordinates, in compiled functions.

    A model need not use this class, only its names. The functions are compiled by Numba, without ``parallel=True``.

    Parameters
    ----------
    advance : function
        ``advance(data, q, v, target, period, report)`` moves the coordinates `q` (m,) and velocities `v` (m,) on by
        `period` [s] in place, while the tool's coordinates go linearly from where they are to `target` (l,). It writes
        `report` (8 + l,): [0] 0, or 1 if it did not converge or is not finite; [1] the trust number, which is above 1
        where the model was not trained; [2] steps or iterations taken; [3] kinetic and [4] strain energy [J]; from [8]
        on the generalised forces of the tool on the body, conjugate to the tool's coordinates.
    stiffness : function or None
        ``stiffness(data, q, out)`` writes the derivatives (l, l) of those forces by the tool's coordinates.
    data : any type that Numba takes
    rest : (m,) array
        Coordinates at rest, the tool's coordinates 0.
    tool : (l, 12) array
        The tool's coordinates are ``tool @ concatenate([d, (R - I).ravel()])``; d [m] is the displacement of the
        tool's reference point, R the rotation about it.
    """

    advance: Callable[..., Any]
    stiffness: Callable[..., Any] | None
    data: Any
    rest: NDArray[np.float64]
    tool: NDArray[np.float64]


def check_contract(model: Any) -> Realtime:
    """Return a model's functions and arrays, the arrays copied as Numba needs them.

    Raises
    ------
    InputError
        A name is missing, a function is not compiled, or an array is not finite or has another shape.
    """
    missing = [name for name in Realtime._fields if not hasattr(model, name)]
    if missing:
        raise InputError(f"a real-time model needs {', '.join(missing)}: see palpate.realtime.Realtime")
    for name in ("advance", "stiffness"):
        function = getattr(model, name)
        if not hasattr(function, "py_func") and not (name == "stiffness" and function is None):
            raise InputError(f"{name} = {function!r}: allowed is a function compiled by numba.njit")
        if getattr(function, "targetoptions", {}).get("parallel"):
            raise InputError(f"{name} is compiled with parallel=True: allowed is a function of one thread")
    rest, tool = (np.array(array, dtype=float, order="C") for array in (model.rest, model.tool))
    if rest.ndim != 1 or not len(rest) or not np.isfinite(rest).all():
        raise InputError(f"rest has shape {rest.shape}: allowed is (m,), m > 0, all finite")
    if tool.ndim != 2 or not len(tool) or tool.shape[1] != 12 or not np.isfinite(tool).all():
        raise InputError(f"tool has shape {tool.shape}: allowed is (l, 12), l > 0, all finite")
    return Realtime(model.advance, model.stiffness, model.data, rest, tool)
