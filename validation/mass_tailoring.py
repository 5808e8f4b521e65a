"""More mass for the fastest modes of a full body in the engine: its steps, and what else changes.

    python validation/mass_tailoring.py

For the generated liver at three spacings, held at its back, with and without the modes that get more mass by default:

- the number of modes, and the step at rest and at strains up to 0.6, over that without them;
- the largest change of the 40 lowest frequencies;
- the force of a ball that presses by a tenth of the body and stays, and the displacements, at rest;
- the largest energy of a free vibration of 2 s over its first, without mass damping, in means over 0.1 s.

It writes docs/validation/mass_tailoring.json.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import result_files

import palpate as pt
from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.nodal.mass_scaling import MassScaling, default_modes, scaled_mass, subtract_inertia
from palpate.dynamics.nodal.stability import highest_frequency
from palpate.realtime.bodies.full_body import step_statistics
from palpate.reduction.basis.linear_modes import _vibrations, rest_statics

SPACINGS, LOW_FREQUENCIES = (0.009, 0.012, 0.015), 40  # [m]
BALL, GAP, DEPTH, PERIOD = 0.02, 0.002, 0.015, 1e-3  # [m], [s]
PRESS_SECONDS, HOLD_SECONDS, FREE_SECONDS, MEAN_SECONDS = 0.2, 2.0, 2.0, 0.1
WAVE_LENGTH, WAVE_HEIGHTS = 0.1, (0.004, 0.008)  # [m] of displacements with strains of about 0.3 and 0.6
MASS_DAMPING = 20.0  # [1/s] of the press


def liver(spacing: float, mass_damping: float) -> pt.Solid:
    cloud = pt.fill(pt.liver_surface(0.004), spacing)
    points = cloud.points
    cloud = cloud.with_group("back", points[:, 1] > np.quantile(points[:, 1], 0.85))
    law = pt.materials.NeoHookean(C1=1.1e3, density=1060.0, poisson=0.45)
    return pt.Solid(cloud, law, "back", mass_damping=mass_damping)


def waves(points: np.ndarray, height: float) -> np.ndarray:
    """Return displacements (n, 3) [m] that strain the whole body."""
    k = 2 * np.pi / WAVE_LENGTH
    phases = np.stack([points[:, 1], points[:, 2], points[:, 0] + points[:, 1]], axis=1)
    return height * np.stack(
        [np.sin(k * phases[:, 0]), 0.7 * np.cos(k * phases[:, 1]), np.sin(k * phases[:, 2])], axis=1
    )


def frequency(body: pt.Solid, u: np.ndarray, mass_scaling: MassScaling) -> float:
    """Return the highest frequency [rad/s] at displacements, with the additional mass."""
    density, none = body.material.density, np.zeros_like(u)

    def force(displacements: np.ndarray) -> np.ndarray:
        result = body.force(displacements)
        subtract_inertia(mass_scaling, body.volumes, density, 0.0, none, result, 0.0, none, result)
        return result

    constrain = body.constrain(body.fixed_mask)
    noise, step = constrain(np.random.default_rng(0).standard_normal(u.shape)), 1e-6 * body.cloud.spacing
    return highest_frequency(force, u, constrain, noise, None, amplitude=step, density=density)[0]


def largest_change(body: pt.Solid, mass_scaling: MassScaling) -> float:
    """Return the largest relative change of the lowest frequencies.

    With M'^-1 = M^-1 - L L' the additional mass of a mode q is q' M L (I - L' M L)^-1 L' M q.
    """
    n, count = len(body.cloud), len(mass_scaling.used)
    local = np.zeros((n, 3, count))
    for k in range(count):
        part = slice(*mass_scaling.start[k : k + 2])
        local[mass_scaling.nodes[part], :, k] = mass_scaling.shapes[part]
    weighted = body.masses[:, None, None] * local
    free = rest_statics(body, ())
    modes = np.asarray(_vibrations(body, free, LOW_FREQUENCIES)[0]).reshape(-1, n, 3)
    masses = np.einsum("i,qic,qic->q", body.masses, modes, modes)
    parts = np.einsum("qic,ick->qk", modes, weighted)
    inverse = np.linalg.inv(np.eye(count) - np.einsum("ick,icj->kj", local, weighted))
    return float(0.5 * (np.einsum("qk,kj,qj->q", parts, inverse, parts) / masses).max())


def contact(body: pt.Solid) -> tuple[Any, np.ndarray]:
    home = body.cloud.points[np.argmin(body.cloud.points[:, 1])] - np.array([0.0, BALL + GAP, 0.0])
    return pt.tools.Contact(pt.tools.Sphere(BALL), tuple(home)), home


def press(body: pt.Solid, modes: int) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Return the mean force (3,) [N] of a ball that has pressed for two seconds, displacements and statistics."""
    model = pt.realtime_model(body, contact=contact(body)[0], scaled_modes=modes)
    q, v, report, target = *np.zeros((2, len(model.rest))), np.zeros(20), np.zeros(12)
    count, mean, total = round(HOLD_SECONDS / PERIOD), round(MEAN_SECONDS / PERIOD), np.zeros(3)
    for k in range(count):
        target[1] = (DEPTH + GAP) * min((k + 1) * PERIOD / PRESS_SECONDS, 1.0)
        model.advance(model.data, q, v, target.copy(), PERIOD, report)
        total += report[8:11] / mean if k >= count - mean else 0.0
    return total, q.reshape(-1, 3), step_statistics(model.data)


def free_energies(body: pt.Solid, modes: int) -> float:
    """Return the largest energy of a free vibration over that at its start, which forceps gave."""
    ball, home = contact(body)
    model: Any = pt.realtime_model(body, contact=ball, scaled_modes=modes)
    pose = np.array([*home, 1.0, 0.0, 0.0, 0.0])
    place = home + np.array([0.0, BALL + GAP, 0.0])
    model.change_tool(Forceps(2 * body.cloud.spacing, tuple(place)), pose, 0.0)
    q, v, report, target = *np.zeros((2, len(model.rest))), np.zeros(20), np.zeros(12)
    for k in range(round(PRESS_SECONDS / PERIOD)):
        target[1] = -DEPTH * (k + 1) * PERIOD / PRESS_SECONDS
        model.advance(model.data, q, v, target.copy(), PERIOD, report)
    model.change_tool(None, pose, 0.0)
    energies = []
    for _ in range(round(FREE_SECONDS / PERIOD)):
        model.advance(model.data, q, v, np.zeros(12), PERIOD, report)
        kinetic = 0.5 * float(body.masses @ np.sum(v.reshape(-1, 3) ** 2, axis=1))
        energies.append(kinetic + body.strain_energy(q.reshape(-1, 3)))
    means = np.reshape(energies, (-1, round(MEAN_SECONDS / PERIOD))).mean(axis=1)  # velocities are half a step behind
    return float(means.max() / means[0])


def main() -> None:
    rows = []
    for spacing in SPACINGS:
        body, free = liver(spacing, MASS_DAMPING), liver(spacing, 0.0)
        points, rest = body.cloud.points, np.zeros((len(body.cloud), 3))
        modes = default_modes(len(points))
        mass_scaling = scaled_mass(body, body.fixed_mask, modes)[0]
        none = scaled_mass(body, body.fixed_mask, 0)[0]
        states = [rest, *(waves(points, height) for height in WAVE_HEIGHTS)]
        steps = [frequency(body, u, none) / frequency(body, u, mass_scaling) for u in states]
        (force, u, _), (other, w, statistics) = press(body, 0), press(body, modes)
        rows.append({
            "body": f"liver, {1e3 * spacing:g} mm", "nodes": len(points), "modes": modes,
            "nodes_of_shape": len(mass_scaling.nodes) / modes, "steps": steps, "repeated": statistics["repeated"],
            "strains": [float(np.abs(body.deformation_gradient(s) - np.eye(3)).max()) for s in states],
            "frequency_change": largest_change(body, mass_scaling),
            "force_change": float(np.linalg.norm(other - force) / np.linalg.norm(force)),
            "displacement_change": float(np.abs(w - u).max() / np.abs(u).max()),
            "energies": [free_energies(free, 0), free_energies(free, modes)],
        })  # fmt: skip
        print(rows[-1], flush=True)
    result_files.write("mass_tailoring", rows)


if __name__ == "__main__":
    main()
