"""Bases of reduced models with the same number of coordinates, compared without sampling.

    python validation/bases.py [--runs FOLDER] [rollouts|local|states ...]

The beam of `validation/held_out.py` on 496 nodes, its 10 first training motions and 8 motions inside their range. The
reduced models use all nodes and a quarter as many pressure modes as coordinates, so that the basis alone is judged. The
runs of the full model are stored in FOLDER (two minutes); results go to docs/validation/bases.json.

rollouts    errors of displacement and velocity with 16 and 32 coordinates, for each basis and each correction, and by
            how much the slowest frequencies of unseen loaded states are too high
local       what bases of parts of the training states miss of unseen states, and the energy that is left
states      by how much frequencies are too high with the present basis, by the displacement of the state
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import result_files
import scipy.linalg
from held_out import DURATION, EVERY, Floats, summary, tried
from motions import random_motion, training_motions

import palpate as pt
from palpate.dynamics.nodal.stability import stiffness
from palpate.reduction.training.reduce import hyper_reduce

SIZES = (16, 32)
TRAINED, TESTED = 10, 8
LOADED_STATES = 12  # of the training, with vibration modes
VIBRATIONS, BENT = 12, 5  # vibration modes of each, and those of them with derivatives
SLOWEST = 6  # frequencies that are compared
DERIVATIVE_STEP = 0.02  # displacements for second differences, in spacings
MAX_NEWTON, MIN_SHARE, NEWTON_TOLERANCE = 40, 1e-3, 1e-6
CLUSTERS = (1, 4, 8)
NEAR = 1.5  # distance to a centre, over that to the nearest one, within which a training state belongs to its basis
MIN_SIZE = 1e-3  # of the largest snapshot, below which one has reduced weight


def body() -> pt.Solid:
    """Return the beam, four nodes across."""
    tissue = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.49)
    return pt.Solid(pt.box((0.2, 0.02, 0.02), 0.02 / 3), tissue, "x-", form="energy")


def full_runs(model: pt.Solid, kind: str, motions: list[Any], folder: Path) -> list[pt.Trajectory]:
    """Return the full model's runs of some motions, from their files where they exist."""
    folder.mkdir(parents=True, exist_ok=True)
    runs = []
    for k, loads in enumerate(motions):
        path = folder / f"{kind}_{k:02d}.h5"
        if not path.exists():
            pt.rollout(model, loads, duration=DURATION, every=EVERY, progress=False).save(path)
        runs.append(pt.Trajectory.load(path))
    return runs


class Loaded(NamedTuple):
    """The linearised body at a state.

    Parameters
    ----------
    displacements : (n, 3) array [m]
    tangent : (f, f) array [1/s^2]
        Stiffness of the free directions, between the roots of the masses.
    frequencies : (k,) array [rad/s]
    modes : (k, f) array
        Orthonormal vibration modes times the roots of the masses.
    """

    displacements: Floats
    tangent: Floats
    frequencies: Floats
    modes: Floats


class Study:
    """The body, its runs, and the inner products and loaded states of the bases."""

    def __init__(self, folder: Path) -> None:
        self.model = model = body()
        self.motions = [random_motion(seed, "inside") for seed in range(TESTED)]
        self.train = full_runs(model, "train", training_motions(TRAINED), folder)
        self.test = full_runs(model, "inside", self.motions, folder)
        self.free = model.free_directions  # (3 n, f), one entry a column
        self.roots = np.sqrt(self.free.T @ np.repeat(model.masses, 3))
        self.displacements = self.rows([run.displacements for run in self.train])
        self.velocities = self.rows([run.velocities for run in self.train])
        self.strain = self._strain_metric()
        states = np.concatenate([run.displacements for run in self.train])
        self.chosen = farthest(self.displacements * self.roots, LOADED_STATES)
        self.loaded = [self.linearised(states[k]) for k in self.chosen]
        self.unseen = [self.linearised(run.displacements[self._busiest(run)]) for run in self.test]

    def rows(self, fields: list[Floats]) -> Floats:
        """Return fields (t, n, 3) of several runs as free displacements (t, f)."""
        return np.asarray((self.free.T @ np.concatenate(fields).reshape(-1, self.free.shape[0]).T).T)

    def fields(self, rows: Floats) -> Floats:
        """Return free displacements (m, f) as fields (m, n, 3)."""
        return np.ascontiguousarray((self.free @ rows.T).T).reshape(len(rows), -1, 3)

    def linearised(self, displacements: Floats) -> Loaded:
        """Return the body's tangent and vibration modes at displacements (n, 3)."""
        tangent = self.roots[:, None] * stiffness(self.model, displacements) / self.roots
        tangent = 0.5 * (tangent + tangent.T)
        values, vectors = scipy.linalg.eigh(tangent, subset_by_index=(0, VIBRATIONS - 1))
        return Loaded(displacements, tangent, np.sqrt(np.maximum(values, 0.0)), vectors.T)

    def _strain_metric(self) -> Floats:
        """Return the inner product (f, f) of du/dX over the volume."""
        matrix = self.model.stencils.products(self.model.volumes)
        dense = matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix)
        every = np.kron(dense, np.eye(3))
        return np.asarray(self.free.T @ (self.free.T @ every).T)

    def _busiest(self, run: pt.Trajectory) -> int:
        return int(np.argmax(np.abs(run.displacements).max(axis=(1, 2))))

    # sources of bases: rows (t, f) with their weights

    def snapshots(self, metric: Floats) -> Floats:
        """Return the displacements of the training with the weights of `palpate.hyper_reduce`."""
        return self.displacements * weights(self.displacements, metric)[:, None]

    def scaled_velocities(self, metric: Floats, share: float) -> Floats:
        """Return the velocities of the training, with a share of the squares of the displacements."""
        rows = self.velocities * weights(self.velocities, metric)[:, None]
        return rows * np.sqrt(share * total(self.snapshots(metric), metric) / total(rows, metric))

    def vibrations(self, metric: Floats, share: float | None = None) -> Floats:
        """Return vibration modes and their derivatives at the loaded states, by their amplitudes in the training.

        The amplitude of a mode is that of the velocities of the snapshots nearest to the state, over the mode's
        frequency; that of a derivative is the product of those of its modes. With a share, their squares are that
        share of those of the snapshots.
        """
        scaled = self.displacements * self.roots
        distances = np.array([np.linalg.norm(scaled - scaled[k], axis=1) for k in self.chosen])
        nearest, result = distances.argmin(axis=0), []
        work, step = self.model.workspace(), DERIVATIVE_STEP * self.model.cloud.spacing
        for k, state in enumerate(self.loaded):
            speeds = (self.velocities[nearest == k] * self.roots) @ state.modes.T
            moving = np.maximum(state.frequencies, 1.0)
            amplitudes = np.sqrt(np.mean(speeds**2, axis=0)) / moving
            rows = state.modes / self.roots
            result.append(rows * amplitudes[:, None])
            shapes = self.fields(rows[:BENT])
            sizes = np.abs(shapes).max(axis=(1, 2))
            shapes = shapes * (step / sizes)[:, None, None]
            factor = scipy.linalg.lu_factor(state.tangent)
            u = state.displacements
            for i in range(BENT):
                for j in range(i, BENT):
                    signs = ((1, 1), (-1, -1), (-1, 1), (1, -1))
                    parts = [self.model.force(u + p * shapes[i] + q * shapes[j], work=work) for p, q in signs]
                    second = (parts[0] + parts[1] - parts[2] - parts[3]) / (4 * step**2) * sizes[i] * sizes[j]
                    force = self.free.T @ (second * self.model.volumes[:, None]).reshape(-1) / self.roots
                    response = scipy.linalg.lu_solve(factor, force) / self.roots
                    result.append(response[None] * amplitudes[i] * amplitudes[j] * (0.5 if i == j else 1.0))
        rows = np.concatenate(result)
        if share is None:
            states = self.displacements[self.chosen]
            states = states * weights(states, metric)[:, None]
            return np.concatenate([rows, states * np.sqrt(total(rows, metric) / total(states, metric))])
        return rows * np.sqrt(share * total(self.snapshots(metric), metric) / total(rows, metric))

    def reduced(self, rows: Floats, runs: list[pt.Trajectory] | None = None, pressures: int | None = None) -> Any:
        """Return the reduced model of a basis (m, f), with all nodes."""
        count = max(1, len(rows) // 4) if pressures is None else pressures
        return hyper_reduce(
            self.model, runs or self.train, modes=0, enrichment=self.fields(rows), cubature=0.0, pressures=count
        )

    def reduced_tangent(self, rom: pt.ReducedModel, state: Loaded) -> tuple[Floats, Floats]:
        """Return the reduced tangent under the load that balances a state, and the basis (f, m) by root masses.

        The reduced state has the projected internal forces of the full one. Newton's method starts at the projection
        in the norm of the tangent.
        """
        q = (self.free.T @ rom.body.vectors.reshape(rom.count, -1).T) * self.roots[:, None]
        weighted = q.T @ state.tangent
        a = np.linalg.solve(weighted @ q, weighted @ (self.roots * (self.free.T @ state.displacements.reshape(-1))))
        full = (self.model.force(state.displacements) * self.model.volumes[:, None]).reshape(-1)
        force = rom.body.vectors.reshape(rom.count, -1) @ full
        work = rom.workspace()

        def rest(at: Floats) -> Floats:
            return rom.body.force(at, work=work) - force

        left = rest(a)
        for _ in range(MAX_NEWTON):
            tangent = rom.body.stiffness(a, work=work)
            change, share = np.linalg.solve(0.5 * (tangent + tangent.T), left), 1.0
            while share > MIN_SHARE and not np.linalg.norm(rest(a + share * change)) < np.linalg.norm(left):
                share *= 0.5
            a = a + share * change
            left = rest(a)
            if np.linalg.norm(left) < NEWTON_TOLERANCE * np.linalg.norm(force):
                break
        tangent = rom.body.stiffness(a, work=work)
        return 0.5 * (tangent + tangent.T), q

    def condensed_mass(self, rom: pt.ReducedModel, state: Loaded) -> Floats:
        """Return the mass matrix with which the reduced tangent has the condensed body's frequencies at a state.

        The body follows the coordinates q^T u with the least energy: u = T a. Its tangent K and its mass T^T T
        have slow frequencies close to the full ones. The result is C^T T^T T C, with the symmetric C for which
        C^T K C is the reduced tangent.
        """
        tangent, q = self.reduced_tangent(rom, state)
        mass = q.T @ q
        softened = scipy.linalg.solve(state.tangent, q, assume_a="sym")
        condensed = np.linalg.inv(q.T @ softened)  # for q^T u = a; here a = mass coordinates
        follow = softened @ condensed @ mass
        condensed = mass @ condensed @ mass
        squares, vectors = scipy.linalg.eigh(tangent, condensed)
        moved = follow @ (vectors * np.sqrt(np.maximum(squares, 0.0))) @ (vectors.T @ condensed)
        return np.asarray(moved.T @ moved)

    def tuned_mass(self, rom: pt.ReducedModel, states: list[Loaded]) -> Floats:
        """Return the mass matrix that gives the slowest reduced modes the full frequencies (median over states)."""
        ratios = []
        for state in states:
            tangent, q = self.reduced_tangent(rom, state)
            squares = scipy.linalg.eigh(tangent, q.T @ q, eigvals_only=True)[:SLOWEST]
            ratios.append(np.sqrt(np.maximum(squares, 0.0)) / state.frequencies[:SLOWEST])
        tangent, q = self.reduced_tangent(rom, self.loaded[0])  # at rest
        mass = q.T @ q
        _, vectors = scipy.linalg.eigh(tangent, mass)
        taken = mass @ vectors[:, :SLOWEST]
        return np.asarray(mass + (taken * (np.median(ratios, axis=0) ** 2 - 1.0)) @ taken.T)

    def excess(self, rom: pt.ReducedModel, mass: Floats | None = None, states: list[Loaded] | None = None) -> Floats:
        """Return the relative excess of the slowest frequencies, by default at the unseen states, (s, k)."""
        result = []
        for state in states or self.unseen:
            tangent, q = self.reduced_tangent(rom, state)
            squares = scipy.linalg.eigh(tangent, q.T @ q if mass is None else mass, eigvals_only=True)[:SLOWEST]
            result.append(np.sqrt(np.maximum(squares, 0.0)) / state.frequencies[:SLOWEST] - 1)
        return np.array(result)

    def projection_errors(self, rows: Floats) -> dict[str, Any]:
        """Return the relative errors of the projections of the unseen runs: median and 95th percentile."""
        q, _ = np.linalg.qr((rows * self.roots).T)
        found = {}
        for name, runs in (
            ("displacement", [run.displacements for run in self.test]),
            ("velocity", [run.velocities for run in self.test]),
        ):
            fields = self.rows(runs) * self.roots
            found[name] = spread(np.linalg.norm(fields - (fields @ q) @ q.T, axis=1), np.linalg.norm(fields, axis=1))
        return found

    def repeated(self, rom: pt.ReducedModel) -> dict[str, Any]:
        """Return the errors over the unseen runs."""
        return summary([tried(rom, loads, full) for loads, full in zip(self.motions, self.test, strict=True)])

    def repeated_alone(self, metric: Floats, count: int) -> dict[str, Any]:
        """Return the errors over the unseen runs, each with a basis of its own snapshots."""
        found = []
        for loads, full in zip(self.motions, self.test, strict=True):
            rows = self.rows([full.displacements])
            basis = compressed(rows * weights(rows, metric)[:, None], metric, count)
            found.append(tried(self.reduced(basis, [full]), loads, full))
        return summary(found)


def spread(missed: Floats, sizes: Floats) -> dict[str, float]:
    """Return median and 95th percentile of errors over sizes, which are at least a hundredth of the largest."""
    relative = missed / np.maximum(sizes, 1e-2 * sizes.max())
    return {"median": float(np.median(relative)), "percentile_95": float(np.quantile(relative, 0.95))}


def with_mass(rom: pt.ReducedModel, mass: Floats) -> pt.ReducedModel:
    """Return a reduced model with another mass matrix of its coordinates."""
    inverse = np.linalg.inv(mass)
    changed = pt.ReducedModel(rom.data)
    changed.__dict__["body"] = replace(
        changed.body,
        constants=changed.body.constants._replace(mass=mass, inverse_mass=inverse, constrained_inverse_mass=inverse),
    )
    return changed


def farthest(rows: Floats, count: int) -> list[int]:
    """Return the numbers of rows that are far from each other, the first (rest) included."""
    chosen, distances = [0], np.linalg.norm(rows - rows[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distances)))
        distances = np.minimum(distances, np.linalg.norm(rows - rows[chosen[-1]], axis=1))
    return chosen


def weights(rows: Floats, metric: Floats) -> Floats:
    """Return 1 over the root of each row's size."""
    sizes = np.sqrt(np.maximum(np.einsum("tf,tf->t", rows @ metric, rows), 0.0))
    return np.asarray(np.maximum(sizes, MIN_SIZE * sizes.max()) ** -0.5)


def total(rows: Floats, metric: Floats) -> float:
    """Return the sum of squares of rows."""
    return float(np.einsum("tf,tf->", rows @ metric, rows))


def compressed(rows: Floats, metric: Floats, count: int) -> Floats:
    """Return the main rows (m, f) of some in an inner product."""
    root = np.linalg.cholesky(metric)
    image = rows @ root
    _, vectors = scipy.linalg.eigh(image.T @ image, subset_by_index=(len(root) - count, len(root) - 1))
    return np.asarray(scipy.linalg.solve_triangular(root.T, vectors[:, ::-1], lower=False).T)


def study_rollouts(study: Study) -> list[Any]:
    """Errors of unseen runs with as many coordinates, for each basis and correction."""
    table: list[Any] = []
    strain, rest = study.strain, study.loaded[0].tangent
    energy = study.roots[:, None] * rest * study.roots
    snapshots = study.snapshots(strain)
    sources = {
        "present: strain of the snapshots": (strain, snapshots),
        "energy of the snapshots at rest": (energy, study.snapshots(energy)),
        "with velocities, 0.3 of the squares": (strain, [snapshots, study.scaled_velocities(strain, 0.3)]),
        "with loaded vibrations, 0.1": (strain, [snapshots, study.vibrations(strain, 0.1)]),
        "with loaded vibrations, 1": (strain, [snapshots, study.vibrations(strain, 1.0)]),
        "loaded vibrations and states alone": (strain, study.vibrations(strain)),
    }
    for count in SIZES:

        def add(name: str, rom: pt.ReducedModel, mass: Floats | None = None, count: int = count, **more: Any) -> None:
            errors = study.repeated(rom if mass is None else with_mass(rom, mass))
            excess = study.excess(rom, mass)
            row = {"coordinates": count, "basis": name, "errors": errors, "excess": float(np.median(excess))}
            table.append(row | {"excess_of_each": np.median(excess, axis=0).tolist()} | more)
            shown(table[-1])

        for name, (metric, rows) in sources.items():
            basis = compressed(np.concatenate(rows) if isinstance(rows, list) else rows, metric, count)
            rom = study.reduced(basis)
            add(name, rom, projection=study.projection_errors(basis))
            if name.startswith("present"):
                present = rom
                add("present, all pressure modes", study.reduced(basis, pressures=200))
        add("present, mass of the slowest modes at rest", present, study.tuned_mass(present, study.loaded[:1]))
        add("present, mass of the slowest modes, loaded", present, study.tuned_mass(present, study.loaded))
        add("present, condensed mass at rest", present, study.condensed_mass(present, study.loaded[0]))
        table.append(
            {"coordinates": count, "basis": "of each run itself", "errors": study.repeated_alone(strain, count)}
        )
        shown(table[-1])
    return table


def shown(row: dict[str, Any]) -> None:
    """Print a row."""
    cells = [f"{row['coordinates']} {row['basis']:45s}"]
    for name in ("displacement", "velocity"):
        cells.append(f"{name} {row['errors'][name]['median']:.1%} {row['errors'][name]['percentile_95']:.1%}")
    cells.append(str(np.round(100 * np.array(row.get("excess_of_each", ())), 2)))
    print("  ".join(cells), flush=True)


def study_local(study: Study) -> list[Any]:
    """Bases about the centres of clusters of the training states: what they miss, and what a switch changes."""
    table: list[Any] = []
    metric, rest = study.strain, study.loaded[0].tangent
    scale = weights(study.displacements, np.diag(study.roots**2))[:, None]
    unseen = study.rows([run.displacements for run in study.test])
    speeds = study.rows([run.velocities for run in study.test])
    for clusters in CLUSTERS:
        centres = clustered(study.displacements, study.displacements * scale * study.roots, clusters)
        near, nearest = (distances(rows, centres, study.roots) for rows in (study.displacements, unseen))
        label = nearest.argmin(axis=1)
        for count in SIZES:
            missed, moved, bases = np.zeros(len(unseen)), np.zeros(len(unseen)), []
            for j, centre in enumerate(centres):
                rows = study.displacements[near[:, j] <= NEAR * near.min(axis=1)] - centre
                q, _ = np.linalg.qr((compressed(rows * weights(rows, metric)[:, None], metric, count) * study.roots).T)
                bases.append((centre * study.roots, q))
                for into, fields in ((missed, (unseen - centre) * study.roots), (moved, speeds * study.roots)):
                    own = fields[label == j]
                    into[label == j] = np.linalg.norm(own - (own @ q) @ q.T, axis=1)
            surplus, excess = [], []
            for state in study.unseen:
                y = study.roots * (study.free.T @ state.displacements.reshape(-1))
                centre, q = bases[int(np.argmin([np.linalg.norm(y - c) for c, _ in bases]))]
                a = np.linalg.solve(q.T @ state.tangent @ q, q.T @ state.tangent @ (y - centre))
                left = y - centre - q @ a
                surplus.append(left @ state.tangent @ left / (y @ rest @ y))
                squares = scipy.linalg.eigvalsh(q.T @ state.tangent @ q)[:SLOWEST]
                excess.append(np.sqrt(np.maximum(squares, 0.0)) / state.frequencies[:SLOWEST] - 1)
            table.append({
                "clusters": clusters, "coordinates": count,
                "displacement": spread(missed, np.linalg.norm(unseen * study.roots, axis=1)),
                "velocity": spread(moved, np.linalg.norm(speeds * study.roots, axis=1)),
                "surplus": float(np.mean(surplus)), "excess": float(np.median(excess)),
                "states": np.bincount(near.argmin(axis=1), minlength=clusters).tolist(),
            })  # fmt: skip
            print(table[-1], flush=True)
    return table


def distances(rows: Floats, centres: Floats, roots: Floats) -> Floats:
    """Return the distances (t, k) of rows from centres in the mass norm."""
    return np.stack([np.linalg.norm((rows - centre) * roots, axis=1) for centre in centres], axis=1)


def clustered(rows: Floats, scaled: Floats, count: int) -> Floats:
    """Return centres (k, f) of clusters of rows, by k-means on scaled ones; one cluster has its centre at rest."""
    if count == 1:
        return np.zeros((1, rows.shape[1]))
    centres = scaled[farthest(scaled, count)]
    for _ in range(20):
        label = np.argmin(np.sum(centres**2, axis=1) - 2 * scaled @ centres.T, axis=1)
        centres = np.array(
            [scaled[label == j].mean(axis=0) if np.any(label == j) else centres[j] for j in range(count)]
        )
    return np.array([rows[label == j].mean(axis=0) for j in range(count) if np.any(label == j)])


def study_states(study: Study) -> list[Any]:
    """By how much the slowest frequencies are too high with the present basis, by the displacement of the state."""
    table = []
    for count in SIZES:
        rom = study.reduced(compressed(study.snapshots(study.strain), study.strain, count))
        for kind, states in (("trained", study.loaded), ("unseen", study.unseen)):
            for state, excess in zip(states, study.excess(rom, states=states), strict=True):
                row = {"coordinates": count, "kind": kind, "excess": float(np.median(excess))}
                table.append(row | {"largest_displacement": float(np.abs(state.displacements).max())})
    return table


STUDIES: dict[str, Callable[[Study], Any]] = {"rollouts": study_rollouts, "local": study_local, "states": study_states}


def main() -> None:
    """Run the studies asked for and store their figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="*", choices=[[], *STUDIES])
    parser.add_argument("--runs", type=Path, default=Path("out/bases"))
    args = parser.parse_args()
    study, results = Study(args.runs), result_files.read("bases", {})
    for name in args.studies or STUDIES:
        began = perf_counter()
        results[name] = STUDIES[name](study)
        result_files.write("bases", results)
        print(f"{name}: {perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
