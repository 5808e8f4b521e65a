"""Lists of the labels of a map, from which one chooses: likely organs first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

from palpate.faults import ChoiceError
from palpate.files import shortened
from palpate.surface.labels.label_map import LabelMap, part_names, segments_mask
from palpate.surface.labels.mask_surface import MIN_VOXELS, piece_sizes

# words in the names of organs that are palpated, the likeliest first
ORGAN_WORDS = (
    "liver", "spleen", "kidney", "stomach", "pancreas", "prostate", "breast", "uterus", "bladder", "heart", "lung",
    "brain", "colon", "bowel", "gallbladder", "thyroid",
)  # fmt: skip
MAX_ROWS = 200
MAX_NAME = 40  # characters


@dataclass(frozen=True)
class LabelRow:
    """Label of a map in a list: what chooses it, its volume [m^3], its pieces, and whether the image may cut it."""

    number: int
    name: str
    part: str
    volume: float
    pieces: int
    at_edge: bool


def label_rows(labels: LabelMap) -> list[LabelRow]:
    """Return the labels of a map, likely organs first, then by volume."""
    rows = []
    for segment, part in zip(labels.segments, part_names(labels), strict=True):
        mask = segments_mask(labels, [segment])
        row = LabelRow(segment.number, segment.name, part, mask.volume, len(piece_sizes(mask)), mask.at_edge)
        rows.append((_rank(segment.name), segment.count < MIN_VOXELS, -row.volume, row))
    return [row for *_, row in sorted(rows, key=lambda each: each[:3])]


def _rank(name: str) -> int:
    """Return the place of a name in the list of organs."""
    words = name.lower()
    return next((k for k, organ in enumerate(ORGAN_WORDS) if organ in words), len(ORGAN_WORDS))


def choice_of_labels(labels: LabelMap) -> ChoiceError:
    """Return the error of a map of several labels of which none was chosen, with a table of them."""
    rows = label_rows(labels)
    width = max(8, *(len(shortened(row.name, MAX_NAME)) for row in rows[:MAX_ROWS]))
    lines = [f"{'number':>6}  {'name':<{width}}  {'ml':>8}  pieces  at the edge of the image"]
    for row in rows[:MAX_ROWS]:
        cells = [f"{row.number:>6}", f"{shortened(row.name, MAX_NAME):<{width}}", f"{1e6 * row.volume:>8.1f}"]
        lines.append("  ".join([*cells, f"{row.pieces:>6}", "yes" if row.at_edge else ""]).rstrip())
    if len(rows) > MAX_ROWS:
        lines.append(f"and {len(rows) - MAX_ROWS} more")
    return ChoiceError(
        f"part must be given for {PurePath(labels.name).name}, a label map of {len(rows)} labels, got none; give one "
        f"or several, such as part={rows[0].part!r}",
        "\n".join(lines), {"part": rows[0].part},
    )  # fmt: skip
