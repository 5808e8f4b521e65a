"""Solids in the strong form: the equations of motion are collocated at the nodes, as in the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.nodal.model import History, NodalWork
from palpate.dynamics.nodal.stability import choose_stiffness_damping
from palpate.dynamics.run.model import Evaluation, State
from palpate.dynamics.run.reactions import NodalFields, tool_power
from palpate.dynamics.solid.base import STENCIL_SIZES, Choices, Solid
from palpate.dynamics.solid.energy import EnergySolid
from palpate.dynamics.solid.layout import strong_passes
from palpate.meshfree.stencils import moving_least_squares

HALF_CELL = 3.0  # default c of the half-cell balance


class StrongSolid(Solid):
    """A solid in the strong form (`palpate.dynamics.solid.strong_form`)."""

    form: ClassVar[str] = "strong"
    conservative = False
    coupled_by: ClassVar[tuple[str, ...]] = ("lanes", "smoothing", "lanes")  # the smoothed pressure is differentiated

    def _build(self, choices: Choices) -> None:
        cloud, tissue = self.cloud, self.tissue
        faces = np.unique(choices.images.cloud.face_nodes)
        self._face_nodes = faces[faces < len(cloud)]
        if self.material.prony is not None:
            raise InputError("prony of the material must be None; relaxation requires form='energy' and finite strain")
        if len(tissue.stiffness):
            raise InputError("stiffness must be None in the strong form; use form='energy'")
        if tissue.regions is not None:
            raise InputError("material must be one material in the strong form; use form='energy'")
        half_cell = HALF_CELL if choices.half_cell is None else choices.half_cell
        # the cloud's boundary vectors have c = 2
        self.half_cell = number_in_range("half_cell", half_cell, 1.0, 4.0) / 2
        self.volumes = cloud.volumes
        self.neighbours = STENCIL_SIZES[0] if choices.neighbours is None else choices.neighbours
        body = choices.images.cloud
        stencils = moving_least_squares(body.points, order=2, neighbours=self.neighbours, hidden=body.hidden)
        compiled, of_part = strong_passes(choices.images, self.material, stencils, choices.smoother, self.half_cell)
        self.mirror = compiled.body.mirror
        self._compile(*compiled)
        # the second derivatives are in the lanes; gradients of nodal fields require the others only
        empty = np.zeros((0, 0))
        self.stencils = replace(of_part, second=empty[:, :, None], value=empty)
        self._set_stability(choose_stiffness_damping(self, choices.stiffness_damping, self.neighbours))

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product of virtual work, shape (n,).

        They are the cloud's volumes, times 2/c at the boundary, where a traction is multiplied by c/h
        instead of the half cell's 2/h.
        """
        weights = self.cloud.volumes.copy()
        weights[self._face_nodes] /= self.half_cell
        return weights

    def energy_form(self) -> EnergySolid:
        return EnergySolid(
            self.cloud,
            self.material,
            self.supports,
            stiffness_damping=self.stiffness_damping,
            mass_damping=self.mass_damping,
            neighbours=self.neighbours,
        )

    # reactions follow from the stress, because the collocated forces are not the derivative of an energy

    def with_internal_forces(
        self, fields: NodalFields, internal: Callable[[], Floats], stress: Callable[[], Floats]
    ) -> NodalFields:
        return fields._replace(stress=stress)

    def tool_work(
        self, summed: float, duration: float, prepared: PreparedLoads, states: tuple[State, State],
        fields_of: Callable[[State], NodalFields],
    ) -> float:  # fmt: skip
        if not prepared.motions:
            return summed
        power = sum(tool_power(self, fields_of(state), state, prepared) for state in states)
        return 0.5 * duration * power  # trapezium rule

    def _bonded_nodes(self, prepared: PreparedLoads) -> int:
        return 0

    def evaluate(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> Evaluation:
        work = self.workspace() if work is None else work
        force, F = self.force(displacements, history, work), self.deformation_gradient(displacements)
        smooth = work.passes.smooth[: len(force)]
        change = (smooth - work.passes.pressure)[:, None, None] * self.material.cofactor(F)
        return Evaluation(force, self.material.stress(F) + change, smooth.copy(), self.material.strain_energy(F))
