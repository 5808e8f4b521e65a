"""Random paths of the tool of a scene: a ball and forceps that touch the body, or a tool that holds a group of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.membrane.model import Membrane
from palpate.meshfree.cloud import Cloud
from palpate.scenes.description import Tool, Training
from palpate.scenes.tool_paths import DRAW_SPEED, TOUCH_MOTIONS, TOUCH_TIME, ToolPaths

RADIUS_SHARE, DEPTH_SHARE, SLIDE_SHARE = 0.06, 0.07, 0.08  # of the body's length, where the scene gives none
MIN_RADIUS = 2.5  # [spacings] of the ball
MIN_DEPTH_RATIO = 0.3  # depth of the shallowest press over that of the deepest
SWINGS_PER_MOTION = 3  # in a motion of a held group
POSE_INTERVALS = 0.015, 0.02  # [s] between poses of a pointer
FAST_SPEED = 0.5  # [m/s] of a fast motion of a held group in a hand
HAND_DURATION = 1.5  # of a motion by hand over that of a smooth one
RETURN_TIME = 0.1  # [s] in which it returns, in the second half of its motion


def held_motion(training: Training, seed: int, duration: float, by_hand: bool = False) -> HeldMotion:
    """Return a motion of a tool that holds a group, smooth or by hand; raise `InputError` for swings of no size."""
    bounds = np.array([[*training.low, *training.low_turn], [*training.high, *training.high_turn]])
    if not np.all(bounds[0] <= bounds[1]) or not bounds.any():
        raise InputError("low of [training] must be at most high, and not all 0, for a tool that holds a group")
    return (HandMotion if by_hand else HeldMotion)(seed, duration, bounds)


def touching_paths(
    tool: Tool,
    training: Training,
    body: Any,
    others: Sequence[Load] = (),
    deepest: float = np.inf,
    shallowest: float = MIN_DEPTH_RATIO,
) -> ToolPaths:
    """Return the presses and grasps of a tool on the free surface of a body, or of a reduced model of it.

    `others` are further loads of every path. `deepest` [m] limits the depth; `shallowest` is the depth of the
    shallowest press over that of the deepest.
    """
    if isinstance(body, Membrane):
        raise InputError("holds of [tool] must be given for a membrane, got none; give holds, or hold_radius")
    length = float(np.ptp(body.cloud.points, axis=0).max())
    depth = DEPTH_SHARE * length if training.depth is None else training.depth
    fitting = max(RADIUS_SHARE * length, MIN_RADIUS * body.cloud.spacing)
    return ToolPaths(
        body,
        fitting if tool.radius is None else tool.radius,
        min(depth, deepest),
        tool.friction,
        SLIDE_SHARE * length if training.slide is None else training.slide,
        training.grasps,
        shallowest,
        others,
        training.pairs,
    )


@dataclass(frozen=True)
class HeldMotion:
    """Smooth random motion of a tool: a sum of swings out and back, with one to three periods in a motion."""

    seed: int
    duration: float  # [s]: period of the motion, at the ends of which the tool is at rest
    bounds: Floats  # (2, 6) array: least and largest displacement [m] and rotation vector [rad] of one swing

    @cached_property
    def sizes(self) -> Floats:
        """Displacement [m] and rotation vector [rad] of every swing, shape (SWINGS, 6)."""
        low, high = self.bounds
        return np.asarray(np.random.default_rng(self.seed).uniform(low, high, size=(SWINGS_PER_MOTION, 6)))

    def pose(self, time: float) -> tuple[Floats, Rotation]:
        """Return the displacement (3,) [m] of the tool's reference point and the rotation about it at a time [s]."""
        shares = np.sin(np.pi * np.arange(1, SWINGS_PER_MOTION + 1) * time / self.duration) ** 2
        moved = shares @ self.sizes
        return moved[:3], Rotation.from_rotvec(moved[3:])

    def __call__(self, time: float) -> tuple[Floats, Floats]:
        """Return the pose for `palpate.DummyDevice`: position [m] and quaternion, w x y z."""
        moved, turned = self.pose(time)
        return moved, np.roll(turned.as_quat(), 1)

    def load(self, cloud: Cloud, group: str) -> PrescribedMotion:
        """Return the motion as a load on the nodes of a group that the tool holds."""
        centre = np.zeros(3)
        centre[: cloud.points.shape[1]] = cloud.points[cloud.group(group)].mean(axis=0)

        def displacement(points: Floats, time: float) -> Floats:
            moved, turned = self.pose(time)
            arms = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))) - centre
            return np.asarray(moved + turned.apply(arms) - arms)

        return PrescribedMotion(group, displacement)


@dataclass(frozen=True)
class HandMotion(HeldMotion):
    """Motion of a hand at a pointer that moves a tool to the end of one swing, as the touches of `ToolPaths`.

    It goes there exponentially, at a slow or at a fast constant speed. In one of four motions it returns. Half of the
    motions rotate. A pointer sends some 60 poses a second at uneven times. The tool moves to each evenly, in the time
    since the pose before, and waits there if the next one is late.
    """

    @cached_property
    def knots(self) -> tuple[Floats, Floats]:
        """Times (k,) [s] between which the tool moves evenly, and the shares (k,) of the swing there."""
        random = np.random.default_rng([self.seed, SWINGS_PER_MOTION])
        kind = random.choice(TOUCH_MOTIONS)
        intervals = random.uniform(*POSE_INTERVALS, int(self.duration / POSE_INTERVALS[0]) + 2)
        sent = np.cumsum(intervals) - random.uniform(0.0, intervals[0])
        times, shares = [0.0], [0.0]
        for before, now, after in zip(intervals, sent, sent[1:], strict=False):
            wanted = self._share(kind, now)
            reached = min(now + before, after)
            last = shares[-1]
            times += [now, reached]
            shares += [last, last + (wanted - last) * (reached - now) / before]
        return np.array(times), np.array(shares)

    def _share(self, kind: str, time: float) -> float:
        """Return the share of the swing at which the pointer is at a time [s]."""
        if kind in ("draw", "flick"):
            length = max(float(np.linalg.norm(self.sizes[0, :3])), 1e-9)
            return min((DRAW_SPEED if kind == "draw" else FAST_SPEED) * time / length, 1.0)
        back = max(time - 0.5 * self.duration, 0.0) / RETURN_TIME if kind == "release" else 0.0
        return float((1.0 - np.exp(-time / TOUCH_TIME)) * max(1.0 - back, 0.0))

    @cached_property
    def swing(self) -> Floats:
        """Displacement [m] and rotation vector [rad] of the swing (6,)."""
        rotates = np.random.default_rng([self.seed, 6]).choice([0.0, 1.0])
        return np.concatenate([self.sizes[0, :3], rotates * self.sizes[0, 3:]])

    def pose(self, time: float) -> tuple[Floats, Rotation]:
        """Return the displacement (3,) [m] of the tool's reference point and the rotation about it at a time [s]."""
        moved = np.interp(time, *self.knots) * self.swing
        return moved[:3], Rotation.from_rotvec(moved[3:])
