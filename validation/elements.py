"""Forces, frequencies and sag of palpate's full bodies against quadratic finite elements on organs.

    python validation/elements.py [CASE ...] [--scales 1.26 1] [--seeds 0 1]
    python validation/elements.py --truth [CASE ...]

compares the cases of validation/elements_cases.py at spacings of some times that of about 3,000 nodes, writes
docs/validation/elements.json and prints the errors. The second command makes the truth,
docs/validation/elements_truth.json, in minutes to hours (``pip install scikit-fem tetgen pypardiso``).
Supports reach `BORDER_MARGIN` spacings beyond their border, patches `MOVED_MARGIN`, as places of scenes do.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import result_files
import scipy.linalg
import scipy.sparse as sparse
from elements_cases import NAMES, Case, case
from scipy.sparse.linalg import LinearOperator, eigsh

import palpate as pt
from palpate.meshfree.cloud import BORDER_MARGIN, MOVED_MARGIN
from palpate.reduction.basis.linear_modes import stiffness_blocks

NAME = "elements"
# time of each depth of a ball, times the lowest frequency, and the share in which it moves; the rest lasts 8 times
# as long as the body, critically damped, needs to approach its equilibrium to a factor of e
HOLD_TIME, MOVING_SHARE = 12.0, 0.3
SKIPPED = ("block", "cylinder_uniform")  # a lattice has studies of its own (frequencies.py, tips.py)


def surface_mask(cloud: pt.Cloud) -> np.ndarray:
    """Return True for surface nodes (n,)."""
    mask = np.zeros(len(cloud), dtype=bool)
    mask[cloud.group("surface")] = True
    return mask


def support_nodes(it: Case, cloud: pt.Cloud) -> np.ndarray:
    """Return True for the nodes (n,) that the support holds."""
    away = it.support(cloud.points)
    if it.limb:  # the wall of the bone, which surface nodes lie on
        return surface_mask(cloud) & (away < 0.5 * cloud.spacing)
    return surface_mask(cloud) & (away <= BORDER_MARGIN * cloud.spacing)


def cloud_of(it: Case, spacing: float, seed: int) -> pt.Cloud:
    """Return a case's cloud, with the group of its support."""
    cloud = pt.fill((it.vertices, it.faces), spacing, seed=seed)
    return cloud.with_group("held", support_nodes(it, cloud))


def body_of(it: Case, cloud: pt.Cloud, damping: float = 0.0) -> pt.Solid:
    """Return a case's full body with some mass damping [1/s]."""
    stiffness = None
    if it.inclusion is not None:
        centre, radius, factor = it.inclusion
        share = pt.cell_fractions(cloud, lambda x: np.linalg.norm(x - centre, axis=1) < radius)
        stiffness = 1 / (1 - share + share / factor)
    elif it.layers:
        share = pt.cell_fractions(cloud, lambda x: it.factor(x) > 1)
        stiffness = 1 / (1 - share + share / it.factor(np.array([[0.02, 0.0, 0.0]]))[0])
    law = pt.materials.NeoHookean(C1=it.c1, density=it.density, poisson=it.poisson)
    return pt.Solid(cloud, law, "held", stiffness=stiffness, mass_damping=damping)


class Linear:
    """Linear responses of a body at rest, by one Cholesky factorisation."""

    def __init__(self, body: pt.Solid) -> None:
        blocks, n = stiffness_blocks(body), len(body.cloud)
        rows = [[blocks[a, b] if a <= b else blocks[b, a].T for b in range(3)] for a in range(3)]
        order = np.arange(3 * n).reshape(3, n).T.ravel()
        self.free = np.flatnonzero(np.repeat(~body.fixed_mask, 3))
        self.stiffness = sparse.bmat(rows, format="csr")[order][:, order].tocsr()[self.free][:, self.free]
        self.factor = scipy.linalg.cho_factor(self.stiffness.toarray(), lower=True, overwrite_a=True)
        self.masses, self.points, self.body = body.masses, body.cloud.points, body

    def solve(self, right: np.ndarray) -> np.ndarray:
        return scipy.linalg.cho_solve(self.factor, right)

    def response(self, load: np.ndarray) -> np.ndarray:
        """Return the displacements (n, 3) [m] under a load (n, 3) [N]."""
        u = np.zeros(load.size)
        u[self.free] = self.solve(load.ravel()[self.free])
        return u.reshape(-1, 3)

    def frequencies(self, count: int = 5) -> list[float]:
        mass = sparse.diags(np.repeat(self.masses, 3)[self.free])
        inverse = LinearOperator(self.stiffness.shape, self.solve, dtype=float)
        squares = eigsh(self.stiffness, count, mass, sigma=0.0, OPinv=inverse, tol=1e-8, return_eigenvectors=False)
        return np.sqrt(np.sort(squares)).tolist()

    def sag(self) -> list[float]:
        """Return mean displacements [m] along 1 m/s^2 in each direction."""
        shares = self.masses / self.masses.sum()
        loads = [self.masses[:, None] * np.eye(3)[axis] for axis in range(3)]
        return [float(shares @ self.response(load)[:, axis]) for axis, load in enumerate(loads)]

    def patch(self, it: Case) -> float:
        """Return the force [N/m] on a disc of the surface that moves rigidly."""
        cloud = self.body.cloud
        facing = np.zeros(len(cloud), dtype=bool)
        facing[cloud.face_nodes[cloud.face_normals @ it.normal < 0]] = True
        away = np.linalg.norm(self.points - it.point, axis=1)
        moved = facing & (away <= it.patch_radius + MOVED_MARGIN * cloud.spacing)
        place = np.full(self.points.size, -1)
        place[self.free] = np.arange(len(self.free))
        rows = place[np.flatnonzero(np.repeat(moved, 3))]
        unit = np.zeros((len(self.free), len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        compliance = self.solve(unit)[rows]
        way = np.tile(it.normal, len(rows) // 3)
        return float(np.linalg.solve(compliance, way) @ way)

    def smooth(self, it: Case) -> float:
        """Return the compliance [m/N] under a smooth pressure, through the patches as tools act."""
        cloud, load = self.body.cloud, np.zeros_like(self.points)
        away = np.linalg.norm(self.points[cloud.face_nodes] - it.point, axis=1)
        near = (away < it.smooth_radius) & (cloud.face_normals @ it.normal < -0.2)
        pressure = np.where(near, 0.5 + 0.5 * np.cos(np.pi * away / it.smooth_radius), 0.0) * cloud.face_areas
        np.add.at(load, cloud.face_nodes, pressure[:, None] * it.normal)
        load = self.body.patches.T @ load
        return float(np.sum(self.response(load) * load) / np.linalg.norm(load.sum(axis=0)) ** 2)


def press(body: pt.Solid, it: Case, radius: float, depths: list[float], hold: float) -> list[float | None]:
    """Return the force [N] of a ball held for a time [s] at some depths; None beyond where the run refuses."""
    starts = [-0.02 * radius, *depths[:-1]]

    def depth(t: float) -> float:
        k = min(int(t / hold), len(depths) - 1)
        share = min((t - k * hold) / (MOVING_SHARE * hold), 1.0)
        return float(starts[k] + (depths[k] - starts[k]) * np.sin(0.5 * np.pi * share) ** 2)

    tool = pt.tools.Contact(pt.tools.Sphere(radius), lambda t: it.point - it.normal * (radius - depth(t)))
    try:
        run = pt.rollout(body, [tool], duration=hold * len(depths), every=hold / 2, progress=False)
    except pt.DivergenceError as error:
        run = error.trajectory
    forces = [] if run is None else (run.reactions["tool"] @ it.normal)[2::2].tolist()
    return [*forces, *[None] * (len(depths) - len(forces))]


def compare(name: str, truth: dict[str, Any], scale: float, seed: int) -> dict[str, Any]:
    """Return the relative errors of a case at a spacing."""
    it, begin = case(name), time.perf_counter()
    body = body_of(it, cloud_of(it, scale * it.spacing, seed))
    row: dict[str, Any] = {
        "case": name,
        "scale": scale,
        "seed": seed,
        "nodes": len(body.cloud),
        "step": body.stability.step,
    }
    linear = Linear(body)
    for quantity, found in (
        ("frequencies", linear.frequencies), ("sag", linear.sag), ("patch", lambda: linear.patch(it)),
        ("smooth", lambda: linear.smooth(it)),
    ):  # fmt: skip
        if quantity in truth:
            exact = np.atleast_1d(truth[quantity]["value"])
            row[quantity] = (np.atleast_1d(found()) / exact - 1).tolist()
    row["balls"] = []
    for radius in sorted({ball["radius"] for ball in truth.get("balls", [])}):
        if radius < body.cloud.spacing:
            continue  # refused
        exact = [(b["depth"], b["force"]) for b in truth["balls"] if b["radius"] == radius]
        lowest = linear.frequencies(1)[0]  # [rad/s]
        damped = body_of(it, body.cloud, 2 * lowest)
        forces = press(damped, it, radius, [d for d, _ in exact], HOLD_TIME / lowest)
        errors = [None if f is None else f / e - 1 for f, (_, e) in zip(forces, exact, strict=True)]
        row["balls"].append({"radius": radius / body.cloud.spacing, "depths": [d for d, _ in exact], "errors": errors})
    row["seconds"] = round(time.perf_counter() - begin, 1)
    return row


def line(row: dict[str, Any]) -> str:
    """Return the errors of a row in per cent."""
    parts = [f"{row['case']}, {row['nodes']} nodes, seed {row['seed']}:"]
    for quantity in ("frequencies", "sag", "patch", "smooth"):
        if quantity in row:
            parts.append(f"{quantity} " + " ".join(f"{100 * e:+.1f}" for e in row[quantity]))
    for ball in row["balls"]:
        errors = " ".join("refused" if e is None else f"{100 * e:+.1f}" for e in ball["errors"])
        parts.append(f"ball {ball['radius']:.2f} h {errors}")
    return "; ".join(parts)


def main() -> None:
    """Compare the cases asked for, and store their errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="case", default=[])
    parser.add_argument("--scales", type=float, nargs="*", default=[1.26, 1.0])
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1])
    parser.add_argument("--truth", action="store_true", help="compute the finite-element responses instead")
    options = parser.parse_args()
    if options.truth:
        import elements_truth

        for name in options.names or NAMES:
            elements_truth.add(name, elements_truth.linear(name))
            elements_truth.balls(name)
        return
    truths = result_files.read("elements_truth", {"cases": {}})["cases"]
    for name in options.names or [each for each in truths if each not in SKIPPED]:
        for scale in options.scales:
            for seed in options.seeds:
                row = compare(name, truths[name], scale, seed)
                print(line(row), flush=True)
                key = (name, scale, seed)
                rows = [r for r in result_files.read(NAME, []) if (r["case"], r["scale"], r["seed"]) != key]
                rows = sorted([*rows, row], key=lambda r: (r["case"], -r["scale"], r["seed"]))
                result_files.write(NAME, rows, "python validation/elements.py")


if __name__ == "__main__":
    main()
