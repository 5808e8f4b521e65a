"""Layout of the compiled passes of a solid: stencils in lanes, constants and scratch arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from palpate.compiled.lanes import gather_rows, lane_table, transpose
from palpate.compiled.passes import Formulation
from palpate.compiled.rows import Rows, row_table
from palpate.core.arrays import Floats
from palpate.dynamics.material.fibres import fibre_points, lay_out_fibres
from palpate.dynamics.material.material_fields import NO_FIELDS, spread
from palpate.dynamics.material.relaxation import relaxation
from palpate.dynamics.material.tissue import TissueField
from palpate.dynamics.solid.energy_form import EnergyBody, SmoothingSums, energy_work, solid_energy
from palpate.dynamics.solid.strong_form import Body, solid, workspace
from palpate.meshfree.mirror import Images, Mirror
from palpate.meshfree.stencils import Stencils
from palpate.tissue.materials import Material

# modulus of the hourglass residual, in shear moduli over the spacing squared: of lattices, and of other clouds
# (docs/claims/frequencies.md, elements.md)
LATTICE_HOURGLASS, HOURGLASS_MODULUS = 1.0, 4.0


class CompiledForm(NamedTuple):
    """Compiled passes of a body with their arrays."""

    formulation: Formulation
    body: Any  # constants of the passes
    allocate: Callable[[], Any]  # returns new scratch arrays of the passes
    lanes: Any


def strong_passes(
    images: Images, material: Material, stencils: Stencils, smoother: Stencils, half_cell: float
) -> tuple[CompiledForm, Stencils]:
    """Lay out the passes of the strong form, for stencils of a cloud with its images; return the part's own, too."""
    n, (mirror, of_part) = images.nodes, images.own(stencils)
    lanes, (first, second) = lane_table(of_part.neighbours, of_part.row, of_part.first, of_part.second)
    boundary = half_cell * images.cloud.boundary_vectors()[:n]
    if len(mirror.source):
        near, weights, itself = images.folded(
            smoother.neighbours, smoother.value[smoother.row], smoother.own[smoother.row]
        )
        smooth_lanes, (value,) = lane_table(near, np.arange(n), weights)
    else:
        smooth_lanes, (value,) = lane_table(smoother.neighbours, smoother.row, smoother.value)
        itself = smoother.own[smoother.row]
    body = Body(
        lanes=lanes,
        first=first,
        second=second,
        smoothing=smooth_lanes,
        value=value,
        own=np.ascontiguousarray(itself),
        boundary=np.ascontiguousarray(boundary[lanes.nodes].transpose(0, 2, 1)),
        coefficients=material.coefficients,
        lame=material.lame,
        mirror=mirror,
    )
    longest = int(max(np.max(lanes.stop - lanes.start), np.max(smooth_lanes.stop - smooth_lanes.start)))
    threads = numba.config.NUMBA_NUM_THREADS
    allocate = partial(workspace, n, len(lanes.nodes), longest, threads, len(mirror.source))
    return CompiledForm(solid(material.law, material.volumetric), body, allocate, lanes), of_part


class Smoothing(NamedTuple):
    """Smoothing of nodal scalars: neighbours (n, k), their weights (n, k) and the node's own (n,)."""

    neighbours: NDArray[np.int32]
    weights: Floats
    own: Floats


def energy_passes(
    images: Images, tissue: TissueField, stencils: Stencils, smoothing: Smoothing, volumes: Floats, is_lattice: bool
) -> tuple[CompiledForm, Stencils]:
    """Lay out the passes of the energy form, for stencils of a cloud with its images.

    The returned stencils are those of the part, with the images as `compiled.body.mirror` numbers them.
    """
    material, regions = tissue.material, tissue.regions
    mirror, own_stencils = images.own(stencils)
    n, row, rows = images.nodes, own_stencils.row, np.arange(images.nodes)
    both = np.concatenate([stencils.first, stencils.value[:, :, None]], axis=2)
    lanes = row_table(own_stencils.neighbours, row, both)
    flux_mirror, transposed = _transposed(own_stencils.neighbours, mirror, both[row], volumes)
    smooth_lanes, (value,) = lane_table(smoothing.neighbours, rows, smoothing.weights)
    back, weights = transpose(smoothing.neighbours, smoothing.weights[:, :, None], volumes)
    back_lanes, (back_value,) = lane_table(back, rows, weights)
    used = np.unique(stencils.neighbours[:n][stencils.neighbours[:n] >= n])
    places = images.cloud.points[np.concatenate([np.arange(n), used])]
    anchors = _anchors(places[:n])
    modulus = LATTICE_HOURGLASS if is_lattice else HOURGLASS_MODULUS
    body = EnergyBody(
        lanes=lanes,
        transposed=transposed,
        smoothing=SmoothingSums(smooth_lanes, value, smoothing.own, back_lanes, back_value),
        coefficients=material.coefficients if regions is None else spread(regions, lanes.nodes),
        lame=tissue.lame,
        hourglass=modulus * material.shear_modulus / images.cloud.spacing**2,
        relaxation=relaxation(material),
        stiffness=np.zeros((0, 3)) if tissue.uniform else np.ascontiguousarray(tissue.factors),
        families=lay_out_fibres(tissue.fibres, lanes.nodes),
        mirror=mirror,
        flux_mirror=flux_mirror,
        places=places - places[anchors[0]],
        anchors=anchors,
        inverse=np.linalg.pinv(places[anchors[1:]] - places[anchors[0]]).T.copy(),
    )
    branches = len(body.relaxation.times)
    threads, form = numba.config.NUMBA_NUM_THREADS, material.volumetric
    allocate = partial(
        energy_work, n, len(lanes.nodes), threads, branches, form, (len(mirror.source), len(flux_mirror.source))
    )
    varied = NO_FIELDS if regions is None else len(material.coefficients)
    formulation = solid_energy(material.law, form, fibre_points(tissue.fibres), varied, branches > 0)
    return CompiledForm(formulation, body, allocate, lanes), own_stencils


def _anchors(points: Floats) -> NDArray[np.int64]:
    """Return four nodes that span a body: the middle one, and three that are far from the others."""
    anchors = [int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    left = points - points[anchors[0]]
    for _ in range(3):  # the node farthest from the affine space of the others (QR with pivoting)
        anchors.append(int(np.argmax(np.linalg.norm(left, axis=1))))
        axis = left[anchors[-1]] / max(float(np.linalg.norm(left[anchors[-1]])), np.finfo(float).tiny)
        left = left - np.outer(left @ axis, axis)
    return np.array(anchors)


def _transposed(near: NDArray[np.int32], mirror: Mirror, weights: Floats, volumes: Floats) -> tuple[Mirror, Rows]:
    """Return the transposed stencils of nodes: what each receives from the fluxes of nodes and reflected fluxes.

    A stencil that contains the image of a node moves this node by the reflected flux. Of the neighbours `near` (n, k)
    numbers from n on are images of the mirror; the weights are (n, k, w), the volumes (n,).
    """
    n = len(near)
    node, place = np.nonzero(near != np.arange(n)[:, None])
    other, outgoing = near[node, place], weights[node, place]
    if not len(mirror.source):
        back, values = gather_rows(node, other, outgoing, volumes)
        return mirror, row_table(back, np.arange(n), values, -weights.sum(axis=1))
    receiver = np.concatenate([np.arange(n), mirror.source])[other]
    turns, kind = np.unique(mirror.reflection.reshape(-1, 9), axis=0, return_inverse=True)
    kind = np.concatenate([np.full(n, -1), kind.ravel()])[other]
    pairs, number = np.unique(np.stack([kind, node], axis=1)[kind >= 0], axis=0, return_inverse=True)
    name = node.copy()
    name[kind >= 0] = n + number.ravel()
    back, values = gather_rows(node, receiver, outgoing, volumes, name)
    reflected = Mirror(pairs[:, 1].copy(), np.ascontiguousarray(turns[pairs[:, 0]].reshape(-1, 3, 3)))
    return reflected, row_table(back, np.arange(n), values, -weights.sum(axis=1))
