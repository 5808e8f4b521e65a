"""Layout of the compiled passes of a solid: stencils in lanes, constants and scratch arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.compiled.lanes import lane_table, transpose
from palpate.dynamics.compiled.passes import Formulation
from palpate.dynamics.compiled.rows import row_table
from palpate.dynamics.material.fibres import fibre_points, lay_out_fibres
from palpate.dynamics.material.material_fields import EVERYWHERE, spread
from palpate.dynamics.material.relaxation import relaxation
from palpate.dynamics.material.tissue import Tissue
from palpate.dynamics.solid.energy_form import EnergyBody, energy_work, solid_energy
from palpate.dynamics.solid.strong_form import Body, solid, workspace
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.quadrature import conservative_smoothing
from palpate.meshfree.stencils import Stencils
from palpate.tissue.materials import Material

__all__ = ["CompiledForm", "energy_passes", "strong_passes"]

HOURGLASS = 1.0  # modulus of the hourglass residual, in shear moduli over the spacing squared


class CompiledForm(NamedTuple):
    """Compiled passes of a body with their arrays.

    Parameters
    ----------
    formulation : Formulation
    body : NamedTuple
        Constants of the passes.
    allocate : function
        Returns new scratch arrays of the passes.
    lanes : Lanes or Rows
    """

    formulation: Formulation
    body: Any
    allocate: Callable[[], Any]
    lanes: Any


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
    allocate = partial(workspace, len(cloud), len(lanes.nodes), longest, numba.config.NUMBA_NUM_THREADS)
    return CompiledForm(solid(material.law, direct, material.volumetric), body, allocate, lanes)


def energy_passes(
    cloud: Cloud, tissue: Tissue, stencils: Stencils, smoother: Stencils, volumes: Floats
) -> tuple[CompiledForm, Floats]:
    """Lay out the passes of the energy form; return them and the smoothing weights (n, w)."""
    material, regions = tissue.material, tissue.regions
    row, first, residual = stencils.row, stencils.first, stencils.value
    both, rows = np.concatenate([first, residual[:, :, None]], axis=2), np.arange(len(cloud))
    lanes = row_table(stencils.neighbours, row, both)
    near, weights = transpose(stencils.neighbours, both[row], volumes)
    transposed = row_table(near, rows, weights, -both.sum(axis=1)[row])
    smoothing, own = conservative_smoothing(smoother, volumes)
    smooth_lanes, (value,) = lane_table(smoother.neighbours, rows, smoothing)
    near, weights = transpose(smoother.neighbours, smoothing[:, :, None], volumes)
    back_lanes, (back_value,) = lane_table(near, rows, weights)
    body = EnergyBody(
        lanes=lanes,
        transposed=transposed,
        smoothing=smooth_lanes,
        value=value,
        smoothing_own=own,
        transposed_smoothing=back_lanes,
        transposed_value=back_value,
        coefficients=material.coefficients if regions is None else spread(regions, lanes.nodes),
        lame=tissue.lame,
        hourglass=HOURGLASS * material.shear_modulus / cloud.spacing**2,
        relaxation=relaxation(material),
        stiffness=np.zeros((0, 3)) if tissue.uniform else np.ascontiguousarray(tissue.factors),
        families=lay_out_fibres(tissue.fibres, lanes.nodes),
    )
    branches = len(body.relaxation.times)
    threads, form = numba.config.NUMBA_NUM_THREADS, material.volumetric
    allocate = partial(energy_work, len(cloud), len(lanes.nodes), threads, branches, form)
    varied = EVERYWHERE if regions is None else len(material.coefficients)
    formulation = solid_energy(material.law, form, fibre_points(tissue.fibres), varied)
    return CompiledForm(formulation, body, allocate, lanes), smoothing
