"""Map of a hand's motion to that of a tool: scale, rotation, and an anchor that a clutch moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.app.common.rotations import compose_rotations
from palpate.core.arrays import Floats

NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Anchor:
    """A pose of the hand, in the device's frame, and the pose of the tool that belongs to it, in the body's."""

    hand: Floats  # (3,) array [m]
    turn: Floats  # (4,) array: rotation of the grip
    position: Floats  # (3,) array [m]: of the tool
    quaternion: Floats  # (4,) array: of the tool


class HandMap:
    """Map of a hand's pose to a tool's: scaled displacements and rotations relative to an anchor."""

    def __init__(self, scale: float, rotation: Sequence[Sequence[float]]) -> None:
        self.scale, self.rotation = scale, np.array(rotation, dtype=float)
        self._turn: Floats = Rotation.from_matrix(self.rotation).as_quat(scalar_first=True)

    def position(self, anchor: Anchor, hand: Floats) -> Floats:
        """Return the position (3,) [m] of the tool for one of the hand."""
        return anchor.position + self.scale * self.rotation @ (hand - anchor.hand)

    def quaternion(self, anchor: Anchor, turn: Floats) -> Floats:
        """Return the rotation (4,) of the tool for one of the grip."""
        if np.array_equal(turn, anchor.turn):
            return anchor.quaternion
        relative = compose_rotations(anchor.turn, turn, invert_first=True)
        in_body = compose_rotations(compose_rotations(self._turn, relative, invert_first=True), self._turn)
        return compose_rotations(anchor.quaternion, in_body)

    def force_on_hand(self, force: Floats) -> Floats:
        """Return a force (3,) in the device's frame."""
        return self.rotation.T @ force

    def stiffness_at_hand(self, stiffness: Floats) -> Floats:
        """Return a stiffness (3, 3) of the tool as the hand's: force on the hand by displacement of the hand."""
        return self.scale * self.rotation.T @ stiffness @ self.rotation
