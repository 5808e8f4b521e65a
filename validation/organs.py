"""Every organ surface at hand, filled coarsely and finely, poked by 20 mm and let go: whether it stays stable untuned.

A round patch in the middle of one side, as wide as a fifth of the cube root of the volume however fine the nodes are,
moves 20 mm inwards in 0.2 s, stays until 0.4 s and is let go; the opposite side is fixed. After the release nothing
does work on the body, so its energy, kinetic and strain, must not grow.

    python validation/organs.py [--nodes 3000 10000] [--poisson 0.45 0.49] [--form energy] [--only NAME] [--table]

Results are added to docs/validation/organs.json, one case a line; docs/howto/organs.md has the table.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import result_files

import palpate as pt

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
# surface: file and units
SURFACES: dict[str, tuple[str, str] | None] = {
    "generated": None,
    "HRA female 30k": ("hra/VH_F_liver_solid_30k.ply", "m"),
    "HRA female 12k": ("hra/VH_F_liver_solid_12k.ply", "m"),
    "HRA female 6k": ("hra/VH_F_liver_solid_6k.ply", "m"),
    "HRA female 2k": ("hra/VH_F_liver_solid_2k.ply", "m"),
    "SOFA smooth": ("sofa/liver-smooth.obj", "cm"),
    "SOFA vtk": ("sofa/liver.vtk", "mm"),
    "SOFA classic": ("sofa/liver.obj", "cm"),
}
DEPTH, PUSHED, RELEASED, DURATION = 0.02, 0.2, 0.4, 1.0  # [m], [s]
RADIUS = 0.103  # of the patch, over the cube root of the volume: 1.3 spacings of 3,000 nodes
GROWTH = 1e-6  # of the energy at the release, that rounding may add


def surface(name: str, data: Path = DATA) -> pt.Surface:
    """Return a surface by its name."""
    source = SURFACES[name]
    return pt.liver_surface() if source is None else pt.io.read_surface(data / source[0], units=source[1], repair=True)


def spacing_for(body: pt.Surface, nodes: int) -> float:
    """Return the spacing [m] that gives about so many nodes, from a first try."""
    spacing = (body.volume / nodes) ** (1 / 3) * 1.2
    for _ in range(2):
        spacing *= (len(pt.fill(body, spacing)) / nodes) ** (1 / 2.7)
    return float(f"{spacing:.3g}")


def poked(cloud: pt.Cloud) -> tuple[pt.Cloud, np.ndarray]:
    """Return the cloud with groups ``"tool"`` and ``"back"``, and the way of the poke: along its shortest side."""
    points, on = cloud.points, cloud.group("surface")
    axis = int(np.argmin(np.ptp(points, axis=0)))
    middle = (cloud.volumes @ points) / cloud.volumes.sum()
    aside = np.linalg.norm(np.delete(points[on] - middle, axis, axis=1), axis=1)
    central = on[aside < 0.2 * np.linalg.norm(np.ptp(points, axis=0))]
    tip = central[np.argmax(points[central, axis])]
    near = np.linalg.norm(points[on] - points[tip], axis=1)
    low, high = points[:, axis].min(), points[tip, axis]
    back = np.flatnonzero(points[:, axis] < low + 0.2 * (high - low))
    groups = {**cloud.groups, "tool": np.sort(on[near < RADIUS * cloud.volumes.sum() ** (1 / 3)]), "back": back}
    return replace(cloud, groups=groups), -np.eye(3)[axis]


def run(
    name: str, nodes: int, poisson: float, form: str, data: Path = DATA, duration: float = DURATION
) -> dict[str, Any]:
    """Fill, poke, release, and return what came of it."""
    body = surface(name, data)
    spacing = spacing_for(body, nodes)
    begin = perf_counter()
    cloud, direction = poked(pt.fill(body, spacing))
    filled = perf_counter() - begin
    entry: dict[str, Any] = {
        "surface": name, "litres": 1e3 * body.volume, "nodes": len(cloud), "spacing": spacing, "poisson": poisson,
        "form": form, "fill_seconds": filled, "duration": duration,
    }  # fmt: skip
    share = duration / DURATION
    pushed, released = share * PUSHED, share * RELEASED
    poke = pt.PrescribedMotion(
        "tool", lambda points, time: tuple(DEPTH * min(1.0, time / pushed) * direction), until=released
    )
    try:
        material = pt.materials.NeoHookean(C1=1000.0, density=1060.0, poisson=poisson)
        model = pt.Solid(cloud, material, "back", form=form)
        every = duration / 50
        trajectory = pt.rollout(model, [poke], duration=duration, every=every, progress=False)
    except (pt.CloudError, pt.DivergenceError) as error:
        return entry | {"stable": False, "why": " ".join(str(error).split())}
    after = trajectory.times > released + 0.5 * every
    energy = trajectory.kinetic + trajectory.strain
    at = float(energy[np.flatnonzero(after)[0]])
    return entry | {
        "stable": bool(energy[after].max() <= at * (1 + GROWTH)),
        "energy_at_release": at,
        "energy_most_after": float(energy[after].max()),
        "energy_at_end": float(energy[-1]),
        "balance": float(np.abs(trajectory.balance).max() / np.abs(trajectory.external).max()),
        "largest_displacement": float(np.linalg.norm(trajectory.displacements, axis=2).max()),
        "stiffness_damping": trajectory.stiffness_damping,
        "steps": int(trajectory.steps[-1]),
        "seconds": trajectory.wall_seconds,
    }


def main() -> None:
    """Run the cases asked for and add them to the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", type=int, nargs="+", default=[3000])
    parser.add_argument("--poisson", type=float, nargs="+", default=[0.45, 0.49])
    parser.add_argument("--form", nargs="+", default=["energy"])
    parser.add_argument("--only", nargs="+", default=list(SURFACES))
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    for nodes in options.nodes:
        for form in options.form:
            for poisson in options.poisson:
                for name in options.only:
                    entry = run(name, nodes, poisson, form, options.data)
                    add(entry | {"wished_nodes": nodes})
                    print(json.dumps(entry), flush=True)


def add(entry: dict[str, Any]) -> None:
    """Put a case among the results, in place of the same one run before."""
    cases = result_files.read("organs", {"cases": []})["cases"]
    same = ("form", "wished_nodes", "poisson", "surface")
    cases = [case for case in cases if any(case[key] != entry[key] for key in same)]
    cases.append(entry)
    cases.sort(key=lambda case: tuple(case[key] for key in same))
    result_files.write("organs", {"cases": cases})


if __name__ == "__main__":
    main()
