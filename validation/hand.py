"""The error bound of the force under a mouse: how long it is finite, and whether the force of the full body is in it.

    python validation/hand.py [NAME ...] [--paths 15] [--seed 0] [--folder out/hand] [--keep]

trains the reduced models of `BODIES` with default choices, and moves their tools in a session as the page does: 60
poses a second. A ball comes from 8 mm above the surface with a time constant of 70 ms. Of five paths it is held in one,
drawn sideways, flicked, and let go in half a second in one each; in one a second ball presses elsewhere. Balls go half
as deep as a click that is held to twice as deep, and at once: on the page a click grows to that depth in 0.8 s. The
held end of the beam moves likewise, by what it was trained for. The full body then follows the paths that the tools
took. Places and depths are others than those of training and calibration.

Models and runs are kept in the folder, under the commit of the sources, so that a stopped command continues. With
``--keep`` each body is added to docs/validation/hand.json, and bodies of the same commit there are not measured again.
`pt.rollout` of the full body is the yardstick, by means over frames of 5 or 10 ms as in calibration. It shows the error
of the reduction, not that of the nodes.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import result_files
from organs import DATA
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

import palpate as pt
from palpate.app.common.console import Console
from palpate.app.models.trained import campaign_of
from palpate.app.session.session import Session
from palpate.app.train.campaign import MODEL_FILE
from palpate.core.arrays import Floats
from palpate.dynamics.contact.shapes import tool_parameters
from palpate.reduction.hyper.error_indicator import (
    bound_curve,
    force_bound,
    forgetting_rate,
    measure_ratios,
    remembered_trust,
)
from palpate.reduction.training.calibrate_indicator import repeat_run
from palpate.reduction.training.parallel_runs import in_threads
from palpate.scenes.scene import Scene

GAP, APPROACH = 0.008, 0.07  # [m] above the surface, and time constant [s], as page/src/press.js
FRICTION = 0.2  # as page/src/toolSettings.js
FRAME = 1 / 60  # [s] between poses
DEPTH_SHARE = 0.35  # depth of a click that is held, over the radius of the ball, as page/src/press.js
CLICK_SHARE = 0.02  # the same over the diagonal of the body, at most
DEPTHS = 0.5, 2.0  # of a press over that of a click: the wheel and motions to and fro change it
KINDS = ("click", "drag", "flick", "tap", "two tools")
DURATION = {"click": 1.0, "drag": 1.4, "flick": 1.0, "tap": 0.5, "two tools": 1.0}  # [s]
DRAG_SPEED, FLICK_SPEED, WAY = 0.05, 0.5, 0.03  # [m/s]; [m] sideways, at most
SECOND_DELAY = 0.2  # [s] of the second of two tools
MIN_FORCE = 1e-3  # [N] of a tool in contact
WORKERS = 2  # processes that train
FIRST_SEED = 1000  # of the paths; the campaign has seed 0


def _surface(file: str, part: Sequence[str] = (), **settings: Any) -> Callable[[], Scene]:
    return lambda: pt.open_scene(DATA / file, settings, part=part)


BODIES: dict[str, Callable[[], Scene]] = {
    "liver": lambda: pt.open_scene("liver", {"spacing": 0.01125}),
    "HRA liver": _surface("hra/VH_F_liver_solid_6k.ply", units="m", spacing=0.0128),
    "SOFA liver": _surface("sofa/liver-smooth.obj", units="cm", spacing=0.0036),
    "spleen": _surface("labels/trunk_3mm_61_labels.nii.gz", part=["spleen"], spacing=0.0065),
    "beam": lambda: pt.open_scene("beam"),
}


class Hand(NamedTuple):
    """A tool in a hand."""

    start: Floats  # (3,) [m]: position of the tool at its first pose
    way: Callable[[float], Floats]  # position (3,) [m] at a time [s]
    delay: float  # [s] from which on the tool moves


def ball_way(kind: str, time: float, along: Floats, normal: Floats, depth: float) -> Floats:
    """Return the way (3,) [m] of a hand from where the ball touches, at a time [s] from its click on."""
    height = (GAP + depth) * math.exp(-time / APPROACH) - depth
    if kind == "tap" and time > 0.3:
        height += GAP * (time - 0.3) / 0.1
    return height * normal + _aside(kind, time) * along


def _aside(kind: str, time: float) -> float:
    """Return the way [m] sideways at a time [s]."""
    side = {"drag": DRAG_SPEED * max(time - 0.4, 0.0), "flick": FLICK_SPEED * min(max(time - 0.5, 0.0), 0.05)}
    return min(side.get(kind, 0.0), WAY)


def end_way(kind: str, time: float, end: Floats) -> Floats:
    """Return the way (3,) [m] of a hand that holds the end of a body, to an end of it, at a time [s]."""
    size = float(np.linalg.norm(end))
    if kind == "drag":
        return end * min(DRAG_SPEED * time / size, 1.0)
    if kind == "flick":
        return end * min(FLICK_SPEED * time / size, 1.0)
    share = 1.0 - math.exp(-time / APPROACH)
    if kind == "tap" and time > 0.3:
        share *= max(1.0 - (time - 0.3) / 0.1, 0.0)
    return end * share


def hands_of(scene: Scene, kind: str, radius: float, seed: int) -> list[Hand]:
    """Return the tools of a path: one, or two of ``"two tools"``."""
    random = np.random.default_rng(seed)
    if scene.held_group:
        training = scene.description.training
        end = random.uniform(training.low, training.high)
        return [Hand(np.zeros(3), lambda time: end_way(kind, time, end), 0.0)]
    paths, hands = scene.tool_paths(), list[Hand]()
    click = min(DEPTH_SHARE * radius, CLICK_SHARE * float(np.linalg.norm(np.ptp(scene.cloud.points, axis=0))))
    while len(hands) < 1 + (kind == "two tools"):
        node = int(random.choice(np.flatnonzero(paths.reachable)))
        normal = paths.normals[node]
        touch = paths.surface.points[node] + paths.heights[node] * normal
        along, depth = np.cross(normal, random.normal(size=3)), click * random.uniform(*DEPTHS)
        along /= np.linalg.norm(along)
        if hands and np.linalg.norm(touch - hands[0].way(1.0)) < 2 * radius + GAP + scene.cloud.spacing:
            continue

        way = partial(_touch_way, kind, touch, along, normal, depth)
        hands.append(Hand(way(0.0), way, SECOND_DELAY * len(hands)))
    return hands


def _touch_way(kind: str, touch: Floats, along: Floats, normal: Floats, depth: float, time: float) -> Floats:
    """Return the position (3,) [m] of a ball in a hand at a time [s]."""
    return np.asarray(touch + ball_way(kind, time, along, normal, depth))


def press(session: Session, hands: list[Hand], radius: float, kind: str, file: Path) -> Floats:
    """Move tools in real time; return a row for each period: time, trust, largest so far, and of each tool 6 numbers.

    They are position [3] and force [3]. The black box of the engine is written to a file for that.
    """
    message = {"quaternion": [1, 0, 0, 0], "friction": FRICTION, "stiffness": None}
    sizes, held = dict.fromkeys(tool_parameters(), radius), not session.tool_kinds
    for index, hand in enumerate([] if held else hands):
        first = {"position": list(hand.start), "sequence": 1, "index": index}
        session.handle({"type": "tool", "kind": "sphere", **sizes, **message, **first})
    origin = session.tools[0].origin if held else np.zeros(3)
    first_time, began, sequence = session.engine.read().time, time.monotonic(), 1
    while (now := time.monotonic() - began) < DURATION[kind]:
        sequence += 1
        for index, hand in enumerate(hands):
            position = origin + hand.way(max(now - hand.delay, 0.0))
            pose = {"position": list(position), "sequence": sequence, "index": index}
            session.handle({"type": "pose", **message, **pose})
        time.sleep(max(began + (sequence - 1) * FRAME - time.monotonic(), 0.0))
    session.engine.dump(file)
    session.reset()
    with h5py.File(file) as recording:
        times, tools = recording["time"][:], range(len(hands))
        columns = [recording["trust"][:].reshape(-1, 1), recording["worst_trust"][:].reshape(-1, 1)]
        for k, hand in zip(tools, hands, strict=True):
            columns += [hand.start + recording["tools/position"][:, k], recording["tools/force"][:, k]]
    table = np.concatenate([times[:, None], *columns], axis=1)
    begun = np.flatnonzero(np.diff(times) < 0)  # the last reset
    table = table[begun[-1] + 1 if len(begun) else 0 :]
    return table[table[:, 0] >= first_time]


def compared(scene: Scene, model: pt.ReducedModel, table: Floats, radius: float) -> dict[str, Any]:
    """Return how the forces of the full body on the same path are in the bounds of a press."""
    times, tools = table[:, 0] - table[0, 0], table[:, 3:].reshape(len(table), -1, 6)
    loads = [_load(scene, PchipInterpolator(times, tools[:, k, :3]), k, radius) for k in range(tools.shape[1])]
    every, bound_of = [*loads, *scene.foundations], force_bound(model.report)
    interval = scene.description.training.every
    duration = interval * math.floor(times[-1] / interval)
    full = pt.rollout(scene.body, every, duration=duration, every=interval, progress=False)
    ends = np.searchsorted(times, full.times[1:] - 1e-9).clip(max=len(times) - 1)
    worst_time: float | None = None
    worst, beyond, in_contact, known, sizes, bounds_of = 0.0, 0.0, [], [], [], []
    errors_of = [0.0]
    for k, load in enumerate(loads):
        name = load.group if scene.held_group else load.name
        on_body = full.reactions[name][1:]
        # the force of a frame of the run is the mean since the one before; that on the hand, and on the body
        impulses = cumulative_trapezoid(tools[:, k, 3:], times, axis=0, initial=0.0)
        means = np.diff(PchipInterpolator(times, impulses)(full.times), axis=0) / interval
        errors, size = np.linalg.norm(means + on_body, axis=1), np.linalg.norm(tools[:, k, 3:], axis=1)
        every_bound = np.array([bound_of(*each) for each in zip(table[:, 2], size, strict=True)])
        bounds = every_bound[ends]
        touching = np.linalg.norm(on_body, axis=1) > MIN_FORCE
        finite = touching & np.isfinite(bounds)
        ratios = np.where(finite, errors / bounds, 0.0)
        if ratios.max(initial=0.0) > worst:
            worst, worst_time = float(ratios.max()), float(full.times[1 + ratios.argmax()])
        beyond = max(beyond, float(ratios[finite & (table[ends, 2] > 1.0)].max(initial=0.0)))
        in_contact.append(size > MIN_FORCE)
        known.append(np.isfinite(every_bound))
        sizes.append(float(size.max()))
        errors_of.append(float(errors[touching].max(initial=0.0)))
        bounds_of += bounds[finite].tolist()
    contact = np.any(in_contact, axis=0)
    finite = np.all(known, axis=0)[contact]
    causes = {} if finite.all() else _largest_measures(model, repeat_run(model, every, full)[1])
    return {
        "in_contact": float(contact.mean() * times[-1]), "known": float(finite.mean()) if contact.any() else None,
        "largest_trust": float(table[:, 1].max()), "largest_force": max(sizes), "largest_error": max(errors_of),
        "over_bound": worst, "over_at": worst_time, "over_bound_beyond_1": beyond,
        "mean_bound": float(np.mean(bounds_of)) if bounds_of else None,
        "unknown_by": causes,
    }  # fmt: skip


def _load(scene: Scene, path: PchipInterpolator, index: int, radius: float) -> Any:
    """Return the load of a tool along its path."""
    last = float(path.x[-1])
    if scene.held_group:
        return pt.PrescribedMotion(scene.held_group, lambda points, t: path(min(t, last)) + 0.0 * points)
    name = f"tool {index + 1}"
    return pt.tools.Contact(
        pt.tools.Sphere(radius), lambda t: path(np.clip(t, 0.0, last)), friction=FRICTION, name=name
    )


def _largest_measures(model: pt.ReducedModel, frames: Any) -> dict[str, float]:
    """Return the share of the frames without a bound, by the measure that made the largest error indicator so far."""
    forgetting, limit = forgetting_rate(model.report), float(bound_curve(model.report)[3])
    ratios = measure_ratios(frames.measures, model.data)
    worst = {name: remembered_trust(numbers, frames.times, forgetting) for name, numbers in ratios.items()}
    names, numbers = list(worst), np.array(list(worst.values()))
    unknown = numbers.max(axis=0) > limit
    causes = Counter(names[k] for k in numbers.argmax(axis=0)[unknown])
    return {name: count / len(frames.times) for name, count in causes.items()}


def study(name: str, scene: Scene, model: pt.ReducedModel, folder: Path, count: int, seed: int) -> dict[str, Any]:
    """Press a model along paths; return the figures of each, and those of all."""
    radius = 0.0 if scene.held_group else scene.tool_paths().radius
    kinds = [kind for kind in KINDS if not (scene.held_group and kind == "two tools")]
    kinds = [kinds[k % len(kinds)] for k in range(count)]
    session, tables = Session(model, name), []
    session.start()
    try:
        for k, kind in enumerate(kinds):
            hands = hands_of(scene, kind, radius, FIRST_SEED + seed + k)
            tables.append(press(session, hands, radius, kind, folder / "path.h5"))
    finally:
        session.close()
    with warnings.catch_warnings(action="ignore", category=pt.TrustWarning):
        rows = in_threads(lambda table: compared(scene, model, table, radius), tables)
    rows = [{"kind": kind, **row} for kind, row in zip(kinds, rows, strict=True)]
    for row in rows:
        print(
            ", ".join(
                f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()
            )
        )
    return {
        "body": name, "nodes": len(scene.cloud), **summary(rows),
        "level": model.report["held_out"]["expected_error"]["level"], "rows": rows,
    }  # fmt: skip


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the time in contact, the share of it with a bound, and how many paths keep it."""
    touched = [row for row in rows if row["in_contact"] > 0]
    seconds = sum(row["in_contact"] for row in touched)
    return {
        "in_contact": seconds, "known": sum(row["in_contact"] * row["known"] for row in touched) / seconds,
        "paths": len(touched), "kept": sum(row["over_bound"] <= 1.0 for row in touched),
    }  # fmt: skip


def trained(scene: Scene, folder: Path) -> pt.ReducedModel:
    """Return the model of a scene from a folder; train it there with default choices."""
    if (folder / MODEL_FILE).is_file():
        return pt.load(folder / MODEL_FILE)
    training = scene.description.training
    with campaign_of(scene, folder, Console(), WORKERS) as campaign:
        return campaign.train(campaign.jobs(range(training.paths), training.held_out))


def line(name: str, found: dict[str, Any]) -> str:
    """Return the figures of a body, or of all, in words."""
    return (
        f"{name}: bound finite in {found['known']:.1%} of {found['in_contact']:.1f} s in contact; kept in "
        f"{found['kept']} of {found['paths']} paths"
    )


def main() -> None:
    """Measure bodies, and print or keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bodies", nargs="*", metavar="NAME", help=f"of {', '.join(BODIES)}; all by default")
    parser.add_argument("--paths", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("out/hand"))
    parser.add_argument("--keep", action="store_true")
    options = parser.parse_args()
    commit, every = result_files.commit(), list[dict[str, Any]]()
    for name in options.bodies or BODIES:
        stored = result_files.read("hand", [])
        done = next((row for row in stored if row["body"] == name and row["commit"] == commit), None)
        if options.keep and done is not None and not commit.endswith("+"):
            every.append(done)
            continue
        began, scene = time.perf_counter(), BODIES[name]()
        folder = options.folder / commit / name.replace(" ", "_")
        model = trained(scene, folder)
        between = time.perf_counter()
        found = {"commit": commit, **study(name, scene, model, folder, options.paths, options.seed)}
        found["seconds"] = [between - began, time.perf_counter() - between]
        print(f"{line(name, found)}; level {found['level']:.0%}; training {found['seconds'][0]:.0f} s, "
              f"measuring {found['seconds'][1]:.0f} s", flush=True)  # fmt: skip
        every.append(found)
        if options.keep:
            order = list(BODIES)
            rows = [*(row for row in stored if row["body"] != name), found]
            result_files.write("hand", sorted(rows, key=lambda row: order.index(row["body"])), COMMAND)
    print(line("all", summary([row for found in every for row in found["rows"]])))


COMMAND = "python validation/hand.py --keep"

if __name__ == "__main__":
    main()
