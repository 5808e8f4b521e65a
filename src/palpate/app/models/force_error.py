"""Errors of a full body's force against finite elements, by its number of nodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class ForceStudy(NamedTuple):
    """Errors of a ball's force on bodies of about the same number of nodes, pressed by half of its radius or deeper."""

    fewest: int  # nodes
    most: int
    radius: float  # of the ball, over the spacing
    median: float
    largest: float


# on five organs, the same balls in all (validation/elements.py)
FORCE_STUDIES = ForceStudy(1582, 1799, 1.2, 0.0593, 0.162), ForceStudy(2962, 3224, 1.5, 0.0315, 0.0981)


def force_error_text(nodes: int) -> str:
    """Return what is known of the error of the force on a body of a number of nodes.

    Between the studies it is interpolated over the logarithm of the nodes; beyond them it is not known.
    """
    few, many = FORCE_STUDIES
    study = next((each for each in FORCE_STUDIES if each.fewest <= nodes <= each.most), None)
    if study is not None:
        bodies = f"five organs of {_range(study)} nodes, with balls of {study.radius:g} spacings in radius"
        return f"{_errors(study.median, study.largest)}, measured on {bodies}"
    errors = _errors_between(nodes)
    if errors is not None:
        return f"about {_errors(*errors)}, between those of five organs of {_range(few)} and {_range(many)} nodes"
    nearest, word = (few, "fewest") if nodes < few.fewest else (many, "most")
    text = _errors(nearest.median, nearest.largest)
    return f"not known for {nodes:,} nodes: {text} on five organs of {_range(nearest)} nodes, the {word} measured"


def nodes_error(model: Any) -> float | None:
    """Return the typical error of a reduced model's tool force by the number of its nodes, relative; None if unknown.

    It is the median of `FORCE_STUDIES`, which are of balls on organs. So it is not known of a held group, or of a
    number of nodes that was not studied.
    """
    from palpate.reduction.hyper.model import ReducedModel

    if not isinstance(model, ReducedModel) or model.data.compliance is None:
        return None
    errors = _errors_between(len(model.cloud))
    return None if errors is None else errors[0]


def _errors_between(nodes: int) -> tuple[float, float] | None:
    """Return the median and the largest error at a number of nodes; None beyond the studies."""
    few, many = FORCE_STUDIES
    if not few.fewest <= nodes <= many.most:
        return None
    share = float(np.clip(np.log(nodes / few.most) / np.log(many.fewest / few.most), 0.0, 1.0))
    return few.median + share * (many.median - few.median), few.largest + share * (many.largest - few.largest)


def _range(study: ForceStudy) -> str:
    return f"{study.fewest:,} to {study.most:,}"


def _errors(median: float, largest: float) -> str:
    return f"{100 * median:.0f} % in the median and {100 * largest:.0f} % at most"
