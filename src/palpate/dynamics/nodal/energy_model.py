"""Bodies with an energy summed over points, and what their reduction requires of them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.dynamics.nodal.model import NodalModel

NO_FIELDS = slice(0, 0)


@dataclass(frozen=True)
class Fields:
    """Displacement fields and their derivatives at the points of an energy."""

    columns: Floats  # (m, n, 3) array: the fields
    # (p, m, 9) array: their derivatives, row by row of du/dX; in single precision where there are many
    gradients: Floats
    constant: Floats  # (m, m) array: stiffness of their hourglass residual
    nodes: NDArray[np.int64]  # (p,) int array: node of each point
    volumes: Floats  # (p,) array [m^3]: of the points, times the stiffness factor of the node

    def of(self, which: slice | NDArray[np.int64]) -> Fields:
        """Return a subset of the fields."""
        constant = self.constant[which][:, which]
        return Fields(self.columns[which], self.gradients[:, which], constant, self.nodes, self.volumes)


class EnergyModel(NodalModel):
    """A body whose nodal forces are the derivative of an energy summed over points.

    The points of a solid are its nodes. Those of a membrane are six about every node.
    """

    form: ClassVar[str] = "energy"
    conservative = True

    def energy_form(self) -> Self:
        return self

    @property
    def elastic_volumes(self) -> Floats:
        """Nodal volumes [m^3] times the stiffness factors, the weights of energies, shape (n,)."""
        return self.volumes * self.tissue.stiffness if len(self.tissue.stiffness) else self.volumes

    @property
    @abstractmethod
    def rest_moduli(self) -> tuple[Floats, Floats]:
        """Moduli [Pa] of the nodes' strain at rest and of its trace without the pressure, shapes (n,)."""

    @abstractmethod
    def inner_product(self) -> Callable[[Floats], Floats]:
        """Return A of the inner product u . A v of fields (b, n, 3) for the main modes of runs."""

    @abstractmethod
    def at_points(self, columns: Floats, even: slice = NO_FIELDS) -> Fields:
        """Return fields (m, n, 3) with their derivatives at all points.

        At planes of symmetry images continue the fields as reflections. `even` are the test fields of
        supports, which images continue as they are, so that they do not jump there.
        """

    @abstractmethod
    def shear_stress(self, F: Floats, nodes: NDArray[np.int64]) -> Floats:
        """Return the stress (p, 3, 3) [Pa] without the pressure, for F = I + du/dX (p, 3, 3) at points of nodes."""

    def pressure_moments(self, displacements: Iterable[Floats], count: int) -> Floats:
        """Return coefficients (k, n) of the nodal g(J) in the main modes of the pressures at displacements (n, 3).

        None for a body without a pressure, such as a sheet, whose thickness follows.
        """
        return np.zeros((0, len(self.cloud)))

    def _derivatives(self, columns: Floats, even: slice = NO_FIELDS) -> Iterator[Floats]:
        """Yield the nodal derivatives (n, numbers) of every field by the formulation."""
        blocks, lanes = self.body.lanes.nodes.shape
        numbers, passes = self.formulation.numbers, self.workspace().passes
        table, unchanged = np.zeros((blocks, 1, numbers, lanes)), range(len(columns))[even]
        for m, column in enumerate(columns):
            extended = self.mirror.scalars(column) if m in unchanged else self.mirror.vectors(column)
            self.formulation.differentiate(np.ascontiguousarray(extended[None]), self.body, passes, table)
            yield table[:, 0].transpose(0, 2, 1).reshape(-1, numbers)[self.slot]


def precision(points: int, count: int) -> Any:
    """Return the type of the derivatives of a number of fields at points: single precision where they are many."""
    return np.float64 if points * count < 2_000_000 else np.float32
