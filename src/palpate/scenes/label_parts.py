"""The body of an organ in a label map: its labels and those that join them, and a region for each lesion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palpate.core.faults import InputError
from palpate.core.files import shortened
from palpate.scenes.description import Place, Region
from palpate.surface.labels.anatomy import is_stiff_lesion, organs_of
from palpate.surface.labels.inner import InnerLabel, Shells, inner_labels
from palpate.surface.labels.label_map import LabelMap, Segment, choose_segments
from palpate.surface.labels.listing import MAX_NAME, choice_of_labels, inner_lines, inner_text
from palpate.surface.labels.mask_surface import is_piece
from palpate.surface.labels.reading import read_label_map
from palpate.surface.parts import names_text

# stiffness of a malignant lesion over that of its organ, with the source
LESION_FACTORS = (
    ("liver", 4.4, "malignant tumours 10.1 kPa, healthy liver 2.3 kPa: Venkatesh et al., AJR 190, 2008; benign: 1.2"),
    ("prostate", 2.1, "cancer over normal tissue: Zhang et al., Cancer Biomarkers 4, 2008"),
)
OTHER_FACTOR = 3.0  # of a lesion in another organ
MIN_REGION_CELLS = 4.0  # volume of a region over spacing^3: less can lie between the nodes
USUAL_SPACING = 0.012  # [m], where none is given


def inner_labels_of(
    labels: LabelMap, part: Sequence[str] | None, without: Sequence[str] = ()
) -> tuple[tuple[Segment, ...], list[InnerLabel]]:
    """Return the segments that were chosen, and what lies in them.

    `without` has names, numbers or patterns of labels that do not join.
    """
    chosen = choose_segments(labels, part or None)
    shells, left_out = Shells(), list[Segment]()
    inner = inner_labels(labels, chosen, shells)
    joining = [each for each in inner if each.joins]
    for text in without:
        try:
            matches = choose_segments(labels, text)
        except InputError:
            matches = ()
        if not any(each.segment in matches for each in joining):
            known = names_text([each.part for each in joining])
            condition = f"one of {known}" if joining else "left out, since nothing joins the organ"
            raise InputError(f"without must be {condition}, got {text!r:.60}")
        left_out += matches
    return chosen, inner_labels(labels, chosen, shells, left_out) if left_out else inner


def inner_region(inner: InnerLabel, organ: Sequence[Segment]) -> tuple[Region, str]:
    """Return the region of a label that joins an organ, with the stiffness of a lesion if it is one, and the reason."""
    region = Region(name=inner.segment.name, place=Place(part=inner.part))
    if not is_stiff_lesion(inner.segment.name):
        return region, f"lies in the organ, {inner.why}; of the same tissue"
    factor, source = OTHER_FACTOR, "an example: set yours"
    for word, ratio, text in LESION_FACTORS:
        if any(word in organs_of(each.name) for each in organ):
            factor, source = ratio, text
    return Region(name=region.name, place=region.place, stiffness=factor), f"lies in the organ, {inner.why}; {source}"


def is_large(labels: LabelMap, segment: Segment, spacing: float | None) -> bool:
    """Return True for a segment that surely holds a node of a body with a spacing [m]."""
    return segment.count * labels.voxel_volume >= MIN_REGION_CELLS * (spacing or USUAL_SPACING) ** 3


def resolve_labels(
    file: Path, names: Path | None, part: Sequence[str], without: Sequence[str], scale: float, spacing: float | None
) -> tuple[tuple[str, ...], tuple[Region, ...], list[str], str]:
    """Return the parts of a label map that are a body, regions of the lesions in it, and what lies in it.

    The latter is in notes, and in a line of names. A piece of a label is a body alone: nothing joins it. If the map has
    several labels and no part was chosen, this raises `ChoiceError`.
    """
    labels = read_label_map(file, names).scaled(scale)
    if not part and len(labels.segments) > 1:
        raise choice_of_labels(labels, joining=True)
    if any(is_piece(labels, text) for text in part):
        if without:
            raise InputError(f"without must be left out with a piece of a label, got {without[0]!r:.60}")
        return tuple(part), (), [], ""
    chosen, inner = inner_labels_of(labels, part, without)
    regions, notes = list[Region](), list[str]()
    for each in inner:
        region, why = inner_region(each, chosen)
        is_stiff = each.joins and region.stiffness != 1.0
        if is_stiff and is_large(labels, each.segment, spacing):
            regions.append(region)
        notes.append(inner_note(each, region.stiffness if is_stiff else 1.0, region in regions, why))
    parts = (*part, *(each.part for each in inner if each.joins))
    return parts, tuple(regions), notes, "; ".join(inner_lines(inner, with_rules=False))


def inner_note(inner: InnerLabel, stiffness: float, has_region: bool, why: str) -> str:
    """Return a line about a label that lies in an organ, with the option that changes what is made of it."""
    name = shortened(inner.segment.name, MAX_NAME)
    if not inner.joins:
        return f"without {name} ({inner_text(inner)}), whose place is {inner.place}; add it with part={inner.part!r}"
    remedy = f"leave it out with without={inner.part!r}"
    if has_region:
        return f"with {name}, {stiffness:g} times as stiff ({1e6 * inner.volume:.3g} ml), which {why}; {remedy}"
    if stiffness != 1.0:
        small = "lies in the organ; too small for a stiffness of its own at this spacing"
        return f"{name} {small} ({inner_text(inner)}); {remedy}"
    return f"with {name} ({inner_text(inner)}), of the same tissue; {remedy}"
