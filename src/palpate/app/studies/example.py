"""What sets an example of the paper apart: its case, models, quantities, claims and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.app.common.report import REPORTS
from palpate.app.common.rows import Rows
from palpate.app.studies.report import Claim
from palpate.app.studies.study import Study
from palpate.core.arrays import Floats
from palpate.dynamics.nodal.model import NodalModel
from palpate.scenes.load_case import LoadCase

Draw = Callable[[Sequence[Study], Path], None]  # draws a figure of an example's studies into a file


@dataclass(frozen=True)
class Example:
    """An example of the paper for `palpate.app.studies.reproduce.reproduce`."""

    name: str  # of the command, and of the file for ParaView
    case: Callable[..., LoadCase]  # of the options of the command
    snapshots: int  # of a phase, that move: the first shows the body at rest
    studies: Mapping[str, Callable[[LoadCase], Study]]  # by name in the report; runs of all but the first may diverge
    fields: Callable[[NodalModel, Floats], dict[str, Floats]]  # stresses and states (f, n) of displacements (f, n, d)
    doubles: int  # numbers that files of runs and the export hold for every node and time
    quantities: Callable[[Study, int], dict[str, Any]]  # of a full run, by the number of its phase, for the report
    rows: Rows  # the same for people
    claims: Sequence[Claim]
    figures: Mapping[str, Draw]  # by name of their files
    runs: Sequence[str] = ("full.h5",)  # files of the full runs
    # of two studies, the case of the second one, which a second process makes without the first one's body
    second_case: Callable[..., LoadCase] | None = None
    pictures: Sequence[str] = ()  # figures of the first full run alone

    @property
    def files(self) -> tuple[str, ...]:
        """Names of all files that the study leaves."""
        return (*REPORTS, *self.figures, *self.runs, f"{self.name}.vtkhdf")
