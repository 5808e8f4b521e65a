"""Forces of small rigid tools on palpate's full bodies against closed forms, in linear elasticity.

    python validation/patches.py [--keep] [--kernel K] [--flat-fits]

A paraboloid of 1, 1.5 or 2 spacings in radius presses a layer bonded to its base, of 8 spacings, and both poles of
free balls of 5 and 7.5 spacings in radius. The truth is in `validation/patches_theory.py`. palpate's part is what
tools meet: the patches of surface nodes and of the edge midpoints, with the body's stiffness at rest. Errors are
means and standard deviations over places and seeds. `--keep` writes docs/validation/patches.json, with the
errors of fits in the plain coordinates next to the others (`palpate.meshfree.surface_gradient`). `--kernel` tries
another radius of the patches' kernel, `--flat-fits` shows the errors of the plain fits alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import patches_theory as theory
import result_files
import scipy.linalg
import scipy.sparse as sparse
from elements_mesh import icosphere

import palpate as pt
from palpate.meshfree import consistent, patches
from palpate.reduction.basis.linear_modes import stiffness_blocks

SPACING, POISSON, LAW_C1, DENSITY = 0.005, 0.45, 1100.0, 1060.0
RADII, DEPTHS = (1.0, 1.5, 2.0), (0.25, 0.5, 1.0)  # of the tools in spacings, and their depths over the radius
THICKNESS, WIDTH, FINER = 8.0, 18.0, 2.5  # of the layer in spacings, and spacings over the edges of its surface
LAYER_SEEDS, BALL_SEEDS, PLACE_COUNT = (0, 1), {5.0: (0, 1, 2), 7.5: (0, 1)}, 12
LARGEST_SHIFT, LARGEST_TILT = 1.5, 0.25  # of a tool's place from the middle in spacings, of its axis as a tangent
REACH_SHARE = 1.2  # depth of the points that may touch a tool, over its depth
LOCKING = 1e3  # stiffness of a free body's rigid motions, over the mean of its diagonal
LARGEST_BALL_ANGLE = 1.1  # [rad] from a pole, to points that a tool may touch


class Points(NamedTuple):
    """The points of a surface that tools meet."""

    places: np.ndarray  # (m, 3) array [m]
    lengths: np.ndarray  # (m,) array [m]: of the edges whose midpoints they are, else 0
    compliance: np.ndarray  # (m, m) array [m/N]: displacement against the tool under forces of the tool


def layer_cloud(seed: int) -> pt.Cloud:
    """Return the cloud of a layer, with the group of its base."""
    fine = pt.box((WIDTH * SPACING, WIDTH * SPACING, THICKNESS * SPACING), SPACING / FINER)
    used, faces = np.unique(fine.triangles, return_inverse=True)
    cloud = pt.fill((fine.points[used], faces.reshape(-1, 3)), SPACING, seed=seed)
    return cloud.with_group("held", cloud.points[:, 2] < 0.3 * SPACING)


def ball_cloud(radius: float, seed: int) -> pt.Cloud:
    """Return the cloud of a ball about the origin."""
    return pt.fill(icosphere(np.zeros(3), radius * SPACING, 4), SPACING, seed=seed)


def tissue() -> pt.materials.NeoHookean:
    """Return the law of the bodies."""
    return pt.materials.NeoHookean(C1=LAW_C1, density=DENSITY, poisson=POISSON)


def contact_points(body: pt.Solid, may_touch: np.ndarray, inward: Callable[[np.ndarray], np.ndarray]) -> Points:
    """Return the points that tools meet, by the surface nodes (n,) they may touch and directions (m, 3) at points."""
    cloud = body.cloud
    nodes = np.flatnonzero(may_touch)
    edges = body.contact_edges[may_touch[body.contact_edges].all(axis=1)]
    weights = sparse.csr_array(body.patches)
    weights = sparse.vstack([weights[nodes], 0.5 * (weights[edges[:, 0]] + weights[edges[:, 1]])], format="csr")
    ends = cloud.points[edges]
    places = np.concatenate([cloud.points[nodes], ends.mean(axis=1)])
    lengths = np.concatenate([np.zeros(len(nodes)), np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)])
    way = inward(places)
    loads = np.stack([weights.multiply(way[:, [axis]]).toarray() for axis in range(3)], axis=2)  # (m, n, 3)
    loads = loads.reshape(len(places), -1)
    return Points(places, lengths, loads @ responses(body, loads.T))


def responses(body: pt.Solid, loads: np.ndarray) -> np.ndarray:
    """Return the displacements (3n, m) [m] at rest under loads (3n, m) [N]; a body without supports keeps its place."""
    blocks, n = stiffness_blocks(body), len(body.cloud)
    rows = [[blocks[a, b] if a <= b else blocks[b, a].T for b in range(3)] for a in range(3)]
    order = np.arange(3 * n).reshape(3, n).T.ravel()
    free = np.flatnonzero(np.repeat(~body.fixed_mask, 3))
    stiffness = sparse.bmat(rows, format="csr")[order][:, order].tocsr()[free][:, free].toarray()
    if len(free) == 3 * n:
        moments = np.repeat(body.masses, 3)[:, None] * rigid_motions(body.cloud.points)
        locked = np.linalg.qr(moments)[0]
        stiffness += LOCKING * np.trace(stiffness) / len(stiffness) * locked @ locked.T
    found = np.zeros_like(loads)
    factor = scipy.linalg.cho_factor(stiffness, lower=True, overwrite_a=True)
    found[free] = scipy.linalg.cho_solve(factor, loads[free])
    return found


def rigid_motions(points: np.ndarray) -> np.ndarray:
    """Return three translations and three rotations of points (n, 3), shape (3n, 6)."""
    turns = np.stack([np.cross(axis, points).ravel() for axis in np.eye(3)], axis=1)
    return np.concatenate([np.tile(np.eye(3), (len(points), 1)), turns], axis=1)


def force(points: Points, gap: np.ndarray, radius: float, depth: float) -> float:
    """Return the force [N] of a paraboloid at a depth [m], whose gaps (m,) [m] are those where it begins to touch.

    An edge midpoint may be as deep in a tool as the edge's chord, as in `palpate.dynamics.contact.geometry`.
    """
    gap = gap + np.minimum(points.lengths**2 / (8 * radius), 0.25 * points.lengths)
    near = np.flatnonzero(gap < REACH_SHARE * depth)
    return float(theory.signorini(points.compliance[np.ix_(near, near)], depth - gap[near]).sum())


def layer_forces(seed: int) -> np.ndarray:
    """Return forces (places, radii, depths) [N] on a layer."""
    cloud = layer_cloud(seed)
    body = pt.Solid(cloud, tissue(), "held")
    middle = 0.5 * WIDTH * SPACING
    away = np.abs(cloud.points[:, :2] - middle).max(axis=1)
    top = (cloud.points[:, 2] > (THICKNESS - 1e-6) * SPACING) & (away < 5.5 * SPACING)
    points = contact_points(body, top, lambda places: np.broadcast_to([0.0, 0.0, -1.0], places.shape))
    shifts = np.random.default_rng(0).uniform(-LARGEST_SHIFT, LARGEST_SHIFT, (PLACE_COUNT, 2)) * SPACING
    found = np.zeros((PLACE_COUNT, len(RADII), len(DEPTHS)))
    for place, shift in enumerate(shifts):
        square = np.sum((points.places[:, :2] - middle - shift) ** 2, axis=1)
        for k, radius in enumerate(np.multiply(RADII, SPACING)):
            found[place, k] = [force(points, square / (2 * radius), radius, share * radius) for share in DEPTHS]
    return found


def ball_forces(ball_radius: float, seed: int) -> np.ndarray:
    """Return forces (places, radii, depths) [N] on each pole of a ball of some spacings."""
    cloud = ball_cloud(ball_radius, seed)
    body, size = pt.Solid(cloud, tissue()), ball_radius * SPACING
    on_surface = np.zeros(len(cloud), dtype=bool)
    on_surface[cloud.face_nodes] = True
    on_surface &= np.abs(cloud.points[:, 2]) > size * np.cos(LARGEST_BALL_ANGLE)
    points = contact_points(body, on_surface, lambda x: -x / np.linalg.norm(x, axis=1, keepdims=True))
    tilts = np.random.default_rng(1).uniform(-LARGEST_TILT, LARGEST_TILT, (PLACE_COUNT, 2))
    found = np.zeros((PLACE_COUNT, len(RADII), len(DEPTHS)))
    for place, tilt in enumerate(tilts):
        axis = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
        along = np.abs(points.places @ axis)
        across = np.sum(points.places**2, axis=1) - along**2
        for k, radius in enumerate(np.multiply(RADII, SPACING)):
            gap = size - along + across / (2 * radius)
            found[place, k] = [0.5 * force(points, gap, radius, share * radius) for share in DEPTHS]
    return found


def errors(body: str, fits: str, found: list[np.ndarray], exact: np.ndarray) -> list[dict[str, Any]]:
    """Return a row for every tool with the mean errors and their standard deviations, over the depths."""
    relative = np.concatenate(found) / exact - 1
    rows = []
    for k, radius in enumerate(RADII):
        each = relative[:, k]
        row = {"body": body, "fits": fits, "radius": radius, "depths": DEPTHS, "count": len(each)}
        rows.append(row | {"errors": each.mean(axis=0).tolist(), "deviations": each.std(axis=0).tolist()})
        print(line(rows[-1]), flush=True)
    return rows


def line(row: dict[str, Any]) -> str:
    """Return a row in per cent."""
    pairs = zip(row["errors"], row["deviations"], strict=True)
    found = "  ".join(f"{100 * mean:+6.1f} ± {100 * deviation:4.1f}" for mean, deviation in pairs)
    return f"{row['body']}, {row['fits']} fits, tool {row['radius']:g} h: {found} %"


def study(fits: str) -> list[dict[str, Any]]:
    """Return the errors of all bodies and tools, with fits that are "curved" (palpate's own) or "flat"."""
    original, modulus = consistent.with_surface_gradient, tissue().shear_modulus
    depths = [(each * SPACING, np.multiply(DEPTHS, each * SPACING)) for each in RADII]
    if fits == "flat":
        consistent.with_surface_gradient = lambda stencils, cloud: stencils
    try:
        layer = np.array([theory.layer_forces(*each, THICKNESS * SPACING, modulus, POISSON) for each in depths])
        rows = errors("layer", fits, [layer_forces(seed) for seed in LAYER_SEEDS], layer)
        for size, seeds in BALL_SEEDS.items():
            ball = np.array([theory.ball_forces(*each, size * SPACING, modulus, POISSON) for each in depths])
            rows += errors(f"ball of {size:g} h", fits, [ball_forces(size, seed) for seed in seeds], ball)
    finally:
        consistent.with_surface_gradient = original
    return rows


def main() -> None:
    """Print the errors, and keep them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", action="store_true", help="write docs/validation/patches.json")
    parser.add_argument("--kernel", type=float, default=patches.KERNEL_RADIUS, help="radius of the patches' kernel")
    parser.add_argument("--flat-fits", action="store_true", help="only fits in the plain coordinates")
    arguments, began = parser.parse_args(), time.perf_counter()
    if arguments.keep and (arguments.flat_fits or arguments.kernel != patches.KERNEL_RADIUS):
        parser.error("--keep is for the figures of palpate as it is")
    patches.KERNEL_RADIUS = arguments.kernel
    every = [] if arguments.flat_fits else study("curved")
    if arguments.flat_fits or arguments.keep:
        every += study("flat")
    print(f"{time.perf_counter() - began:.0f} s")
    if arguments.keep:
        result_files.write("patches", every, COMMAND)


COMMAND = "python validation/patches.py --keep"

if __name__ == "__main__":
    main()
