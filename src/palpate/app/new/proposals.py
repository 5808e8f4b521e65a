"""Regions and supports that a label map proposes for an organ: what lies in it, and what touches it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.core.arrays import Floats
from palpate.scenes.description import Near, Place, Plane, Region, Support
from palpate.scenes.label_parts import inner_labels_of, inner_region, is_large
from palpate.surface.labels.anatomy import Tissue, tissue_of
from palpate.surface.labels.label_map import LabelMap, part_names, segments_mask
from palpate.surface.labels.neighbours import contact_distance, cut_faces, touching_segments

HOLDING_WORDS = ("atrium", "ligament", "trachea", "oesophagus", "esophagus")  # of names that hold like vessels
MIN_CONTACT_SHARE = 0.01  # of the surface, from which a neighbour is proposed
MIN_HELD_SHARE = 0.1  # of the surface; less is held by bones and vessels alone if the rear is held, too


@dataclass(frozen=True)
class Proposals:
    """Sections for the scene of an organ, and the reason for each."""

    title: str  # names of the parts that were chosen
    parts: tuple[str, ...]  # parts of the label map that are the body: those, and what lies in them
    # regions, supports: sections and the reasons for them
    regions: tuple[tuple[Region, str], ...]
    supports: tuple[tuple[Support, str], ...]
    alternatives: tuple[tuple[Support, str], ...]  # supports that are not proposed, but can be chosen


def propose(
    labels: LabelMap, file: Path, part: Sequence[str] | None, spacing: float, without: Sequence[str] = ()
) -> Proposals:
    """Return what a label map proposes for the scene of an organ, whose nodes have a spacing [m].

    `part` are parts of the map that the user has chosen; `without` are labels that lie in the organ and do not join it.
    """
    chosen, inner = inner_labels_of(labels, part, without)
    names = dict(zip(labels.segments, part_names(labels), strict=True))
    joining = [each for each in inner if each.joins]
    body = (*chosen, *(each.segment for each in joining))
    mask = segments_mask(labels, body)
    fixed, soft, held = [], [], 0.0
    for segment, share in touching_segments(labels, mask, contact_distance(labels.voxel_edges, spacing), body):
        if share < MIN_CONTACT_SHARE:
            continue
        near = Place(near=Near(file=str(file), parts=(names[segment],)))
        why = f"touches {share:.1%} of the surface"
        tissue = tissue_of(segment.name)
        holds = tissue is Tissue.VESSEL or any(word in segment.name.lower() for word in HOLDING_WORDS)
        kind = "bone" if tissue is Tissue.BONE else "vessel" if holds else ""
        if kind:
            fixed.append((Support(name=segment.name, place=near, surface_only=True), f"a {kind} that {why}"))
            held += share
        else:
            springs = Support(name=segment.name, kind="springs", place=near, surface_only=True, stiffness=1e6)
            soft.append((springs, f"a soft neighbour that {why}"))
    for number, face in enumerate(cut_faces(mask), 1):
        if face.share >= MIN_CONTACT_SHARE:
            plane = Plane(point=_rounded(face.point, 4), normal=_rounded(face.normal, 3))
            cut = Support(name=f"cut {number}", place=Place(plane=plane), surface_only=True)
            soft.append((cut, f"the image cuts the organ here, on {face.share:.1%} of the surface"))
    if held < MIN_HELD_SHARE and labels.space:
        rear = Support(name="rear", place=Place(side="rear"))
        why = f"guessed: bones and vessels hold {held:.1%} of the surface, and the patient lies on the back"
        fixed.append((rear, why))
    parts = tuple(part or [names[each] for each in chosen])
    return Proposals(
        ", ".join(each.name for each in chosen).replace("_", " ").capitalize(),
        (*parts, *(each.part for each in joining)),
        tuple(inner_region(each, chosen) for each in joining if is_large(labels, each.segment, spacing)),
        tuple(fixed), tuple(soft),
    )  # fmt: skip


def _rounded(values: Floats, digits: int) -> tuple[float, ...]:
    return tuple(round(float(value), digits) + 0.0 for value in values)
