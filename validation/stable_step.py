"""What limits the stable step of the energy form: the place of the fastest vibration, and the margin of the step.

    python validation/stable_step.py
    python validation/stable_step.py --filled

For a box on a lattice, a box of jittered nodes and two livers the script finds

- the highest frequency at rest over that of a wave of two spacings, and the nodes that vibrate;
- the largest step that a free vibration of small random velocities survives, over the step that runs take;
- the step that would be stable if the nodes had at least a share of the median nodal mass.

With `--filled` it finds the stable steps of ten filled bodies without and with transfers to nodes of small weight. It
also finds what the transfers change in the first frequency and in the mean displacement under a small weight. Both
write docs/validation/stable_step.json.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import result_files
import scipy.sparse as sparse
from scipy.sparse.linalg import eigsh

import palpate as pt
from palpate.meshfree import quadrature
from palpate.reduction.basis.linear_modes import _vibrations, rest_statics, rest_stiffness
from palpate.scenes.open_scene import open_scene

FACTORS = np.arange(1.0, 1.41, 0.02)  # steps tried, over the stable step
SHARES = (0.15, 0.25, 0.5)  # least nodal masses, over the median
STEPS = 3000  # of a trial


def fastest(model: pt.Solid, masses: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the highest frequency [rad/s] at rest and each node's share of that mode's kinetic energy."""
    free = model.free_directions
    diagonal = (free.T @ sparse.diags(np.repeat(masses, 3)) @ free).diagonal()
    root = sparse.diags(1 / np.sqrt(diagonal))
    values, vectors = eigsh((root @ (free.T @ rest_stiffness(model) @ free) @ root).tocsr(), k=1, which="LA", tol=1e-8)
    fields = (free @ (root @ vectors[:, 0])).reshape(-1, 3)
    energy = masses * np.sum(fields**2, axis=1)
    return float(np.sqrt(values[0])), energy / energy.sum()


def largest_step(model: pt.Solid) -> float:
    """Return the largest step that a free vibration survives, over the step that runs take."""
    prepared, work = model.prepare([]), model.workspace()
    noise = 1e-6 * np.random.default_rng(0).standard_normal((len(model.cloud), 3))
    survived = 0.0
    for factor in FACTORS:
        state = model.state(prepared, velocity=noise)
        first = model.outputs(state, prepared).kinetic
        with np.errstate(all="ignore"):
            state, _ = model.advance(state, prepared, factor * model.stability.step, STEPS, work)
            kinetic = model.outputs(state, prepared).kinetic
        if not kinetic <= first:
            break
        survived = factor
    return survived


@contextmanager
def without_transfers() -> Iterator[None]:
    """Build bodies without transfers to nodes of small weight."""
    limits = quadrature.MIN_SMOOTH_RATIO, quadrature.MIN_MEDIAN_RATIO
    quadrature.MIN_SMOOTH_RATIO = quadrature.MIN_MEDIAN_RATIO = -np.inf
    try:
        yield
    finally:
        quadrature.MIN_SMOOTH_RATIO, quadrature.MIN_MEDIAN_RATIO = limits


def filled_bodies() -> Iterator[tuple[str, pt.Cloud]]:
    """Yield ten filled bodies by name."""
    liver = pt.liver_surface(0.004)
    for spacing in (0.009, 0.010, 0.011, 0.012, 0.013, 0.014):
        yield f"liver, {1e3 * spacing:g} mm", pt.fill(liver, spacing)
    flat = liver.vertices * [1.0, 1.0, 0.6], liver.triangles
    for spacing in (0.009, 0.011):
        yield f"flat liver, {1e3 * spacing:g} mm", pt.fill(flat, spacing)
    corners = np.array([[x, y, z] for x in (0, 0.06) for y in (0, 0.04) for z in (0, 0.03)])
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    brick = np.array([triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])
    yield "brick, 5 mm", pt.fill((corners, brick), 0.005)
    wedge = corners.copy()
    wedge[:, 2] *= 1 - wedge[:, 0] / 0.075  # 30 mm thick at one end, 6 mm at the other
    yield "wedge, 4 mm", pt.fill((wedge, brick), 0.004)


def clamped(cloud: pt.Cloud, law: pt.materials.NeoHookean) -> pt.Solid:
    """Return a body fixed at an end of its longest axis."""
    axis = int(np.argmax(np.ptp(cloud.points, axis=0)))
    along = cloud.points[:, axis] - cloud.points[:, axis].min()
    groups = {**cloud.groups, "end": np.flatnonzero(along < 0.15 * along.max())}
    return pt.Solid(replace(cloud, groups=groups), law, "end")


def responses(model: pt.Solid) -> tuple[float, float]:
    """Return the first frequency, and the mean displacement under a small weight along (0, 0, 1)."""
    statics = rest_statics(model, ())
    weight = np.zeros((len(model.cloud), 3))
    weight[:, 2] = 1e-3 * model.masses
    field = (statics.free @ statics.solve(statics.free.T @ weight.ravel())).reshape(-1, 3)
    return float(_vibrations(model, statics, 1)[1][0]), float(model.masses @ field[:, 2] / model.masses.sum())


def filled() -> list[dict[str, Any]]:
    law = pt.materials.NeoHookean(C1=500.0, density=1000.0, poisson=0.45)
    rows = []
    for name, cloud in filled_bodies():
        with without_transfers():
            before = clamped(cloud, law)
        after = clamped(cloud, law)
        (f0, u0), (f1, u1) = responses(before), responses(after)
        rows.append({
            "body": name, "nodes": len(cloud), "steps": [before.stability.step, after.stability.step],
            "frequency_change": f1 / f0 - 1, "displacement_change": u1 / u0 - 1,
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def limits() -> list[dict[str, Any]]:
    tissue = pt.materials.NeoHookean(C1=500.0, density=1000.0, poisson=0.45)
    bodies = {
        "box, lattice": pt.Solid(pt.box((0.1, 0.02, 0.02), 0.004), tissue, "x-"),
        "box, jittered": pt.Solid(pt.box((0.1, 0.02, 0.02), 0.004, 0.2), tissue, "x-"),
        "liver, 12 mm": open_scene("liver", {"spacing": 0.012, "tool.radius": 0.03}).body,
        "liver, 9 mm": open_scene("liver").body,
    }
    rows = []
    for name, model in bodies.items():
        law, median = model.material, float(np.median(model.masses))
        highest, share = fastest(model, model.masses)
        wave = np.pi / model.cloud.spacing * np.sqrt((law.lame + 2 * law.shear_modulus) / law.density)
        order = np.argsort(share)[::-1][:4]
        raised = {f"{least:g}": np.maximum(model.masses, least * median) for least in SHARES}
        rows.append({
            "body": name, "nodes": len(model.cloud), "frequency_over_wave": highest / wave,
            "share_of_four": float(share[order].sum()), "mass_of_four": float(model.masses[order].mean() / median),
            "share_of_light": float(share[model.masses < 0.5 * median].sum()),
            "masses": [float(model.masses.min() / median), float(model.masses.max() / median)],
            "largest_step": float(largest_step(model)),
            "step_with_least_mass": {least: highest / fastest(model, own)[0] for least, own in raised.items()},
            "mass_added": {least: float(own.sum() / model.masses.sum() - 1) for least, own in raised.items()},
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--filled", action="store_true", help="the steps of ten filled bodies")
    name, study = ("filled", filled) if parser.parse_args().filled else ("limits", limits)
    result_files.write("stable_step", result_files.read("stable_step", {}) | {name: study()})


if __name__ == "__main__":
    main()
