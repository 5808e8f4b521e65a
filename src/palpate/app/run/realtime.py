"""``palpate run ... --realtime``: step a body at a fixed rate under a moving tool, and report missed deadlines."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.console import Console, Table, quantities_table
from palpate.app.common.exit_status import DONE, FAILED, RunError
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.app.common.rows import Rows, fill_template, quantities, rows_of
from palpate.app.device.driver import driving
from palpate.app.device.options import DeviceOptions
from palpate.app.device.statistics import hand_reports, longest, tool_name
from palpate.app.models.force_error import nodes_error
from palpate.app.models.input import Input
from palpate.app.models.trained import model_file
from palpate.app.run.tool_motion import tool_motion
from palpate.app.session.opening import exit_on_signals, running_session
from palpate.app.session.play import ToolPath, follow, play, read_script
from palpate.app.session.session import Session
from palpate.app.train.estimate import confirm
from palpate.core.faults import number_in_range
from palpate.core.files import check_folder, check_space, plain
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.foundation import Foundation
from palpate.realtime.bodies.full_blade import BladeCutter
from palpate.realtime.contract import MAX_TOOLS
from palpate.realtime.statistics import Distribution, Statistics
from palpate.reduction.hyper.model import ReducedModel

BLACK_BOX = "black_box.h5"
FILES = (*REPORTS, BLACK_BOX)
MAX_RUN_SECONDS, MIN_RATE, MAX_RATE = 600.0, 50.0, 20_000.0  # [s], [Hz]: limits of black box and periods
BINS_PER_LINE = 20  # of the engine's histogram in one line of the printed one: half a decade
BAR_WIDTH = 24  # characters of the longest line
BYTES_PER_PERIOD = 1000  # bytes of a period in the black box, at most


def run_realtime(
    opened: Input,
    *,
    full: bool,
    cut: bool,
    script: Path | None,
    record: Path | None,
    device: DeviceOptions | None = None,
    seconds: float = 10.0,
    rate: float = 1000.0,
    out: Path,
    as_json: bool = False,
) -> int:
    """Step a body at a fixed rate for some seconds under a moving tool, and report missed deadlines.

    With `full` the full body of the scene is stepped, and with `cut` a scalpel cuts it. The messages of
    `script` or the hand at a `device` drive the session in place of the tool of the scene; `record` is the file of a
    recording. The time is at most 600 s, the rate from 50 to 20,000 Hz. The status is 0 whether the rate was held or
    not, and 1 if a recording was not written.
    """
    seconds = number_in_range("seconds", seconds, 0.0, MAX_RUN_SECONDS, open_low=True, unit="s")
    rate = number_in_range("rate", rate, MIN_RATE, MAX_RATE, unit="Hz")
    check_folder(out)
    check_space(out, round(seconds * rate * BYTES_PER_PERIOD))
    console, black_box = Console(), out / BLACK_BOX
    messages = None if script is None else read_script(script)
    training = None if full else opened.training_needed(console)
    if training is not None:
        confirm(console, training, "Train?", yes=True)  # only printed
    tool: Contact | None = None
    path: ToolPath

    def make(body: Any, foundations: tuple[Foundation, ...]) -> Session:
        nonlocal tool, path
        path, tool = (messages, None) if messages is not None else _motion(opened, body, cut, device)
        out.mkdir(parents=True, exist_ok=True)
        return Session(body, opened.title, rate, foundations, history=seconds, black_box=black_box)

    with exit_on_signals(), running_session(opened, full, make, console, record, exact=True) as session:
        session.stop()  # so that the statistics begin with the tool
        if tool is not None:
            session.put_down(tool)
        console.say(f"{rate:g} Hz for {seconds:g} s ...")
        session.start()
        try:
            with driving(session, device, console.say) as driver:
                play(session, path, seconds)
        except KeyboardInterrupt:
            raise KeyboardInterrupt("in real time") from None
        last_forces = [float(np.linalg.norm(each.force)) for each in session.engine.read().tools]
        session.stop()
        if session.engine.state == "diverged":
            raise RunError(f"the state diverged; what happened before is in {black_box}")
        session.engine.dump(black_box)
        statistics = session.engine.statistics()
    spacing = session.model.cloud.spacing
    report = {
        "title": f"{'Full ' + opened.title.lower() if full else opened.title} in real time, {rate:g} Hz",
        "parameters": {"seconds": seconds, "rate": rate, "spacing": spacing, **_origin(opened, full, cut)},
        **_session_report(session, statistics, black_box, last_forces),
    }
    if driver is not None:
        report["hands"] = hand_reports(driver.hands)
    if messages is not None:
        report["script"] = {"file": str(script), "messages": messages.done, "refused": messages.refused}
    report = plain(report)
    deliver(report, _tables(report, statistics), out, FILES, as_json)
    return FAILED if session.recordings.failures else DONE


def _motion(opened: Input, body: Any, cut: bool, device: DeviceOptions | None) -> tuple[ToolPath, Contact | None]:
    """Return what moves the tool, and the tool of the scene unless a device moves another one."""
    if device is not None:
        return _leave_to_device, None
    poses, tool = tool_motion(opened, body, cut)
    return follow(poses), tool


def _leave_to_device(session: Session, now: float) -> None:
    """Move nothing: a device does."""


def _session_report(
    session: Session, statistics: Statistics, black_box: Path, last_forces: list[float]
) -> dict[str, Any]:
    """Return the report of the body, its tools, its cut and its deadlines."""
    body = session.model
    report = {
        "material": asdict(body.material),
        "machine": machine(),
        "model": body.report if isinstance(body, ReducedModel) else {"nodes": len(body.cloud)},
        "tool": _observations(black_box, body) | {"last_force": last_forces[0]},
        "timing": _timing(statistics),
        "session": session.statistics(),
    }
    if tools := _other_tools(black_box, last_forces):
        report["tools"] = tools
    if session.body.cutter is not None and session.body.cuts:
        kinds = [each.selected.kind for each in session.tools]
        report["cut"] = _cut_report(black_box, session.body.cutter, kinds.index("scalpel") if "scalpel" in kinds else 0)
    return report


def _origin(opened: Input, full: bool, cut: bool) -> dict[str, Any]:
    """Return the parameters of a report that name the body."""
    scene = opened.scene
    if scene is None or opened.model is not None:
        return {"file": opened.name}
    if not full:
        return {"file": str(model_file(scene))}
    return {"full": True} | ({"toughness": scene.description.cut.toughness} if cut else {})


def _observations(black_box: Path, body: Any) -> dict[str, Any]:
    """Return forces on the tool and error indicators over all periods; a full body has no indicators."""
    import h5py

    with h5py.File(black_box) as file:
        force, trust = np.linalg.norm(file["force"][:], axis=1), file["trust"][:]
        moved, taken = np.linalg.norm(file["position"][:], axis=1), file["iterations"][:]
    observations: dict[str, Any] = {
        "largest_force": float(force.max()),
        "largest_displacement": float(moved.max()),
        "mean_steps_per_period": float(taken.mean()),
    }
    if not isinstance(body, ReducedModel):
        return observations
    tables = body.report.get("held_out", {}).get("expected_error", {})
    return (
        observations
        | {
            "largest_trust": float(trust.max()),
            "median_trust": float(np.median(trust)),
            "untrained_share": float(np.mean(trust > 1)),
            "expected_error": {
                quantity: body.expected_error(float(trust.max()), quantity)._asdict()
                for quantity in ("displacement", "force")
                if quantity in tables
            },
        }
        | ({"nodes_error": nodes_error(body)} if "force" in tables else {})
    )


def _other_tools(black_box: Path, last_forces: list[float]) -> dict[str, dict[str, float]]:
    """Return the forces on the tools after the first that touched the body, by their names."""
    import h5py

    with h5py.File(black_box) as file:
        forces = np.linalg.norm(file["tools/force"][:], axis=2)
    return {
        tool_name(index): {"largest_force": float(forces[:, index].max()), "last_force": last}
        for index, last in enumerate(last_forces)
        if index > 0 and forces[:, index].any()
    }


def _cut_report(black_box: Path, cutter: BladeCutter, tool: int) -> dict[str, Any]:
    """Return the energy balance of a blade, and computing times of periods before its first force and from then on."""
    import h5py

    with h5py.File(black_box) as file:
        computing, force = file["computing"][:], np.linalg.norm(file["tools/force"][:, tool], axis=1)
    first = int(np.argmax(force > 0)) if force.any() else len(force)
    area, released, edge, friction = cutter.totals.tolist()
    return {
        "area": area, "released_energy": released, "edge_work": edge, "friction_work": friction,
        "cuts": cutter.cuts, "seconds_per_cut": cutter.seconds, "released_nodes": len(cutter.model.released_nodes),
        "failure": cutter.failure,
        "largest_release_rate": 0.0 if cutter.cut_front is None else cutter.cut_front.largest_rate,
        "computing_before": float(np.median(computing[:first])) if first else None,
        "computing_after": float(np.median(computing[first:])) if first < len(computing) else None,
        "longest_after": float(computing[first:].max(initial=0.0)),
    }  # fmt: skip


def _timing(statistics: Statistics) -> dict[str, Any]:
    return {
        "period": statistics.period,
        "periods": statistics.count,
        "missed": statistics.missed,
        "missed_by_computing": statistics.overrun,
        "dropped": statistics.dropped,
        "computing": _distribution(statistics.computing),
        "lateness": _distribution(statistics.wakeup_latency),
        "sustained": statistics.is_real_time,
        "verdict": statistics.status,
    }


def _distribution(times: Distribution) -> dict[str, Any]:
    filled = np.flatnonzero(times.counts)
    filled_bins = slice(filled[0], filled[-1] + 1) if filled.size else slice(0)
    return {
        "percentiles": {f"{percent:g}": seconds for percent, seconds in times.percentiles.items()},
        "maximum": times.maximum,
        "histogram": {
            "edges": times.edges[filled_bins.start or 0 : filled_bins.stop + 1].tolist(),
            "counts": times.counts[filled_bins].tolist(),
        },
    }


def _expected_error(quantity: str) -> Callable[[Mapping[str, Any]], str]:
    """Return the row of a median, and a bound with its level; states beyond the held-out runs have neither."""

    def text(report: Mapping[str, Any]) -> str:
        error = report["tool"]["expected_error"].get(quantity)
        if error is None:
            return "not measured"
        if error["median"] is None or error["bound"] is None:
            return "unknown: no held-out run had so large a number"
        return fill_template("{median:.2%}; {bound:.2%} ({level:.0%} of runs, at least {least_level:.0%})", error)

    return text


def _nodes_error(report: Mapping[str, Any]) -> str:
    """Return the row of the error that the bound of the force leaves out."""
    error = report["tool"]["nodes_error"]
    return "not known" if error is None else fill_template("{error:.0%}", {"error": error})


def _slowdown(report: Mapping[str, Any]) -> str:
    before, after = report["cut"]["computing_before"], report["cut"]["computing_after"]
    return f"{after / before:.2f}" if before and after else "-"


TIMING_ROWS: Rows = {
    "median": "{percentiles/50: us}",
    "95 %": "{percentiles/95: us}",
    "99 %": "{percentiles/99: us}",
    "99.9 %": "{percentiles/99.9: us}",
    "largest": "{maximum: us}",
}
TOOL_ROWS: Rows = {
    f"largest force on {tool_name(0)}": "{tool/largest_force:.3g N}",
    **{
        f"largest force on {tool_name(k)}": f"{{tools/{tool_name(k)}/largest_force:.3g N}}" for k in range(1, MAX_TOOLS)
    },
    "farthest that the tool went": "{tool/largest_displacement:.3g mm}",
    "steps of the model in a period": "{tool/mean_steps_per_period:.2g}",
    "error indicator, median; largest (above 1: not trained on)": "{tool/median_trust:.2f}; {tool/largest_trust:.2f}",
    "share of periods above 1": "{tool/untrained_share:.2%}",
    **{
        f"error of the {what} expected at the largest, median; bound": _expected_error(what)
        for what in ("displacement", "force")
    },
    "error of the nodes, typical, not in the bound of the force": _nodes_error,
    "error of reaction forces on held-out runs, mean": "{model/held_out/mean/reaction:.2%}",
    "cut area": "{cut/area:.0f mm^2} in {cut/cuts} steps of {cut/seconds_per_cut:.0f ms}",
    "work at the edge; by friction; energy that fronts released": (
        "{cut/edge_work:.3g mJ}; {cut/friction_work:.3g mJ}; {cut/released_energy:.3g mJ}"
    ),
    "most energy released per area (above the toughness, tissue would tear ahead)": (
        "{cut/largest_release_rate:.3g J/m^2}"
    ),
    "computing time while it is cut over that before": _slowdown,
    "longest period while it is cut": "{cut/longest_after: us}",
    "the cut ended early": lambda report: report["cut"]["failure"],
    "messages of the script; refused": lambda report: (
        f"{report['script']['messages']}; {len(report['script']['refused'])}"
    ),
}
HAND_ROWS: Rows = {
    "device": "{device}",
    "messages of the service": "{rate:.0f}/s in {seconds:.3g s}",
    "force on the hand, mean while there was one; largest": "{mean_force:.3g N}; {peak_force:.3g N}",
    "force taken away in contact": "{interruptions} times",
    "time with force, of it in ramps of 0.5 s": "{with_force:.3g s}; {ramped:.3g s}",
    "of it at the limit; changed by the passivity observer": "{limited:.3g s}; {damped:.3g s}",
    "clutch": "{clutches} times, {clutch_seconds:.3g s}",
    "time without force": lambda hand: "\n".join(longest(hand["without_force"])) or "none",
}
STATUS_ROWS: Rows = {
    "Computation": "{median:.1%} of a period in the median, {most:.1%} at most; {missed_by_computing} of {periods} "
    "periods computed for too long.",
    "Scheduler": "steps began {lateness/percentiles/99: us} late or less in 99 % of the periods, "
    "{lateness/maximum: us} at most; {missed_by_scheduler} deadlines missed for that, {dropped} periods without "
    "a step.",
    "Status": "{verdict}.",
}


def _tables(report: dict[str, Any], statistics: Statistics) -> list[Table | str]:
    timing = report["timing"]
    kinds = {"computing (the model)": timing["computing"], "wake-up latency (the scheduler)": timing["lateness"]}
    values = timing | {
        "median": timing["computing"]["percentiles"]["50"] / timing["period"],
        "most": timing["computing"]["maximum"] / timing["period"],
        "missed_by_scheduler": max(timing["missed"] - timing["missed_by_computing"], 0),
    }
    return [
        quantities(f"{report['title']}, {timing['periods']} periods", TIMING_ROWS, kinds),
        quantities_table("Periods", ["computing", "wake-up latency"], _histogram(statistics), "time", "left"),
        quantities("Tool", TOOL_ROWS, {"value": report}),
        *_hands_table(report),
        *(f"{label}: {sentence}" for label, (sentence,) in rows_of(STATUS_ROWS, values).items()),
    ]


def _hands_table(report: Mapping[str, Any]) -> list[Table | str]:
    """Return the statistics of hands; nothing without the option of a device."""
    if "hands" not in report:
        return []
    return [quantities("Hands", HAND_ROWS, report["hands"])] if report["hands"] else ["Hands: no device moved a tool."]


def _histogram(statistics: Statistics) -> dict[str, list[str]]:
    """Return lines of a histogram: upper end of the times, and for each kind the periods and a bar."""
    kinds = [statistics.computing, statistics.wakeup_latency]
    counts = np.array([np.add.reduceat(kind.counts, np.arange(0, len(kind.counts), BINS_PER_LINE)) for kind in kinds])
    filled = np.flatnonzero(counts.any(axis=0))
    ends = kinds[0].edges[BINS_PER_LINE::BINS_PER_LINE]
    rows = {}
    for k in range(filled[0], filled[-1] + 1) if filled.size else ():
        bars = ["#" * int(np.ceil(BAR_WIDTH * count / counts.max())) for count in counts[:, k]]
        rows[fill_template("up to {end: us}", {"end": ends[k]})] = [
            f"{count:>6} {bar}" for count, bar in zip(counts[:, k], bars, strict=True)
        ]
    return rows
