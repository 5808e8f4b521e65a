"""Layout of the compiled passes of a solid: stencils in lanes, constants and scratch arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.compiled.lanes import Lanes, lane_table, transpose
from palpate.dynamics.compiled.passes import Formulation
from palpate.dynamics.material.fibres import fibre_points, lay_out_fibres
from palpate.dynamics.material.material_fields import EVERYWHERE, spread
from palpate.dynamics.material.relaxation import relaxation
from palpate.dynamics.solid.energy_form import EnergyBody, energy_work, solid_energy
from palpate.dynamics.solid.strong_form import Body, solid, workspace
from palpate.faults import InputError, number_in_range
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.quadrature import conservative_smoothing
from palpate.meshfree.stencils import Stencils
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material
from palpate.tissue.regions import Regions

__all__ = ["CompiledForm", "EnergyTissue", "energy_passes", "nodal_stiffness", "strong_passes"]

HOURGLASS = 1.0  # modulus of the hourglass residual, in shear moduli over the spacing squared


class CompiledForm(NamedTuple):
    """Compiled passes of a body with their arrays.

    Parameters
    ----------
    formulation : Formulation
    body, work : NamedTuples
        Constants and scratch arrays of the passes.
    lanes : Lanes
    """

    formulation: Formulation
    body: Any
    work: Any
    lanes: Lanes


@dataclass(frozen=True)
class EnergyTissue:
    """Material of a solid in the energy form.

    Parameters
    ----------
    material : Material
    regions : Regions or None
    stiffness : (n, 3) array
        Stiffness factors of the law, of the hourglass residual and of the volume; empty if all are 1.
    lame : float [Pa]
        Unit of the nodal volumetric coefficients.
    fibres : FibreLaw or None
    """

    material: Material
    regions: Regions | None
    stiffness: Floats
    lame: float
    fibres: FibreLaw | None


def strong_passes(
    cloud: Cloud, material: Material, stencils: Stencils, smoother: Stencils, half_cell: float, direct: bool
) -> CompiledForm:
    """Lay out the passes of the strong form."""
    lanes, (first, second) = lane_table(stencils.neighbours, stencils.row, stencils.first, stencils.second)
    smooth_lanes, (value,) = lane_table(smoother.neighbours, smoother.row, smoother.value)
    body = Body(
        lanes=lanes,
        first=first,
        second=second,
        smoothing=smooth_lanes,
        value=value,
        own=np.ascontiguousarray(smoother.own[smoother.row]),
        boundary=np.ascontiguousarray(half_cell * cloud.boundary_vectors()[lanes.nodes].transpose(0, 2, 1)),
        coefficients=material.coefficients,
        lame=material.lame,
    )
    longest = int(max(np.diff(lanes.start).max(), np.diff(smooth_lanes.start).max()))
    work = workspace(len(cloud), len(lanes.nodes), longest, numba.config.NUMBA_NUM_THREADS)
    return CompiledForm(solid(material.law, direct, material.volumetric), body, work, lanes)


def energy_passes(
    cloud: Cloud, tissue: EnergyTissue, stencils: Stencils, smoother: Stencils, volumes: Floats
) -> tuple[CompiledForm, Floats]:
    """Lay out the passes of the energy form; return them and the smoothing weights (n, w)."""
    material, regions = tissue.material, tissue.regions
    row, first, residual = stencils.row, stencils.first, stencils.value
    lanes, (first_weights, residual_weights) = lane_table(stencils.neighbours, row, first, residual)
    both = np.concatenate([first, residual[:, :, None]], axis=2)[row]
    near, weights = transpose(stencils.neighbours, both, volumes)
    rows = np.arange(len(cloud))
    transposed, (back,) = lane_table(near, rows, weights)
    smoothing, own = conservative_smoothing(smoother, volumes)
    smooth_lanes, (value,) = lane_table(smoother.neighbours, rows, smoothing)
    near, weights = transpose(smoother.neighbours, smoothing[:, :, None], volumes)
    back_lanes, (back_value,) = lane_table(near, rows, weights)
    body = EnergyBody(
        lanes=lanes,
        first=first_weights,
        second=residual_weights,
        transposed=transposed,
        back=back,
        own=-both.sum(axis=1),
        smoothing=smooth_lanes,
        value=value,
        smoothing_own=own,
        transposed_smoothing=back_lanes,
        transposed_value=back_value,
        coefficients=material.coefficients if regions is None else spread(regions, lanes.nodes),
        lame=tissue.lame,
        hourglass=HOURGLASS * material.shear_modulus / cloud.spacing**2,
        relaxation=relaxation(material),
        stiffness=tissue.stiffness,
        families=lay_out_fibres(tissue.fibres, lanes.nodes),
    )
    tables = (lanes, smooth_lanes, back_lanes)
    longest = int(max(*(np.diff(table.start).max() for table in tables), 4 * np.diff(transposed.start).max()))
    branches = len(body.relaxation.times)
    threads, form = numba.config.NUMBA_NUM_THREADS, material.volumetric
    work = energy_work(len(cloud), len(lanes.nodes), longest, threads, branches, form)
    varied = EVERYWHERE if regions is None else len(material.coefficients)
    formulation = solid_energy(material.law, form, fibre_points(tissue.fibres), varied)
    return CompiledForm(formulation, body, work, lanes), smoothing


def nodal_stiffness(cloud: Cloud, given: Mapping[str, float] | Floats | None) -> Floats:
    """Return the stiffness factors (n,) of the nodes; empty for None.

    Raises
    ------
    InputError
        A factor is not positive, a group is unknown, or the array has another shape.
    """
    if given is None:
        return np.zeros(0)
    if isinstance(given, Mapping):
        stiffness = np.ones(len(cloud))
        for group, value in given.items():
            stiffness[cloud.group(group)] = number_in_range(f"stiffness[{group!r}]", value, 0.0, open_low=True)
        return stiffness
    stiffness = np.array(given, dtype=float)
    if stiffness.shape != (len(cloud),) or not np.all(np.isfinite(stiffness) & (stiffness > 0)):
        raise InputError(f"stiffness must be {len(cloud)} positive numbers, one per node, got shape {stiffness.shape}")
    return stiffness
