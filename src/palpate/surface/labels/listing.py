"""Lists of the labels of a map, from which one chooses: likely organs first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

from palpate.core.faults import ChoiceError
from palpate.core.files import shortened
from palpate.surface.labels.inner import InnerLabel, Shells, inner_labels
from palpate.surface.labels.label_map import LabelMap, part_names, segments_mask
from palpate.surface.labels.mask_surface import MIN_VOXELS, piece_sizes

# words in the names of organs that are palpated, the likeliest first
ORGAN_WORDS = (
    "liver", "spleen", "kidney", "stomach", "pancreas", "prostate", "breast", "uterus", "bladder", "heart", "lung",
    "brain", "colon", "bowel", "gallbladder", "thyroid",
)  # fmt: skip
MAX_ROWS = 200
MAX_NAME = 40  # characters
MAX_INNER = 6  # labels of a line that lie in another


@dataclass(frozen=True)
class LabelRow:
    """Label of a map in a list: what chooses it, its volume [m^3], its pieces, and whether the image may cut it.

    `inner` has the labels that lie in it.
    """

    number: int
    name: str
    part: str
    volume: float
    pieces: int
    at_edge: bool
    inner: tuple[InnerLabel, ...] = ()


def label_rows(labels: LabelMap) -> list[LabelRow]:
    """Return the labels of a map, likely organs first, then by volume."""
    rows, shells = [], Shells()
    for segment, part in zip(labels.segments, part_names(labels), strict=True):
        mask = segments_mask(labels, [segment])
        inner = tuple(inner_labels(labels, [segment], shells))
        row = LabelRow(segment.number, segment.name, part, mask.volume, len(piece_sizes(mask)), mask.at_edge, inner)
        rows.append((_rank(segment.name), segment.count < MIN_VOXELS, -row.volume, row))
    return [row for *_, row in sorted(rows, key=lambda each: each[:3])]


def _rank(name: str) -> int:
    """Return the place of a name in the list of organs."""
    words = name.lower()
    return next((k for k, organ in enumerate(ORGAN_WORDS) if organ in words), len(ORGAN_WORDS))


def inner_lines(inner: Sequence[InnerLabel], with_rules: bool = True) -> list[str]:
    """Return a line for the labels that join the body of an organ in which they lie, and one for those left out."""
    lines = []
    for joins, words in ((True, "with"), (False, "without")):
        listed = [each for each in inner if each.joins == joins]
        names = [shortened(each.segment.name, MAX_NAME) for each in listed[:MAX_INNER]]
        if with_rules:
            names = [f"{name} ({inner_text(each)})" for name, each in zip(names, listed, strict=False)]
        if names:
            lines.append(f"{words} {', '.join(names)}" + ", ..." * (len(listed) > MAX_INNER))
    return lines


def inner_text(inner: InnerLabel) -> str:
    """Return the volume of a label that lies in an organ, and the rule by which it joins, or not."""
    millilitres = 1e6 * inner.volume
    return f"{millilitres:{'.2g' if millilitres < 100 else '.0f'}} ml, {inner.why}"


def choice_of_labels(labels: LabelMap, joining: bool = False) -> ChoiceError:
    """Return the error of a map of several labels of which none was chosen, with a table of them.

    With `joining`, what lies in a label can join its body, which the table then states.
    """
    rows = label_rows(labels)
    width = max(8, *(len(shortened(row.name, MAX_NAME)) for row in rows[:MAX_ROWS]))
    lines = [f"{'number':>6}  {'name':<{width}}  {'ml':>8}  pieces  at the edge of the image"]
    for row in rows[:MAX_ROWS]:
        cells = [f"{row.number:>6}", f"{shortened(row.name, MAX_NAME):<{width}}", f"{1e6 * row.volume:>8.1f}"]
        lines.append("  ".join([*cells, f"{row.pieces:>6}", "yes" if row.at_edge else ""]).rstrip())
        lines += [f"        {line}" for line in (inner_lines(row.inner) if joining else ())]
    if len(rows) > MAX_ROWS:
        lines.append(f"and {len(rows) - MAX_ROWS} more")
    if joining and any(row.inner for row in rows):
        lines.append(
            "with: lies in the organ and joins its body, unless --without NAME; without: add it by --part NAME"
        )
    return ChoiceError(
        f"part must be given for {PurePath(labels.name).name}, a label map of {len(rows)} labels, got none; give one "
        f"or several, such as part={rows[0].part!r}",
        "\n".join(lines), {"part": rows[0].part},
    )  # fmt: skip
