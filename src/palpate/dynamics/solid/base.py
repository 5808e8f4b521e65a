"""The common base of solids: equations of motion at every node (sections 2.1 and 2.2, equations 1 to 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Fact
from palpate.core.faults import InputError, brief, integer_in_range, number_in_range
from palpate.dynamics.loads.prepared import Load, PreparedLoads, listed, prepare_loads
from palpate.dynamics.loads.supports import Support, supports_of, symmetry_planes
from palpate.dynamics.material.kinematics import Kinematics
from palpate.dynamics.material.tissue import tissue_of
from palpate.dynamics.nodal.energy_model import EnergyModel
from palpate.dynamics.nodal.model import History, NodalModel
from palpate.dynamics.run.model import QUANTITY_UNITS, State
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.cut.surface import NO_CUT, CutSurface
from palpate.meshfree.inversion import cells_between, inverted_share
from palpate.meshfree.mirror import Images, mirror_images
from palpate.meshfree.stencils import Stencils, moving_least_squares
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material

RECOVERY_NEIGHBOURS = 57  # points of the fit of the recovered pressure
STENCIL_SIZES = (42, 50, 63)  # default points in a stencil; the energy form tries them in turn


@dataclass(frozen=True)
class Choices:
    """Arguments of a solid for one of its forms; see `Solid`."""

    stiffness_damping: float | None
    half_cell: float | None
    neighbours: int | None
    images: Images
    smoother: Stencils  # of the body and its images


class Solid(NodalModel):
    """A hyperelastic solid with equations of motion collocated at the nodes.

    Parameters
    ----------
    cloud : Cloud
        In space (d = 3).
    material : Material, or mapping of str to Material, or sequence of n Materials
        One material for the body. The energy form supports materials of one law with different
        parameters by group (``""`` for all other nodes) or by node. A node's share of the volume has
        the node's material, so interfaces are midway between nodes.
    fixed : str, Support, or sequence of these
        Clamped groups (equation 5), and supports such as `Roller`; none for a free body.
    stiffness_damping : float, optional [s]
        Rayleigh stiffness damping beta of C = alpha M + beta K in (29). By default 0.1 over the highest frequency;
        in the strong form what the spectrum of the linearised body requires
        (`palpate.dynamics.nodal.stability`).
    mass_damping : float [1/s]
        Rayleigh mass damping alpha of C = alpha M + beta K: a free vibration decays as exp(-alpha t / 2). It does
        not shorten the stable step.
    form : str
        ``"energy"``: the nodal forces are the derivative of an energy summed over nodes
        (`palpate.dynamics.solid.energy_form`). It conserves energy, requires no damping, and is more
        accurate in bending. Hyper-reduction samples the same sum.
        ``"strong"``: the equations of motion are collocated at the nodes, as in the paper. The pressure
        is smoothed and differentiated separately, which neither locks nor loses stability up to a
        Poisson's ratio of 0.499.
    stiffness : mapping of str to float, or (n,) array, optional
        Stiffness factors of groups or of all nodes, in the energy form, such as a tumour in a liver.
    half_cell : float, optional
        The c of the strong form in the balance of a boundary node, rho a = Div P + c/h (f_s - P N). The
        half cell itself has c = 2. The default c = 3 cancels the leading error of one-sided quadratic fits (for u = z^3
        it is (6 - 2 c) h) and is more accurate in bending.
    neighbours : int, optional
        Target number of points in a stencil. By default 42; the energy form tries 50 and 63 where 42
        are too few, as in a thin tip.
    smoothing : int
        Target number of points of the linear fit that smooths the pressure.
    fibres : FibreLaw, optional
        Fibre reinforcement in the energy form (`palpate.materials.Fibres`, `palpate.materials.Guccione`).

    Raises
    ------
    InputError
        A group is unknown or a parameter is out of range.
    CloudError
        The cloud does not admit the stencils.

    Warns
    -----
    RuntimeWarning
        The stiffness damping makes the stable step more than ten times shorter.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> bar.stability.step < 1e-3, bar.stiffness_damping > 0
    (True, True)
    >>> stretched = 1.1 * cloud.points - cloud.points
    >>> float(bar.deformation_gradient(stretched)[0, 0, 0].round(6))
    1.1
    """

    name = "full"
    _title = "Solid"
    _public = (
        "cut_surface", "energy_form", "form", "neighbours", "recovered_pressure", "released_nodes", "removed_nodes",
    )  # fmt: skip
    forms: ClassVar[dict[str, type[Solid]]] = {}
    form: ClassVar[str]
    kinematics = Kinematics()
    neighbours: int
    _cut: Any = None  # `CutState` of a body that is cut

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        Solid.forms[cls.form] = cls

    def __new__(cls, *_: Any, form: str = "energy", **__: Any) -> Solid:
        if cls is not Solid:
            return super().__new__(cls)
        if form not in cls.forms:
            raise InputError(f"form must be 'strong' or 'energy', got {form!r}")
        return super().__new__(cls.forms[form])

    def __init__(
        self,
        cloud: Cloud,
        material: Material | Mapping[str, Material] | Sequence[Material],
        fixed: str | Support | Sequence[str | Support] = (),
        *,
        form: str = "energy",
        stiffness_damping: float | None = None,
        mass_damping: float = 0.0,
        stiffness: Mapping[str, float] | Floats | None = None,
        half_cell: float | None = None,
        neighbours: int | None = None,
        smoothing: int = 27,
        fibres: FibreLaw | None = None,
    ) -> None:
        if not isinstance(cast(object, cloud), Cloud):
            raise InputError(f"cloud must be a Cloud, got {brief(cloud)}; make one by box or fill")
        if cloud.points.shape[1] != 3:
            raise InputError("cloud of Solid must be in space (d = 3), got a plane cloud; use Membrane")
        self.cloud, self.tissue = cloud, tissue_of(cloud, material, stiffness, fibres, self.form)
        self.material, self.fibres = self.tissue.material, self.tissue.fibres
        self.supports = supports_of(fixed)
        if self.material.prony is not None and self.material.variables == "small strain":
            raise InputError("prony of the material must be None; relaxation requires form='energy' and finite strain")
        self.mass_damping = number_in_range("mass_damping", mass_damping, 0.0, unit="1/s")
        integer_in_range("smoothing", smoothing, 5)
        self.planes = symmetry_planes(cloud, self.supports)
        images = mirror_images(cloud, self.planes)
        smoother = _linear_fit(images.cloud, smoothing)
        self._build(Choices(stiffness_damping, half_cell, neighbours, images, smoother))

    def energy_form(self) -> EnergyModel:
        """Return the same body in the energy form: itself, or for the strong form another discretisation."""
        raise NotImplementedError

    def _build(self, choices: Choices) -> None:
        """Compute the stencils, compile the passes, and examine the stability."""
        raise NotImplementedError

    @property
    def cut_surface(self) -> CutSurface:
        """Triangles along which the body is cut (`palpate.cut`), and their fronts."""
        return NO_CUT if self._cut is None else self._cut.surface

    @property
    def released_nodes(self) -> Ints:
        """Nodes (r,) that slivers of a cut have released: they carry no force."""
        return np.zeros(0, dtype=np.int64) if self._cut is None else np.flatnonzero(self._cut.released)

    @property
    def removed_nodes(self) -> Ints:
        """Nodes (r,) of pieces that were cut off and removed; see ``detached`` of `palpate.cut`."""
        return np.zeros(0, dtype=np.int64) if self._cut is None else np.flatnonzero(self._cut.removed)

    def inverted_share(self, state: State) -> float:
        return 0.0 if self._cut is not None else inverted_share(self.cloud, self._cells, state.coordinates)

    @cached_property
    def _cells(self) -> Ints:
        return cells_between(self.cloud)

    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads:
        return self._press_supports(prepare_loads(self.cloud, self.supports, listed(loads)))

    def _own_facts(self) -> list[Fact]:
        report = self.stability
        return [("form", self.form, ""), ("status", report.status, ""), ("stable step", report.step, "s")]

    def deformation_gradient(self, displacements: Floats) -> Floats:
        """Return F = dx/dX of nodal displacements at every node, shape (n, 3, 3)."""
        return self.stencils.gradient(self.mirror.vectors(displacements)) + np.eye(3)

    def recovered_pressure(self, displacements: Floats, history: History = ()) -> Floats:
        """Return the pressure U'(J) [Pa] for display, shape (n,): a linear fit over about 57 nodes.

        It is positive for expansion. In nearly incompressible tissue the pressure in `stress` alternates
        between nodes, without effect on forces. Figures are in docs/claims/incompressibility.md.
        """
        pressure = self.evaluate(displacements, history).pressure
        return self._recovery.fit(pressure[self._images.source])[: len(pressure)]

    @cached_property
    def _images(self) -> Images:
        return mirror_images(self.cloud, self.planes)

    @cached_property
    def _recovery(self) -> Stencils:
        """Stencils of the recovered pressure, of the body and its images."""
        return _linear_fit(self._images.cloud, RECOVERY_NEIGHBOURS)

    @property
    def quantities(self) -> tuple[str, ...]:
        return tuple(QUANTITY_UNITS)

    def cauchy_stress(self, displacements: Floats, history: History = ()) -> Floats:
        """Return the Cauchy stress [Pa] at every node, shape (n, 3, 3)."""
        F = self.deformation_gradient(displacements)
        return self.stress(displacements, history) @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None]


def _linear_fit(cloud: Cloud, neighbours: int) -> Stencils:
    return moving_least_squares(cloud.points, order=1, neighbours=neighbours, interpolating=False, hidden=cloud.hidden)
