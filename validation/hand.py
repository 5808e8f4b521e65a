"""The error bound of the force under a mouse: how long it is finite, and whether the force of the full body is in it.

    python validation/hand.py SCENE [--set NAME=X ...] [--paths 16] [--model FILE.rom] [--seed 0] [--keep]

presses the reduced model of a scene in a session as the page does: 60 poses a second, from 8 mm above the surface with
a time constant of 70 ms. Of four paths one is a click that is held, one is drawn sideways, one is flicked, and one is
pressed and let go in half a second. The full body then follows the path that the tool took. With ``--keep`` the figures
are written to docs/validation/hand.json. `pt.rollout` of the full body is the yardstick: it shows the error of the
reduction, not that of the nodes.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import numpy as np
import result_files
from scipy.interpolate import PchipInterpolator

import palpate as pt
from palpate.app.common.arguments import parse_settings
from palpate.app.common.console import Console
from palpate.app.models.trained import trained_model
from palpate.app.session.session import Session
from palpate.arrays import Floats
from palpate.dynamics.contact.shapes import tool_parameters

GAP, APPROACH = 0.008, 0.07  # [m] above the surface, and time constant [s], as page/src/press.js
FRAME, SAMPLE = 1 / 60, 2e-3  # [s] between poses, and between readings
DEPTH_SHARE = 0.35  # depth of a click over the radius of the ball, as page/src/press.js
KINDS = ("click", "drag", "flick", "tap")
DURATION = {"click": 1.0, "drag": 1.4, "flick": 1.0, "tap": 0.5}  # [s]
DRAG_SPEED, FLICK_SPEED = 0.05, 0.5  # [m/s]
LEAST_FORCE = 1e-3  # [N] of a tool in contact
DATA_INTERVAL = 2e-3  # [s] between frames of the full body


def hand(kind: str, time: float, along: Floats, normal: Floats, depth: float) -> Floats:
    """Return the way (3,) [m] of a hand from where the ball touches, at a time [s] from its click on."""
    approach = (GAP + depth) * math.exp(-time / APPROACH)
    height = approach - depth
    if kind == "tap" and time > 0.3:
        height += GAP * (time - 0.3) / 0.1
    side = 0.0
    if kind == "drag":
        side = DRAG_SPEED * max(time - 0.4, 0.0)
    if kind == "flick":
        side = FLICK_SPEED * min(max(time - 0.5, 0.0), 0.05)
    return height * normal + min(side, 0.03) * along


def press(session: Session, touch: Floats, normal: Floats, along: Floats, radius: float, kind: str) -> Any:
    """Press along a path in real time; return times, positions of the ball, forces and bounds of the readings."""
    depth, sequence, rows = min(DEPTH_SHARE * radius, 0.01), 1, []
    message = {"index": 0, "quaternion": [1, 0, 0, 0], "friction": 0.0, "stiffness": None}
    sizes = dict.fromkeys(tool_parameters(), radius)
    start = touch + hand(kind, 0.0, along, normal, depth)
    session.handle({"type": "tool", "kind": "sphere", **sizes, **message, "position": list(start), "sequence": 1})
    began, sent = time.monotonic(), 0.0
    first = session.engine.read().time
    while (now := time.monotonic() - began) < DURATION[kind]:
        if now >= sent:
            sent, sequence = sent + FRAME, sequence + 1
            position = touch + hand(kind, now, along, normal, depth)
            session.handle({"type": "pose", **message, "position": list(position), "sequence": sequence})
        reading = session.engine.read()
        tool = reading.tools[0]
        rows.append((reading.time - first, *(start + tool.position), *tool.force, tool.force_bound, reading.trust))
        time.sleep(SAMPLE)
    session.release(0)
    session.reset()
    table = np.array(rows)
    return table[np.concatenate([[True], np.diff(table[:, 0]) > 0])]


def compared(scene: Any, table: Floats, radius: float) -> dict[str, float]:
    """Return how the force of the full body on the same path is in the bounds of a press."""
    times, positions = table[:, 0] - table[0, 0], table[:, 1:4]
    path = PchipInterpolator(times, positions)
    ball = pt.tools.Contact(pt.tools.Sphere(radius), lambda t: path(np.clip(t, 0.0, times[-1])), name="tool")
    full = pt.rollout(
        scene.body, [ball, *scene.foundations], duration=times[-1], every=DATA_INTERVAL, progress=False
    )  # fmt: skip
    forces = np.stack([np.interp(full.times, times, table[:, 4 + k]) for k in range(3)], axis=1)
    # the force of a frame of the run is the mean since the one before
    means = 0.5 * (forces[1:] + forces[:-1])
    errors = np.linalg.norm(means + full.reactions["tool"][1:], axis=1)  # that on the hand, and on the body
    bounds = table[np.searchsorted(times, full.times[1:]).clip(max=len(times) - 1), 7]
    touching = np.linalg.norm(full.reactions["tool"][1:], axis=1) > LEAST_FORCE
    sizes = np.linalg.norm(table[:, 4:7], axis=1)
    in_contact = sizes > LEAST_FORCE
    known = touching & np.isfinite(bounds)
    return {
        "in_contact": float(in_contact.mean() * times[-1]),
        "known": float(np.isfinite(table[in_contact, 7]).mean()) if in_contact.any() else math.nan,
        "largest_trust": float(table[:, 8].max()), "largest_force": float(sizes.max()),
        "largest_error": float(errors[touching].max(initial=0.0)),
        "over_bound": float((errors[known] / bounds[known]).max(initial=0.0)),
        "mean_bound": float(bounds[known].mean()) if known.any() else math.nan,
    }  # fmt: skip


def study(name: str, scene: Any, model: pt.ReducedModel, count: int, seed: int) -> dict[str, Any]:
    """Press a model along paths; return the figures of each, and those of all."""
    paths, radius = scene.tool_paths(), scene.description.tool.radius or scene.tool_paths().radius
    session, rows = Session(model, name), []
    session.start()
    try:
        for k in range(count):
            random = np.random.default_rng(seed + k)
            node = int(random.choice(np.flatnonzero(paths.reachable)))
            normal = paths.normals[node]
            touch = paths.surface.points[node] + paths.heights[node] * normal
            along = np.cross(normal, random.normal(size=3))
            along /= np.linalg.norm(along)
            kind = KINDS[k % len(KINDS)]
            table = press(session, touch, normal, along, radius, kind)
            rows.append({"kind": kind, **compared(scene, table, radius)})
            print(
                ", ".join(f"{key} {value:.3g}" if key != "kind" else value for key, value in rows[-1].items()),
                flush=True,
            )
    finally:
        session.close()
    touched = [row for row in rows if row["in_contact"] > 0]
    time_in_contact = sum(row["in_contact"] for row in touched)
    return {
        "scene": name, "nodes": len(scene.body.cloud), "paths": rows,
        "known": sum(row["in_contact"] * row["known"] for row in touched) / time_in_contact,
        "kept": float(np.mean([row["over_bound"] <= 1.0 for row in touched])),
        "level": model.report.get("held_out", {}).get("expected_error", {}).get("level"),
    }  # fmt: skip


def main() -> None:
    """Press one scene, and print or keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--set", nargs="+", default=[], dest="settings")
    parser.add_argument("--paths", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--model", help="trained model of the scene; by default trained as for view")
    parser.add_argument("--keep", action="store_true")
    options = parser.parse_args()
    scene = pt.open_scene(options.scene, parse_settings(options.settings))
    model = pt.load(options.model) if options.model else trained_model(scene, Console())
    found = study(options.scene, scene, model, options.paths, options.seed)
    print(f"bound finite in {found['known']:.1%} of the time in contact; kept in {found['kept']:.1%} of the paths")
    if options.keep:
        others = [row for row in result_files.read("hand", []) if row["scene"] != found["scene"]]
        result_files.write("hand", [*others, found])


if __name__ == "__main__":
    main()
