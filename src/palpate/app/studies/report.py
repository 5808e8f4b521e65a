"""Reports of the examples: quantities of the full runs, entries of the reduced ones, and the paper's claims."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palpate.app.common.console import Table, percent
from palpate.app.common.report import machine
from palpate.app.common.rows import Rows, quantities
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study
from palpate.core.files import plain
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.training.errors import relative_errors

SERIES_TITLES = {PROJECTED: "Projected models (the paper's)", HYPER_REDUCED: "Hyper-reduced models"}
CLAIM_KEYS = {PROJECTED: "paper", HYPER_REDUCED: "paper_hyper_reduced"}
COLUMNS = ("modes", "nodes", "displ.", "velocity", "energy", "force", "proj.", "s", "ratio", "steps", "us/step")
COST_ROWS: Rows = {
    "computing time": "{wall_seconds:.2f s}",
    "simulated time over computing time": "{real_time_factor:.3g}",
    "time steps": "{steps}",
}
BACK_AT_REST = 0.9  # share of the run after which the load is small and the body swings about rest
MIN_GROWTH = 1.5  # of the difference of the two forms after that, which is then one of phase


@dataclass(frozen=True)
class Finished:
    """Results of the reduced runs that were finished, by number of modes, ascending."""

    errors: dict[int, float]  # of the displacement, (34)
    ratios: dict[int, float]  # computing time over the full model's
    seconds: dict[int, float]  # computing time [s]

    def time_per_mode(self) -> tuple[float, float]:
        """Return the slope [s] of a straight line through the times over the modes, and how well it fits, R^2."""
        sizes, seconds = np.array(list(self.seconds), dtype=float), np.array(list(self.seconds.values()))
        line = np.polynomial.Polynomial.fit(sizes, seconds, 1)
        spread = np.sum((seconds - seconds.mean()) ** 2)
        fit = float(1 - np.sum((seconds - line(sizes)) ** 2) / spread) if spread > 0 else 1.0
        return float(line.convert().coef[-1]), fit


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, to which the reduced models of each series are held."""

    figure: str
    text: str  # the claim, and how its words are read where it has no numbers
    judge: Callable[[Finished], tuple[str, bool]]  # returns the result here, and whether the claim holds
    modes: tuple[int, ...] = ()  # numbers of modes that the judgement needs
    more: bool = False  # whether it needs a larger model than these, too
    sizes: int = 0  # least number of models that it needs

    def entry(self, done: Finished) -> dict[str, Any]:
        """Return the claim, the result and whether it holds; None where no run tests it."""
        result: tuple[str, bool | None] = (f"needs {self.needs}", None)
        enough = {*self.modes} <= {*done.errors} and len(done.errors) >= self.sizes
        if enough and not (self.more and max(done.errors) <= max(self.modes)):
            result = self.judge(done)
        return {"figure": self.figure, "claim": self.text, "here": result[0], "holds": result[1]}

    @property
    def needs(self) -> str:
        """Models without which the claim is not judged."""
        sizes = f"{' and '.join(map(str, self.modes))} modes" if self.modes else f"{self.sizes} sizes"
        return f"{sizes} and more" if self.more else sizes


def cost_of(run: Trajectory) -> dict[str, Any]:
    """Return the time and the steps of a full run."""
    return {
        "wall_seconds": run.wall_seconds,
        "real_time_factor": float(run.times[-1] - run.times[0]) / run.wall_seconds,
        "steps": int(run.steps[-1]),
        "stiffness_damping": run.stiffness_damping,
    }


def build_report(
    studies: Mapping[str, Study | None],
    quantities_of: Callable[[Study, int], dict[str, Any]],
    claims: Sequence[Claim],
    pod_seconds: float,
) -> dict[str, Any]:
    """Return the report of an example: only what JSON can hold, in SI units.

    `studies` are by name in the report, None where the full run diverged. The first has the form of the paper.
    `quantities_of` returns the quantities of a full run by the number of its phase. `pod_seconds` [s] is the time of
    the decomposition of the snapshots.
    """
    complete = [study for study in studies.values() if study]
    first, case = complete[0], complete[0].case
    report: dict[str, Any] = {
        "title": case.title,
        "parameters": dict(case.parameters) | {"duration": case.duration, "every": case.every},
        "nodes": len(case.model.cloud),
        "machine": machine(),
        "stability": asdict(case.model.stability),
    }
    for key, study in studies.items():
        numbers = range(len(study.phases)) if study else ()
        report[key] = study and study.of_phases([quantities_of(study, number) for number in numbers])
    if len(studies) > 1:
        report["forms"] = _distances(*complete) if len(complete) > 1 else None
    judged = {series: _finished(study, series) for study in complete for series in study.series}
    report |= {
        "pod_seconds": pod_seconds,
        "singular_values": first.of_phases(first.singular_values),
        "snapshots": first.of_phases([len(part.times) for part in first.parts]),
        "reduced": [_of_phases(study, entry) for study in complete for entry in study.reduced],
        **dict.fromkeys(CLAIM_KEYS.values()),
        **{CLAIM_KEYS[series]: [claim.entry(done) for claim in claims] for series, done in judged.items()},
    }
    return {name: plain(value) for name, value in report.items()}


def _finished(study: Study, series: str) -> Finished:
    """Return the results of a series over the first phase, which is the one of the paper's figures."""
    done = {entry["modes"]: entry for entry in study.finished(study.phases[0], series)}
    return Finished(
        {modes: entry["errors"]["displacement"] for modes, entry in done.items()},
        {modes: entry["ratio"] for modes, entry in done.items()},
        {modes: entry["wall_seconds"] for modes, entry in done.items()},
    )


def _of_phases(study: Study, entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry of a reduced model for the report; with one phase, the phase and the whole run are one."""
    if len(study.phases) > 1:
        return entry
    named = {"series": entry["series"], "modes": entry["modes"]} | entry["phases"][study.phases[0].name]
    return named | entry.get("joined", {})


def _distances(first: Study, other: Study) -> dict[str, Any]:
    """Return the errors of a full run against another one, and (34) until the body is back at rest."""
    full, until = first.full, BACK_AT_REST * first.case.duration
    apart, size = (
        np.linalg.norm(field, axis=2).sum(axis=1)
        for field in (other.full.displacements - full.displacements, full.displacements)
    )
    early = (size > 0) & (full.times <= until)
    return {
        "errors": relative_errors(full, other.full).as_dict(),
        "until": until,
        "displacement_until": float(np.mean(apart[early] / size[early])),
    }


def difference_of_forms(first: Study, other: Study) -> str:
    """Return the sentence on the distance of two full runs, with its reason."""
    return _sentence(_distances(first, other))


def _sentence(forms: dict[str, Any]) -> str:
    error, early = forms["errors"]["displacement"], forms["displacement_until"]
    sentence = (
        f"The two full models differ by {error:.1%} in displacement (34), by {early:.1%} until {forms['until']:g} s"
    )
    if error < MIN_GROWTH * early:
        return sentence
    return f"{sentence}: afterwards the beam swings about rest, and the swings of the two differ in phase"


def tables(report: dict[str, Any], studies: Mapping[str, Study | None], rows: Rows) -> list[Table | str]:
    """Return tables and sentences for people: full models, their difference, each series, and the claims."""
    complete = {key: study for key, study in studies.items() if study}
    columns: dict[str, Any] = {}
    for key, study in complete.items():
        columns |= report[key] if len(study.phases) > 1 else {study.form: report[key]}
    drawn: list[Table | str] = [quantities(f"{report['title']}, {report['nodes']} nodes: full model", rows, columns)]
    drawn += [_sentence(report["forms"])] if report.get("forms") else []
    for study in complete.values():
        for series in study.series:
            for phase in study.phases:
                where = f", {phase.name}" if len(study.phases) > 1 else ""
                title = f"{SERIES_TITLES[series]}{where}: errors and time against the {study.form or 'full model'}"
                drawn.append(_reduced_table(title, study.entries(phase, series)))
    return [*drawn, _claims_table({series: report[key] for series, key in CLAIM_KEYS.items() if report[key]})]


def _reduced_table(title: str, entries: Sequence[Mapping[str, Any]]) -> Table:
    rows = []
    for entry in entries:
        if entry["failed"]:
            rows.append([str(entry["modes"]), "failed", *(["-"] * (len(COLUMNS) - 2))])
            continue
        wrong = [percent(value) for value in (*entry["errors"].values(), entry["projection_error"])]
        time = f"{entry['wall_seconds']:.2f}", f"{entry['ratio']:.2%}", str(entry["steps"])
        step = 1e6 * entry["seconds_per_step"]
        cost = f"{step:.1f}" if step < 100 else f"{step:.0f}"
        rows.append([str(entry["modes"]), str(entry["nodes"]), *wrong, *time, cost])
    return Table(title, COLUMNS, rows, ["right"] * len(COLUMNS), wraps=False)


def _claims_table(judged: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """Return a table of the claims, judged for the models of each series."""
    answers = {True: "yes", False: "no", None: "-"}
    rows = []
    for claims in zip(*judged.values(), strict=True):
        results = [word for claim in claims for word in (claim["here"], answers[claim["holds"]])]
        rows.append([claims[0]["figure"], claims[0]["claim"], *results])
    columns = [word for name in judged for word in (name, "holds")]
    return Table("Claims of the paper", ("figure", "paper", *columns), rows, ["left"] * (2 + len(columns)))
