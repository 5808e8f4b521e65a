"""Surface forces: forces and moments on a face of a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described
from palpate.core.faults import InputError
from palpate.core.parameters import parameter
from palpate.dynamics.loads.dead_load import DeadLoad, ForcePattern
from palpate.dynamics.loads.values import Vector, check_vector, vectors_at
from palpate.meshfree.cloud import Cloud

AXES = "xyz"


@dataclass(frozen=True)
class SurfaceForce(Described, DeadLoad):
    """A force, a moment or both on the face of a group of nodes (equation 4), fixed in direction.

    On a membrane it is distributed over the flat edge of the group, or else over the areas of its
    nodes. `Pressure` follows the deformed face.

    Parameters
    ----------
    group : str
        Nodes of one face of the body.
    force : (3,) sequence, or function of time [s] that returns one, optional [N]
        Total force, distributed uniformly over the face's reference area.
    moment : (3,) sequence, or function of time [s] that returns one, optional [N m]
        Total moment about the centroid of the face's reference area. Its traction is
        c x (X - centroid) with one c for the face. Its resultant force is zero.

    Raises
    ------
    InputError
        Neither a force nor a moment is given, or a constant one is not three finite numbers.

    Examples
    --------
    >>> import palpate as pt
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (200 * min(t, 1 - t), 0, 0))
    >>> twist = pt.SurfaceForce("x+", moment=(0.005, 0, 0))
    >>> pull.group, twist.moment
    ('x+', (0.005, 0, 0))
    """

    group: str
    force: Vector | None = parameter("N", None, "total force")
    moment: Vector | None = parameter("N m", None, "total moment about the centroid of the face")

    def __post_init__(self) -> None:
        if self.force is None and self.moment is None:
            raise InputError(
                f"SurfaceForce on {self.group!r} must have a force [N] or a moment [N m], got neither; "
                "give one of them, or use Pressure for a pressure [Pa]"
            )
        for name in ("force", "moment"):
            check_vector(getattr(self, name), f"{name} of SurfaceForce on {self.group!r}")

    @property
    def labels(self) -> tuple[str, ...]:
        names = [name for name in ("force", "moment") if getattr(self, name) is not None]
        return tuple(f"{name} {axis}" for name in names for axis in AXES)

    def pattern(self, cloud: Cloud, areas: Floats) -> ForcePattern:
        nodes, shares = cloud.group(self.group), np.linalg.norm(areas, axis=1)
        shares /= shares.sum()
        forces = []
        if self.force is not None:
            forces.append(shares[:, None, None] * np.eye(3))
        if self.moment is not None:
            forces.append(self._moment_pattern(cloud.points[nodes], shares))
        return ForcePattern(nodes, np.concatenate(forces, axis=1))

    def amplitudes(self, times: Floats) -> Floats:
        parts = [(name, getattr(self, name)) for name in ("force", "moment") if getattr(self, name) is not None]
        values = [vectors_at(value, times, f"{name} of SurfaceForce on {self.group!r}") for name, value in parts]
        return np.hstack(values)

    def _moment_pattern(self, points: Floats, shares: Floats) -> Floats:
        """Return the nodal forces [N] of unit moments [N m] at points (g, d) [m], shape (g, 3, 3).

        With r_i = X_i - centroid and areas A_i, the forces A_i (c x r_i) have the moment I c,
        I = sum A_i (|r_i|^2 1 - r_i r_i^T).
        """
        arms = np.pad(points - shares @ points, ((0, 0), (0, 3 - points.shape[1])))
        crossed = np.cross(np.eye(3), arms[:, None])  # (g, 3, 3), row c is e_c x r_i
        inertia = np.einsum("g,gia,gja->ij", shares, crossed, crossed)
        smallest, _, largest = np.linalg.eigvalsh(inertia)
        if smallest <= 1e-9 * largest:
            raise InputError(
                f"group of SurfaceForce {self.group!r} must be a face for a moment, got nodes on one line or at one "
                "point; use another group"
            )
        return np.asarray(np.einsum("g,gia,ij->gja", shares, crossed, np.linalg.inv(inertia)))
