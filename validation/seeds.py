"""Scatter of a tool's force over seeds of `palpate.fill`, at places all over an organ's surface.

    python validation/seeds.py [--only NAME ...] [--seeds 10]

The organs are those of elements.py at about 3,000 nodes. Places are as far from each other as possible, lobes and edges
among them, three spacings from the support. At each a disc of 1.5 spacings in radius moves rigidly along the normal by
little. Thickness is the way along the normal through the body, at most 12 spacings. Rows are printed as
docs/claims/elements.md has them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import trimesh
from elements import Linear, body_of, cloud_of
from elements_cases import Case, case

from palpate.surface.nesting import inside_points

ORGANS = ("liver", "lobes", "generated", "kidney")
PLACES, MAX_SPACINGS, SAMPLES = 8, 12.0, 4000


def places(it: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (8, 3) [m] of the surface, their outward normals, and the thickness there in spacings."""
    mesh = trimesh.Trimesh(it.vertices, it.faces, process=True)
    points, faces = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
    away = it.support(points) > 3 * it.spacing
    points, normals = points[away], mesh.face_normals[faces][away]
    chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())]
    while len(chosen) < PLACES:
        chosen.append(int(np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1).argmax()))
    steps = np.arange(0.2, MAX_SPACINGS, 0.2)
    corners = np.ascontiguousarray(it.vertices[it.faces])
    rays = [points[k] - steps[:, None] * it.spacing * normals[k] for k in chosen]
    inside = [inside_points(np.ascontiguousarray(each), corners) for each in rays]
    thickness = [MAX_SPACINGS if each.all() else 0.2 * each.argmin() for each in inside]
    return points[chosen], normals[chosen], np.array(thickness)


def forces(it: Case, seed: int, points: np.ndarray, normals: np.ndarray) -> list[float]:
    """Return the forces on the disc at the places, of a cloud of a seed."""
    linear = Linear(body_of(it, cloud_of(it, it.spacing, seed)))
    return [linear.patch(replace(it, point=x, normal=-n)) for x, n in zip(points, normals, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=ORGANS, default=ORGANS, metavar="NAME")
    parser.add_argument("--seeds", type=int, default=10)
    arguments = parser.parse_args()
    print("| organ | thickness [spacings] | standard deviation of the force [%] |\n|---|---|---|")
    for name in arguments.only:
        it = case(name)
        points, normals, thickness = places(it)
        values = np.array([forces(it, seed, points, normals) for seed in range(arguments.seeds)])
        scatter = 100 * values.std(axis=0, ddof=1) / values.mean(axis=0)
        print(f"| {name} | {' / '.join(f'{x:.1f}' for x in thickness)} | {' / '.join(f'{x:.1f}' for x in scatter)} |")


if __name__ == "__main__":
    main()
