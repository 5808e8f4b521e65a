"""The interface between a real-time model and the engine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import InputError
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS, STEPS, STRAIN, TRUST

__all__ = ["FORCES", "KINETIC", "STATUS", "STEPS", "STRAIN", "TRUST", "Realtime", "check_contract"]

POSE_COLUMNS = 12  # of `tool`: displacement (3,) and R - I (9,)
MAX_TOOLS = 4  # of a model


class Realtime(NamedTuple):
    """A body of m coordinates and up to four tools of l coordinates each, as compiled functions.

    A model need not be of this class: it needs these attributes. The functions are compiled by Numba, without
    ``parallel=True``, and take `data` first.

    ``advance(data, q, v, target, period, report)`` advances the coordinates `q` (m,) and velocities `v` (m,) in place
    by `period` [s], while the tools' coordinates move linearly to `target` (t l,), tool by tool. A model whose tool
    does not get there writes where it is into `target`. It writes `report` (8 + t l,). Element 0 is 0, or 1 if the step
    did not converge or is not finite. Element 1 is the error indicator, above 1 where the model was not trained.
    Element 2 counts steps or iterations. Elements 3 and 4 are the kinetic and the strain energy [J]. From element 8 on
    are the generalised forces of the tools on the body, conjugate to their coordinates.

    ``stiffness(data, q, out)`` writes the derivatives (t l, l) of the forces of each tool by its coordinates; it may be
    None.

    `rest` (m,) are the coordinates at rest, where the tools' coordinates are 0. A tool's coordinates are ``tool @
    concatenate([d, (R - I).ravel()])``, where d [m] is the displacement of the tool's reference point and R the
    rotation about it. `tool` is (l, 12), or (t, l, 12) of t tools.
    """

    advance: Callable[..., Any]
    stiffness: Callable[..., Any] | None
    data: Any
    rest: NDArray[np.float64]
    tool: NDArray[np.float64]


def check_contract(model: Any) -> Realtime:
    """Return a model's functions and contiguous copies of its arrays; `tool` is (t, l, 12)."""
    missing = [name for name in Realtime._fields if not hasattr(model, name)]
    if missing:
        raise InputError(
            f"model must have the attributes of palpate.realtime.contract.Realtime, got {type(model).__name__} without "
            f"{', '.join(missing)}; add them, or pass what palpate.realtime_model returns"
        )
    for name in ("advance", "stiffness"):
        function = getattr(model, name)
        if not hasattr(function, "py_func") and not (name == "stiffness" and function is None):
            raise InputError(
                f"{name} must be a function compiled by numba.njit, got {function!r}; decorate it with njit"
            )
        if getattr(function, "targetoptions", {}).get("parallel"):
            raise InputError(f"{name} must be single-threaded, got parallel=True; compile it without that option")
    rest, tool = (np.array(array, dtype=float, order="C") for array in (model.rest, model.tool))
    if rest.ndim != 1 or not len(rest) or not np.isfinite(rest).all():
        raise InputError(f"rest must be finite with shape (m,), m > 0, got {_describe(rest)}; check the model")
    if tool.ndim not in (2, 3) or not tool.size or tool.shape[-1] != POSE_COLUMNS or not np.isfinite(tool).all():
        raise InputError(
            f"tool must be finite with shape (l, 12) or (t, l, 12), l > 0, got {_describe(tool)}; check the model"
        )
    tool = tool_maps(tool)
    if len(tool) > MAX_TOOLS:
        raise InputError(f"tool must be of at most {MAX_TOOLS} tools, got {len(tool)}; leave out some")
    return Realtime(model.advance, model.stiffness, model.data, rest, tool)


def tool_maps(tool: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the maps (t, l, 12) of tools; one tool may have given its own (l, 12)."""
    return tool if tool.ndim == 3 else tool[None]


def _describe(array: NDArray[np.float64]) -> str:
    return f"shape {array.shape}" if np.isfinite(array).all() else f"shape {array.shape} with non-finite numbers"
