"""A model stepped at a fixed rate while a tool moves, and how the rate was kept: ``palpate run ... --realtime``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.console import Console, percent, print_json, print_plain, quantities_table
from palpate.app.report import machine
from palpate.app.study import ReproduceError
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.run.progress import progress_bar
from palpate.faults import number_in_range
from palpate.files import check_folder, check_space, plain, write_json
from palpate.realtime.device import DummyDevice
from palpate.realtime.engine import Engine
from palpate.realtime.statistics import Distribution, Statistics
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.realtime.model import realtime_model

__all__ = ["FILES", "Poses", "run_realtime"]

Poses = Callable[[float], Any]  # at times [s], as `palpate.DummyDevice` takes them

BLACK_BOX = "black_box.h5"
FILES = ("report.json", BLACK_BOX)
LONGEST, SLOWEST, FASTEST = 600.0, 50.0, 20_000.0  # [s], [Hz]: what the engine's black box and periods allow
BINS = 20  # of the engine's histogram in one line of the printed one: half a decade
BAR = 24  # characters of the longest line
ROW = 1000  # bytes of a period in the black box, at most
SHOWN = 0.1  # [s] between two updates of the progress bar


def run_realtime(
    made: Callable[[Console], tuple[ReducedModel, Poses, Contact | None]],
    *,
    title: str,
    about: Mapping[str, Any],
    seconds: float = 10.0,
    rate: float = 1000.0,
    out: Path,
    as_json: bool = False,
) -> int:
    """Step a model at a fixed rate for some seconds while a hand moves its tool, and report how the rate was kept.

    Parameters
    ----------
    made : function
        Called once all else is checked; returns the model, the hand, and the tool that touches the body: None for one
        that holds the model's driven group.
    title : str
    about : mapping
        More of the report's parameters.
    seconds : float [s]
        Up to 600.
    rate : float [Hz]
        From 50 to 20000.
    out : path
    as_json : bool
        As for `palpate.app.beam.reproduce.reproduce_beam`.

    Returns
    -------
    int
        0, whether the rate was held or not.

    Raises
    ------
    InputError
        A parameter out of range, or a model that takes no such tool.
    ReproduceError
        The state diverged; the black box is kept.
    OSError
        A file could not be read or written.
    """
    seconds = number_in_range("seconds", seconds, 0.0, LONGEST, open_low=True, unit="s")
    rate = number_in_range("rate", rate, SLOWEST, FASTEST, unit="Hz")
    check_folder(out)
    check_space(out, round(seconds * rate * ROW))
    console = Console()
    body, hand, contact = made(console)
    with console.status("making the engine ready (the first run on a machine compiles it: about a minute)"):
        ready = realtime_model(body, contact=contact)
        out.mkdir(parents=True, exist_ok=True)
        engine = Engine(ready, rate, history=seconds, black_box=out / BLACK_BOX)
    statistics = _stepped(engine, hand, seconds, out / BLACK_BOX, console)
    report = {
        "title": f"{title}, {rate:g} Hz",
        "parameters": {"seconds": seconds, "rate": rate, "spacing": body.cloud.spacing, **about},
        "material": asdict(body.material),
        "machine": machine(),
        "model": body.report,
        "felt": _felt(out / BLACK_BOX, body),
        "timing": _timing(statistics),
    }
    report = plain(report)
    write_json(out / "report.json", report)
    if as_json:
        print_json(report)
    else:
        print_plain([*_tables(report, statistics), *_verdict(report)], out, FILES)
    return 0


def _stepped(engine: Engine, hand: Poses, seconds: float, black_box: Path, console: Console) -> Statistics:
    """Let an engine step while a hand moves its tool; leave the black box, and return how the rate was kept."""
    console.say(f"{1 / engine.period:g} Hz for {seconds:g} s ...")
    with warnings.catch_warnings(), progress_bar("real time", seconds, True) as shown:
        warnings.simplefilter("ignore", RuntimeWarning)  # about trust: the report tells it
        try:
            with engine:
                DummyDevice(_watched(hand, shown)).prepare(engine, seconds)
        except KeyboardInterrupt:
            raise KeyboardInterrupt("in real time") from None
    if engine.state == "diverged":
        raise ReproduceError(f"the state diverged; what happened before is in {black_box}")
    engine.dump(black_box)
    return engine.statistics()


def _watched(hand: Poses, shown: Callable[[float, float], None]) -> Poses:
    """Return the hand's path, which tells now and then how far it is."""
    last = 0.0

    def path(time: float) -> Any:
        nonlocal last
        if time > last + SHOWN:
            last = time
            shown(time, time)
        return hand(time)

    return path


def _felt(black_box: Path, body: ReducedModel) -> dict[str, Any]:
    """Return what the tool felt, and how well the model knew the states: over all periods."""
    calibrate_indicator = "trust" in body.report.get("held_out", {})
    import h5py

    with h5py.File(black_box) as file:
        force, trust = np.linalg.norm(file["force"][:], axis=1), file["trust"][:]
        moved, taken = np.linalg.norm(file["position"][:], axis=1), file["iterations"][:]
    return {
        "largest_force": float(force.max()),
        "largest_displacement": float(moved.max()),
        "largest_trust": float(trust.max()),
        "median_trust": float(np.median(trust)),
        "untrained_share": float(np.mean(trust > 1)),
        "expected_error": body.expected_error(float(trust.max())) if calibrate_indicator else None,
        "mean_steps_per_period": float(taken.mean()),
    }


def _timing(statistics: Statistics) -> dict[str, Any]:
    return {
        "period": statistics.period,
        "periods": statistics.count,
        "missed": statistics.missed,
        "missed_by_computing": statistics.overrun,
        "dropped": statistics.dropped,
        "computing": _distribution(statistics.computing),
        "lateness": _distribution(statistics.lateness),
        "sustained": statistics.sustained,
        "verdict": statistics.verdict,
    }


def _distribution(times: Distribution) -> dict[str, Any]:
    filled = np.flatnonzero(times.counts)
    own = slice(filled[0], filled[-1] + 1) if filled.size else slice(0)
    return {
        "percentiles": {f"{percent:g}": seconds for percent, seconds in times.percentiles.items()},
        "maximum": times.maximum,
        "histogram": {
            "edges": times.edges[own.start or 0 : own.stop + 1].tolist(),
            "counts": times.counts[own].tolist(),
        },
    }


def _tables(report: dict[str, Any], statistics: Statistics) -> list[Any]:
    timing, felt = report["timing"], report["felt"]
    both = [timing["computing"], timing["lateness"]]
    names = {"50": "median", "95": "95 %", "99": "99 %", "99.9": "99.9 %"}
    rows = {name: [_microseconds(each["percentiles"][key]) for each in both] for key, name in names.items()}
    rows["largest"] = [_microseconds(each["maximum"]) for each in both]
    title = f"{report['title']}, {timing['periods']} periods"
    single = {
        "largest force on the tool": f"{felt['largest_force']:.3g} N",
        "farthest that the tool went": f"{1e3 * felt['largest_displacement']:.3g} mm",
        "steps of the model in a period": f"{felt['mean_steps_per_period']:.2g}",
        "trust number, median; largest (above 1: not trained on)": (
            f"{felt['median_trust']:.2f}; {felt['largest_trust']:.2f}"
        ),
        "share of periods above 1": percent(felt["untrained_share"]),
        "displacement error of held-out runs at the largest, median; 95 %": _expected(felt["expected_error"]),
    }
    if "held_out" in report["model"]:
        error = report["model"]["held_out"]["mean"].get("reaction")
        single["error of reaction forces on held-out runs, mean"] = "-" if error is None else percent(error)
    return [
        quantities_table(title, ["computing (the model)", "lateness (the scheduler)"], rows),
        quantities_table("Periods", ["computing", "lateness"], _histogram(statistics), "time", "left"),
        quantities_table("Tool", ["value"], {name: [value] for name, value in single.items()}),
    ]


def _expected(error: list[float | None] | None) -> str:
    """Write a median and a percentile; none is known where the model was not tried on such states."""
    if error is None or None in error:
        return "not known: none had so large a number" if error else "not measured"
    return "; ".join(f"{part:.2%}" for part in error)


def _microseconds(seconds: float) -> str:
    return f"{1e6 * seconds:,.3g} us" if seconds < 1e-3 else f"{1e6 * seconds:,.0f} us"


def _histogram(statistics: Statistics) -> dict[str, list[str]]:
    """Return lines of a histogram: upper end of the times, and for each kind the periods and a bar."""
    kinds = [statistics.computing, statistics.lateness]
    counts = np.array([np.add.reduceat(kind.counts, np.arange(0, len(kind.counts), BINS)) for kind in kinds])
    filled = np.flatnonzero(counts.any(axis=0))
    ends = kinds[0].edges[BINS::BINS]
    rows = {}
    for k in range(filled[0], filled[-1] + 1) if filled.size else ():
        bars = ["#" * int(np.ceil(BAR * count / counts.max())) for count in counts[:, k]]
        rows[f"up to {_microseconds(ends[k])}"] = [
            f"{count:>6} {bar}" for count, bar in zip(counts[:, k], bars, strict=True)
        ]
    return rows


def _verdict(report: dict[str, Any]) -> list[str]:
    """Say whether the rate is held, and apart what the computation took and what the scheduler added."""
    timing = report["timing"]
    period, computing, late = timing["period"], timing["computing"], timing["lateness"]
    over, lost = timing["missed_by_computing"], timing["missed"] - timing["missed_by_computing"]
    return [
        f"Computation: {computing['percentiles']['50'] / period:.1%} of a period in the median, "
        f"{computing['maximum'] / period:.1%} at most; {over} of {timing['periods']} periods computed for too long.",
        f"Scheduler: steps began {_microseconds(late['percentiles']['99'])} late or less in 99 % of the periods, "
        f"{_microseconds(late['maximum'])} at most; {max(lost, 0)} deadlines missed for that, "
        f"{timing['dropped']} periods without a step.",
        f"Verdict: {timing['verdict']}.",
    ]
