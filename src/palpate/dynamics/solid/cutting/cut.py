"""Cuts of a body in the energy form: a body that shares all that a cut does not change.

A piece is a set of nodes that bonds connect, also those of the smoothing. No bond connects two pieces, so that the
others keep their stencils when one is removed. Its nodes stay in all arrays. They leave all stencils, are held at their
places in the stress-free body, and no tool reaches them.
"""

from __future__ import annotations

import warnings
from copy import copy
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from palpate.core.arrays import Floats
from palpate.core.faults import CloudError, InputError, brief
from palpate.dynamics.loads.supports import FIXED
from palpate.dynamics.material.fibres import tension_compression_fibres
from palpate.dynamics.solid.base import Solid
from palpate.dynamics.solid.cutting.layout import Entries, fitted_entries, row_entries, smoothing_entries, with_stencils
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.cut.clipping import clipped, off_surface
from palpate.meshfree.cut.consistency_correction import conserve_integrals, keep_uniform_stress
from palpate.meshfree.cut.diffraction_lengths import MAX_WAY
from palpate.meshfree.cut.face_points import face_points, no_face_points
from palpate.meshfree.cut.points import inside_body
from palpate.meshfree.cut.stencils import (
    RELEASED_FIT,
    CutState,
    FittedRows,
    fit_rows,
)
from palpate.meshfree.cut.surface import NO_CUT, CutSurface, changed_spheres, cut_surface, nodes_near
from palpate.meshfree.cut.uncut import uncut_stencils
from palpate.meshfree.inner_gradient import inner_nodes
from palpate.meshfree.surface_gradient import surface_forms

KEEP_PIECES, REMOVE_PIECES = "keep", "remove"
COMPUTED_NAMES = (  # attributes of a body that follow from its constants
    "stencils", "smoothing", "patches", "contact_edges", "stability", "_recovery", "free_directions", "step_body",
)  # fmt: skip
MAX_ROUNDS = 20  # of releases of nodes
MAX_RESIDUAL = 1e-6  # of the uniform stress along a cut and of the integrals that are kept, relative to a node's


def cut(body: Solid, triangles: Any, *, detached: str = KEEP_PIECES) -> Solid:
    """Return a body that is cut along triangles, in addition to its present cut.

    Nodes, volumes and masses stay. Stencils of nodes near the triangles go round the fronts of the cut, or end at its
    faces (`palpate.meshfree.cut.stencils`). A state of `body` is one of the cut body: a run goes on from it. Extend
    triangles beyond the surface where the cut shall open it, and advance a front by at most a quarter of the spacing
    at a time, for its energy release to be that of the tissue.

    Parameters
    ----------
    body : Solid
        In the energy form, without planes of symmetry. It does not change.
    triangles : (t, 3, 3) array [m]
        Corners in the stress-free body. Neighbouring triangles share their corners.
    detached : str
        ``"keep"``: pieces that no support holds any more move freely. ``"remove"``: they leave the body, as released
        nodes of slivers do, and are `removed_nodes` of the result. They have no force, no motion and no contact, and
        are not drawn. All arrays keep their sizes. Of a body without supports the largest piece stays.

    Returns
    -------
    Solid
        Its `cut_surface` holds the triangles. It shares with `body` what the cut does not change.

    Raises
    ------
    InputError
        The body has another form or planes of symmetry, the triangles are not a finite array of that shape, or
        `detached` is another word.
    CloudError
        A triangle has no width, the surface of the body is not known, or stencils along the cut do not exist.

    Warns
    -----
    UserWarning
        The triangles part nothing: they are far from the body, or along its surface.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.0025)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> a, b, c, d = (0.014, -0.01, 0.008), (0.014, 0.04, 0.008), (0.014, 0.04, 0.02), (0.014, -0.01, 0.02)
    >>> opened = pt.cut(block, [(a, b, c), (a, c, d)])
    >>> parted = 0.001 * (cloud.points > 0.014) * (1, 0, 0)
    >>> opened.strain_energy(parted) < 0.8 * block.strain_energy(parted)
    True
    """
    if detached not in (KEEP_PIECES, REMOVE_PIECES):
        raise InputError(f"detached must be 'keep' or 'remove', got {brief(detached)}")
    solid: Any
    solid, corners = _checked(body, triangles)
    cloud = solid.cloud
    near = clipped(corners, cloud.points, cloud.spacing)
    areas = cloud.boundary_vectors() * cloud.volumes[:, None]
    near = off_surface(near, cloud.points, areas, cloud.spacing)
    before: CutState = solid.cut_state
    result: Any = cut_from(solid, len(before.surface.triangles), near)
    if len(corners) and np.array_equal(result.cut_state.checks, before.checks):
        _warn_of_miss(cloud, corners)
    return without_detached(result) if detached == REMOVE_PIECES else result


def _warn_of_miss(cloud: Cloud, corners: Floats) -> None:
    extents = cloud.points.min(axis=0), cloud.points.max(axis=0), corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    low, high, cut_low, cut_high = (np.round(each, 4).tolist() for each in extents)
    warnings.warn(
        f"the cut parts nothing: its triangles reach from {cut_low} to {cut_high} m, and the body from {low} to {high} "
        "m; give corners in metres, inside the body",
        stacklevel=3,
    )


def cut_from(body: Any, unchanged: int, corners: Floats) -> Solid:
    """Return a body whose cut has the first `unchanged` of its triangles, and others (t, 3, 3) in place of the rest."""
    solid, cloud, before = body, body.cloud, body.cut_state
    body_corners = cloud.points[cloud.triangles]
    is_inside = partial(inside_body, before.uncut, body_corners)
    surface = cut_surface(before.surface, corners, is_inside, cloud.spacing, unchanged)
    nodes = _nodes_to_fit(surface, unchanged, before, cloud.points, cloud.spacing)
    rows, released = _fit(before, surface, nodes)
    state, constants = _replace_stencils(body.body, before, surface, rows, released)
    faces = face_points(before.uncut, surface, body_corners, before.faces, changed_spheres(before.surface, surface))
    return _with_cut(solid, state._replace(faces=faces), constants)


def _checked(body: Any, triangles: Any) -> tuple[Any, Floats]:
    """Return the body and the corners (t, 3, 3) of triangles; raise `InputError` for others."""
    if not isinstance(body, Solid) or body.form != "energy":
        raise InputError(f"body of a cut must be a Solid in the energy form, got {brief(body)}; use form='energy'")
    if body.planes:
        raise InputError("body of a cut must have no planes of symmetry, got some; cut the complete body")
    if not len(body.cloud.triangles):
        raise CloudError("cloud of a cut body must have triangles of its surface, got none; use fill() or box()")
    try:
        corners = np.array(triangles, dtype=float)
    except (TypeError, ValueError, OverflowError):
        corners = np.zeros(0)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3):
        raise InputError(f"triangles of a cut must be numbers of shape (t, 3, 3), got {brief(triangles)}")
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if bad.size:
        raise InputError(f"triangles of a cut must be finite, got {corners[bad[0]].tolist()} for triangle {bad[0]}")
    return body, corners


def uncut_state(body: Any) -> CutState:
    """Return the state of a body without a cut."""
    stencils, n = body.stencils, len(body.cloud)
    uncut = uncut_stencils(
        body.cloud.points, body.volumes, body.cloud.spacing, stencils.neighbours, stencils.first[stencils.row],
        body.smoothing.neighbours, body.cloud.triangles.ravel(), inner_nodes(body.cloud, stencils),
        surface_forms(body.cloud, stencils), body.cloud.hidden,
    )  # fmt: skip
    none = np.zeros(n, np.bool_)
    return CutState(NO_CUT, no_face_points(), uncut, uncut.sums, np.zeros(n), none, none, none, (0.0, 0.0))


def _nodes_to_fit(
    surface: CutSurface, unchanged: int, before: CutState, points: Floats, spacing: float
) -> NDArray[np.int64]:
    """Return the nodes whose stencils new triangles, or fronts that have moved, can change."""
    former, near = before.surface.extended, np.zeros(len(points), dtype=np.bool_)
    is_moved = np.any(surface.extended[:unchanged] != former[:unchanged], axis=(1, 2))
    for triangles in (surface.extended, former):
        changed = np.concatenate([is_moved, np.ones(len(triangles) - unchanged, dtype=np.bool_)])
        nodes_near(points, triangles[changed], MAX_WAY * spacing, near)
    return np.flatnonzero(near)


def _fit(before: CutState, surface: CutSurface, nodes: NDArray[np.int64]) -> tuple[FittedRows, NDArray[np.bool_]]:
    """Return the new stencils of the nodes that the cut touches, and the nodes that are released.

    The nodes around a released one are fitted again without it, until none is new.
    """
    uncut, released = before.uncut, before.released.copy()
    for _ in range(MAX_ROUNDS):
        rows = fit_rows(before, surface, nodes, released)
        new = rows.nodes[(rows.kind == RELEASED_FIT) & ~released[rows.nodes]]
        if not new.size:
            break
        released[new] = True
        around = uncut.tree.query_ball_point(uncut.points[new], MAX_WAY * uncut.spacing)
        nodes = np.union1d(nodes, np.concatenate([np.asarray(each, dtype=np.int64) for each in around]))
    return rows, released


def _replace_stencils(
    body: Any, before: CutState, surface: CutSurface, rows: FittedRows, released: NDArray[np.bool_]
) -> tuple[CutState, Any]:
    """Return the state and the constants of the cut body."""
    uncut, nodes = before.uncut, rows.nodes
    if not len(nodes):
        return before._replace(surface=surface), body
    volumes = uncut.volumes
    old, (new, smoothing) = row_entries(body.lanes, nodes), fitted_entries(rows)
    rest = before.sums - old.sums(volumes)[:, :3]
    missing = uncut.sums - rest - new.sums(volumes)[:, :3]
    missing[released] = 0.0
    stress_left = keep_uniform_stress(uncut, surface, rows, missing)
    old_smoothing = smoothing_entries(body.smoothing.lanes, body.smoothing.weights, nodes)
    integrals_left = conserve_integrals(uncut, rows, (old_smoothing.sums(volumes) - smoothing.sums(volumes))[:, 0])
    if integrals_left > MAX_RESIDUAL:
        raise CloudError(
            f"no smoothing along the cut keeps the integral of the pressure near {uncut.points[nodes[0]]} m "
            f"({integrals_left:.1g} of a nodal volume is left); move the cut, or use a finer spacing"
        )
    new, smoothing = fitted_entries(rows)
    touched, checks = before.touched.copy(), before.checks.copy()
    touched[nodes], checks[nodes] = True, rows.checks
    residuals = max(before.residuals[0], stress_left), max(before.residuals[1], integrals_left)
    sums = rest + new.sums(volumes)[:, :3]
    state = before._replace(
        surface=surface, sums=sums, checks=checks, touched=touched, released=released, residuals=residuals
    )
    return state, with_stencils(body, nodes, new, smoothing, volumes)


def detached_nodes(body: Any) -> NDArray[np.bool_]:
    """Return True for nodes (n,) of pieces that no support holds; of a body without supports the largest one stays."""
    pieces = pieces_of(body)
    anchors = [body.cloud.group(support.group) for support in body.supports]
    if not anchors:
        volumes = np.bincount(pieces, np.where(body.cut_state.removed, 0.0, body.volumes))
        anchors = [np.flatnonzero(pieces == volumes.argmax())]
    return ~np.isin(pieces, pieces[np.concatenate(anchors)])


def without_detached(body: Any) -> Solid:
    """Return a body without the pieces that no support holds; of one without supports the largest piece stays."""
    before, removed = body.cut_state, detached_nodes(body)
    new = np.flatnonzero(removed & ~before.removed)
    if not len(new):
        return body
    none = np.zeros(0, dtype=np.int64)
    rows, smoothing = (Entries(none, none, np.zeros((0, width))) for width in (4, 1))
    sums, touched = before.sums.copy(), before.touched | removed
    sums[removed] = 0.0
    state = before._replace(sums=sums, touched=touched, released=before.released | removed, removed=removed)
    result = _with_cut(body, state, with_stencils(body.body, new, rows, smoothing, body.volumes))
    kind = body.supported.kind.copy()
    kind[new] = FIXED
    vars(result).update(supported=body.supported._replace(kind=kind), fixed_mask=kind == FIXED)
    return result


def pieces_of(body: Any) -> NDArray[np.int64]:
    """Return the number of every node's piece, shape (n,)."""
    constants, n = body.body, len(body.cloud)
    nodes = np.arange(n)
    bonds = [
        row_entries(constants.lanes, nodes),
        smoothing_entries(constants.smoothing.lanes, constants.smoothing.weights, nodes),
    ]
    node, near = (np.concatenate([getattr(each, name) for each in bonds]) for name in ("node", "near"))
    used = np.concatenate([np.any(each.weights != 0.0, axis=1) for each in bonds])
    graph = sparse.coo_array((np.ones(int(used.sum())), (node[used], near[used])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _with_cut(body: Any, state: CutState, constants: Any) -> Solid:
    """Return a copy of a body with other constants, without what was computed from the former ones."""
    result: Solid = copy(body)
    for name in COMPUTED_NAMES:
        vars(result).pop(name, None)
    taut = (
        constants
        if body.fibres is None
        else constants._replace(families=tension_compression_fibres(constants.families))
    )
    vars(result).update(body=constants, tension_compression_body=taut, _cut=state)
    return result
