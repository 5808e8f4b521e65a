"""What lies in an organ of a label map: which labels join its body, which are left out, and by which rule.

A label lies in an organ if most of the voxels around it are the organ's. It joins the body if it is a lesion, a vessel
or a part of the organ by its name. A label whose name states nothing joins by its shares: the organ encloses it, and it
is neither tiny nor most of the organ. Another organ never joins, nor what the edge of the image cuts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Ints
from palpate.surface.labels.anatomy import Relation, relation
from palpate.surface.labels.label_map import Box, LabelMap, Segment, part_names, touches_edge
from palpate.surface.labels.mask_surface import is_pore

MIN_SHARE = 0.6  # of the voxels around a label, which belong to the organ in which it lies
# of a label whose name states nothing: the share around it, and its volume over the organ's
MIN_UNNAMED_SHARE, UNNAMED_VOLUMES = 0.9, (0.001, 0.5)
RULE_BY_RELATION = {
    Relation.LESION: "a lesion by its name",
    Relation.VESSEL: "a vessel or duct by its name",
    Relation.PART: "a part by its name",
    Relation.OTHER: "another organ by its name",
}


class InnerLabel(NamedTuple):
    """A label that lies in an organ."""

    segment: Segment
    part: str  # what chooses it
    volume: float  # [m^3]
    joins: bool  # whether it is of the organ's body
    why: str  # the rule by which it joins, or not
    place: str  # what its place is where it does not join


class Shell(NamedTuple):
    """The voxels around a segment: the values of each layer (layers, k) that occur there, and how often (k,)."""

    values: Ints
    counts: Ints


Shells = dict[Segment, Shell]  # of segments, kept between calls


def inner_labels(
    labels: LabelMap, chosen: Sequence[Segment], shells: Shells | None = None, left_out: Sequence[Segment] = ()
) -> list[InnerLabel]:
    """Return the labels that lie in the union of segments, in the order of the map.

    What lies in a label that joins lies in the organ, too. `chosen` are the segments of the organ. `left_out` are those
    that do not join by choice; what lies in them does not lie in the organ. `shells` is filled with the surroundings of
    segments, for the next call on the same map.
    """
    shells = {} if shells is None else shells
    body = list(chosen)
    while True:
        inside = [
            each._replace(joins=False, why="left out by choice") if each.joins and each.segment in left_out else each
            for each in _inside(labels, chosen, body, shells)
        ]
        joining = [each.segment for each in inside if each.joins and each.segment not in body]
        if not joining:
            return inside
        body += joining


def _inside(labels: LabelMap, chosen: Sequence[Segment], body: Sequence[Segment], shells: Shells) -> list[InnerLabel]:
    """Return the labels that lie in a body, which is an organ and what has joined it so far."""
    boxes = dict(zip(labels.segments, labels.boxes, strict=True))
    volume = sum(each.count for each in chosen)
    inside = []
    for segment, part in zip(labels.segments, part_names(labels), strict=True):
        if segment in chosen or not any(_meet(boxes[segment], boxes[each]) for each in body):
            continue
        if segment not in shells:
            shells[segment] = _shell(labels, segment, boxes[segment])
        others = [each for each in body if each != segment]
        share = _share(shells[segment], others)
        if share < MIN_SHARE:
            continue
        at_edge = touches_edge(boxes[segment], labels.shape)
        joins, why = _decision(segment, chosen, at_edge, share, segment.count / volume)
        cavity = labels.layers[segment.layer][boxes[segment]] == segment.value
        is_filled = not at_edge and share == 1.0 and is_pore(cavity, volume)
        place = "filled with the organ's tissue" if is_filled else "left empty"
        if _covered(labels, segment, boxes[segment], others):
            if not joins:
                continue
            place = "of the organ in another layer"
        inside.append(InnerLabel(segment, part, segment.count * labels.voxel_volume, joins, why, place))
    return inside


def _decision(
    segment: Segment, chosen: Sequence[Segment], at_edge: bool, share: float, volume_share: float
) -> tuple[bool, str]:
    """Return whether a segment joins an organ, and the rule."""
    if at_edge:
        return False, "cut by the edge of the image"
    relations = {relation(segment.name, each.name) for each in chosen}
    kind = next(each for each in Relation if each in relations)  # another organ is the last
    if kind is not Relation.UNKNOWN:
        return kind is not Relation.OTHER, RULE_BY_RELATION[kind]
    least, most = UNNAMED_VOLUMES
    joins = share >= MIN_UNNAMED_SHARE and least <= volume_share <= most
    return joins, f"by its shares: {_percent(share)} of what is around it, {_percent(volume_share)} of the volume"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %" if share > 0.1 else f"{100 * share:.2g} %"


def _share(shell: Shell, segments: Sequence[Segment]) -> float:
    """Return the share of a shell that is of segments."""
    inside = np.zeros(len(shell.counts), dtype=bool)
    for each in segments:
        inside |= shell.values[each.layer] == each.value
    return float(shell.counts[inside].sum() / max(shell.counts.sum(), 1))


def _shell(labels: LabelMap, segment: Segment, box: Box) -> Shell:
    """Return the surroundings of a segment, across faces of its voxels."""
    grown = tuple(slice(max(0, each.start - 1), each.stop + 1) for each in box)
    voxels = labels.layers[segment.layer][grown] == segment.value
    around = voxels.copy(order="K")
    for axis in range(3):
        target, source = np.moveaxis(around, axis, 0), np.moveaxis(voxels, axis, 0)
        target[1:] |= source[:-1]
        target[:-1] |= source[1:]
    around &= ~voxels
    at = np.nonzero(around)
    values = np.stack([layer[grown][at].astype(np.int64) for layer in labels.layers])
    return Shell(*np.unique(values, axis=1, return_counts=True))


def _covered(labels: LabelMap, segment: Segment, box: Box, others: Sequence[Segment]) -> bool:
    """Return True if others, in other layers, have all voxels of a segment."""
    left: NDArray[np.bool_] = labels.layers[segment.layer][box] == segment.value
    for each in others:
        if each.layer != segment.layer:
            left = left & (labels.layers[each.layer][box] != each.value)
    return not left.any()


def _meet(one: Box, other: Box) -> bool:
    """Return True if boxes have a common voxel, or touch."""
    return all(a.start <= b.stop and b.start <= a.stop for a, b in zip(one, other, strict=True))
