"""What lies in an organ of a label map is of its body, and never a hole: further parts, and a region for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palpate.scenes.description import Place, Region
from palpate.surface.labels.label_map import LabelMap, Segment, choose_segments, part_names, segments_mask
from palpate.surface.labels.neighbours import enclosed_segments
from palpate.surface.labels.reading import read_label_map

LESION_WORDS = ("tumour", "tumor", "lesion", "mass", "neoplasm", "cancer", "carcinoma", "metasta", "nodule")
# stiffness of a malignant lesion over that of its organ, with the source
LESION_FACTORS = (
    ("liver", 4.4, "malignant tumours 10.1 kPa, healthy liver 2.3 kPa: Venkatesh et al., AJR 190, 2008; benign: 1.2"),
    ("prostate", 2.1, "cancer over normal tissue: Zhang et al., Cancer Biomarkers 4, 2008"),
)
OTHER_FACTOR = 3.0  # of a lesion in another organ
MIN_REGION_CELLS = 4.0  # volume of a region over spacing^3: less can lie between the nodes
USUAL_SPACING = 0.012  # [m], where none is given


def body_segments_of(labels: LabelMap, part: Sequence[str] | None) -> tuple[tuple[Segment, ...], tuple[Segment, ...]]:
    """Return the segments that were chosen, and those that lie in them."""
    chosen = choose_segments(labels, part or None)
    return chosen, tuple(enclosed_segments(labels, segments_mask(labels, chosen)))


def enclosed_region(labels: LabelMap, segment: Segment, organ: Sequence[Segment]) -> tuple[Region, str]:
    """Return the region of a segment in an organ, with the stiffness of a lesion if it is one, and the reason."""
    name = part_names(labels)[labels.segments.index(segment)]
    if not any(word in segment.name.lower() for word in LESION_WORDS):
        return Region(name=segment.name, place=Place(part=name)), "lies in the organ, of the same tissue"
    factor, source = OTHER_FACTOR, "an example: set yours"
    for word, ratio, text in LESION_FACTORS:
        if any(word in each.name.lower() for each in organ):
            factor, source = ratio, text
    return Region(name=segment.name, place=Place(part=name), stiffness=factor), f"lies in the organ; {source}"


def is_large(labels: LabelMap, segment: Segment, spacing: float | None) -> bool:
    """Return True for a segment that surely holds a node of a body with a spacing [m]."""
    return segment.count * labels.voxel_volume >= MIN_REGION_CELLS * (spacing or USUAL_SPACING) ** 3


def whole_body(
    file: Path, names: Path | None, part: Sequence[str], scale: float, spacing: float | None
) -> tuple[tuple[str, ...], tuple[Region, ...], list[str]]:
    """Return the parts of a label map that are a body, regions of the lesions in it, and notes about what was added.

    Where no part was chosen of several, there is none: `palpate.surface.files.read_surface` then lists them.
    """
    labels = read_label_map(file, names).scaled(scale)
    if not part and len(labels.segments) > 1:
        return tuple(part), (), []
    chosen, enclosed = body_segments_of(labels, part)
    known, regions, notes = part_names(labels), list[Region](), list[str]()
    for segment in enclosed:
        region, why = enclosed_region(labels, segment, chosen)
        note = f"{segment.name} {why}"
        if region.stiffness != 1.0 and is_large(labels, segment, spacing):
            regions.append(region)
            note = f"{segment.name}, {region.stiffness:g} times as stiff, {why}"
        elif region.stiffness != 1.0:
            note = f"{segment.name} lies in the organ; too small for a stiffness of its own at this spacing"
        notes.append(note)
    parts = (*part, *(known[labels.segments.index(each)] for each in enclosed))
    return (parts if enclosed else tuple(part)), tuple(regions), notes
