"""Progress over all runs of a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from palpate.app.common.console import Console
from palpate.app.train.folder import Job
from palpate.app.train.work import Outcome
from palpate.dynamics.run.progress import make_console


class Bar:
    """Progress of all runs: a bar of simulated time on a terminal, a line for every run elsewhere.

    `durations` [s] are by job.
    """

    def __init__(self, durations: Mapping[Job, float], console: Console) -> None:
        self._durations, self._console = dict(durations), console
        self._reached, self._ended = dict.fromkeys(durations, 0.0), 0
        screen = make_console(stderr=True)
        self._watched = screen.is_terminal
        columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.2f} / {task.total:.4g} s")
        self._bar = Progress(*columns, TimeRemainingColumn(), console=screen, transient=True, disable=not self._watched)
        self._task = self._bar.add_task("", total=sum(durations.values()))

    def __enter__(self) -> Self:
        self._bar.start()
        self._show()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def at(self, job: Job, time: float) -> None:
        """Update the time [s] that a run has reached."""
        self._reached[job] = time
        self._show()

    def done(self, outcome: Outcome) -> None:
        """Count a run that has ended."""
        job, self._ended = outcome["job"], self._ended + 1
        self.at(job, self._durations[job])
        if "failed" in outcome:
            self._console.say(f"{job.name} failed: {outcome['failed']}")
        elif not self._watched:
            self._console.say(f"{job.name}: {outcome['seconds']:.3g} s, {self._ended} of {len(self._durations)} runs")

    def _show(self) -> None:
        label, reached = f"{self._ended} of {len(self._durations)} runs", sum(self._reached.values())
        self._bar.update(self._task, completed=reached, description=label)
        self._console.report_progress(reached / sum(self._durations.values()), label)
