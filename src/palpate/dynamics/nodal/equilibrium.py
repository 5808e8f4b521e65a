"""Static equilibrium of a full model: displacements at which internal forces and loads balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from palpate.compiled.threads import check_process
from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import DivergenceError, InputError, brief, check_call, integer_in_range, number_in_range
from palpate.core.files import check_ending
from palpate.dynamics.contact.tools import Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import Load, check_kinds, listed
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.nodal.equilibrium_residual import EquilibriumResidual
from palpate.dynamics.nodal.mixed_newton import MixedNewton
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.model import BODY_ENDINGS, State, initial_field
from palpate.dynamics.run.partition import active_partitions
from palpate.dynamics.run.reactions import group_forces

MIN_TOLERANCE, MAX_TOLERANCE = 1e-10, 1e-2
PERMITTED_LOADS = (DeadLoad, Pressure, Gravity, PrescribedMotion, Grasp, Foundation)


@dataclass(frozen=True)
class Equilibrium(Described):
    """A static equilibrium.

    Parameters
    ----------
    displacements : (n, 3) array [m]
        Start of a run from equilibrium, ``rollout(displacement=...)``.
    residual : float
        Norm of the unbalanced nodal forces, over that of the loads and the forces on constrained nodes.
    iterations : int
        Steps of Newton's method.
    strain_energy : float [J]
    reactions : mapping of group name to (3,) array [N]
        Force of every support and prescribed group on the body.
    model : NodalModel
        The body.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> weight = pt.equilibrium(bar, [pt.Gravity()])
    >>> weight.displacements.shape, bool(weight.residual < 1e-6)
    ((112, 3), True)
    """

    displacements: Floats
    residual: float
    iterations: int
    strain_energy: float
    reactions: dict[str, Floats]
    model: NodalModel

    def _facts(self) -> list[Fact]:
        return [
            ("largest displacement", float(np.linalg.norm(self.displacements, axis=1).max(initial=0.0)), "m"),
            ("nodes", len(self.displacements), ""),
            ("residual", float(self.residual), ""),
            ("iterations", self.iterations, ""),
            ("strain energy", float(self.strain_energy), "J"),
            *((f"force of {name!r}", force, "N") for name, force in self.reactions.items()),
        ]

    def plot(self, what: str = "displacement", axes: Any = None) -> Any:
        """Draw the deformed body, coloured by a quantity; see `palpate.typing.Model.plot`."""
        return self.model.plot(what, axes, displacements=self.displacements)

    def to_pyvista(self) -> Any:
        """Return the body as a mesh of pyvista; see `palpate.typing.Model.to_pyvista`."""
        return self.model.to_pyvista(self.displacements)

    def save(self, path: str | Path) -> None:
        """Write displacement, stress and pressure to a file for ParaView, ``.vtkhdf``; see `palpate.save`."""
        check_ending(path, BODY_ENDINGS, "path of an equilibrium", required=True)
        self.model.write_surface(Path(path), self.displacements)


@check_call
def equilibrium(
    model: NodalModel,
    loads: Load | Sequence[Load] = (),
    *,
    time: float = 0.0,
    displacement: Floats | None = None,
    tolerance: float = 1e-6,
    max_iterations: int = 200,
) -> Equilibrium:
    """Find displacements of a full model at which its internal forces and the loads balance.

    Fixed nodes do not move, and prescribed ones are at their displacements of the given time. Relaxing
    tissue is fully relaxed. A body may have several equilibria; the one found depends on `displacement`.

    Parameters
    ----------
    model : NodalModel
        `Solid` or `Membrane`.
    loads : load or sequence of loads
        All but `Contact`. The dashpots of a `Foundation` have no force at rest.
    time : float [s]
        Time at which the loads are taken.
    displacement : (n, 3) array, optional [m]
        Displacements to start from, such as those of a smaller load; zero by default.
    tolerance : float
        Largest residual, relative to the forces of loads and constraints.
    max_iterations : int
        Largest number of steps of Newton's method, of all increments of the load.

    Returns
    -------
    Equilibrium

    Raises
    ------
    DivergenceError
        No equilibrium was found. The message says how much of the load was in equilibrium.
    InputError
        The model is not a full model, a load is a `Contact`, nothing supports the body, or another
        argument is out of range.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=(0.2, 0, 0))
    >>> rest = pt.equilibrium(bar, [pull])
    >>> float(rest.reactions["x-"][0].round(4))
    -0.2
    """
    if not isinstance(cast(object, model), NodalModel):
        raise InputError(f"model must be a Solid or a Membrane, got {brief(model)}; use rollout for reduced models")
    time = number_in_range("time", time, unit="s")
    number_in_range("tolerance", tolerance, MIN_TOLERANCE, MAX_TOLERANCE)
    integer_in_range("max_iterations", max_iterations, 1)
    check_process()
    loads = listed(loads)
    check_kinds(loads, PERMITTED_LOADS, "loads of equilibrium")
    start = initial_field("displacement", displacement, len(model.cloud))
    with np.errstate(all="ignore"):  # trial states may have no energy
        equations = EquilibriumResidual(model, model.prepare(loads), time, start)
        newton = MixedNewton(equations, tolerance, max_iterations)
        try:
            u = newton.run()
        except DivergenceError as error:
            loose = model.loose_nodes
            if not len(loose):
                raise
            raise DivergenceError(
                f"no equilibrium was found: a cut has parted {len(loose)} nodes from all supports, the first at "
                f"{model.cloud.points[loose[0]]} m, and nothing holds them; "
                "cut with detached='remove', or support them"
            ) from error
        energy = model.strain_energy(u, equations.history(u))
        return Equilibrium(u, newton.residual, newton.iterations, energy, _reactions(equations, u), model)


def _reactions(equations: EquilibriumResidual, u: Floats) -> dict[str, Floats]:
    """Return the force (3,) [N] of every active support on the body, as `palpate.dynamics.run.reactions` at rest."""
    model, prepared = equations.model, equations.prepared
    supports, parts = active_partitions(model.cloud.points, prepared, equations.time)
    if not supports:
        return {}
    still = np.zeros_like(u)
    external = model.external_force(State(u, still, equations.time), prepared)
    fields = model.nodal_fields(u, still, still, external, equations.history(u))
    stress = None if fields.stress is None else fields.stress()
    return dict(zip(supports, group_forces(model, parts, fields.unbalanced, stress), strict=True))
