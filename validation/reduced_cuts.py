"""Reduced models of a cut liver against the full one: opening, forces, energy release, and the period of a loop.

    python validation/reduced_cuts.py [--nodes 3000 5000]

A generated liver is attached at its back. A cut of 40 mm and a depth of 15 mm is on its front. Two patches next to
the cut are moved apart, or one of them is lifted. `LENGTHS` are cuts of which only the cost is measured.

The basis of a reduced model are modes of the *uncut* body and lifting vectors of the patches, from runs of it, and one
of these additions:

- nodes near the cut that are free;
- columns: the main parts of K1^-1 (K0 - K1) q, by which the static responses of cut and uncut body (stiffness K1 and
  K0) differ under the loads that cause a training state q of the uncut one. They are made for the cut, or for one that
  is two spacings shorter.

`pt.cut_reduced` adds ten columns and second-order responses of four shapes, and moments of the dilatation in place of
the dilatations of changed nodes.

*Projected* models sum the energy of all nodes, so that their errors are those of the basis. *Sampled* models sum that
of the nodes whose stencils the cut has changed, with their own weights and smoothed dilatations, and that of few others
with weights and moments fitted to training states with the static response of the cut. All terms are energies with
positive weights. Results are kept in docs/validation/reduced_cuts.json, and printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from time import thread_time
from typing import Any

import cuts
import numpy as np
import organs
import result_files
import scipy.linalg
import scipy.sparse as sparse
from numba import njit
from scipy.spatial import cKDTree

import palpate as pt
from palpate.arrays import Floats, Ints
from palpate.dynamics.nodal.stability import stable_step
from palpate.meshfree.cut.surface import swept
from palpate.reduction.basis.linear_modes import rest_stiffness
from palpate.reduction.hyper.cubature import Cubature, fit_moments
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.training.ecsw import choose_integration_points, deformation

LENGTH, DEPTH = 0.04, 0.015  # of the cut [m]
LENGTHS = (0.02, 0.04, 0.08)
BACK, BEYOND = 0.0053, 3.0  # [m] from where the back is attached; of the cut beyond the surface, in spacings
ASIDE, PATCH = 0.015, (0.015, 0.006)  # from the cut to a patch's center, and half its length and width [m]
MODES, COLUMNS, MOMENTS = 20, 10, 8
SHORTER, ADVANCE = 2.0, 0.25  # of an older cut, and of the front whose energy release is measured, in spacings
FREE, FREE_AT_NEW = 3.0, 2.0  # distance of free nodes from the cut, or from its new part, in spacings
TOUGHNESS = 20.0  # [J/m^2]
RAMP, DURATION, FRAMES = 0.2, 0.4, 0.01  # of the runs [s]
MASS_DAMPING = 8.0  # [1/s]
STATES, CUBATURE = 60, 3e-3  # training states and error of the far terms
PERIOD = 1e-3  # [s]
FEATURE = "pt.cut_reduced"
REPEATS, BATCHES = 20, 60  # evaluations; the fastest batch counts, in time of the processor
# bases of which sampled models are made, and run
SAMPLED = ("modes", "modes, 10 columns", "modes, 10 older columns, free nodes")
DIFFERENCE = 1e-4  # of displacements, in spacings
# motions of the patches at +z and -z of the cut [m]; x along it, y into the body
TRAINING = (
    ((0.0, 0.0, 0.007), (0.0, 0.0, -0.007)),
    ((0.004, 0.0, 0.0), (-0.004, 0.0, 0.0)),
    ((0.0, -0.006, 0.0), (0.0, 0.004, 0.0)),
    ((0.0, 0.0, 0.004), (0.0, -0.004, 0.002)),
    ((0.003, 0.003, -0.002), (-0.002, -0.005, -0.003)),
)
PULLS = {
    "apart": ((0.0, 0.0, 0.006), (0.0, 0.0, -0.006)),
    "lifted": ((0.0, -0.006, 0.002), (0.0, 0.0, 0.0)),
}


def moves(pull: Any) -> list[pt.PrescribedMotion]:
    """Return the motions of the patches: a smooth ramp, then rest."""
    return [_moved(name, way) for name, way in zip(("one", "other"), pull, strict=True)]


def _moved(name: str, way: Any) -> pt.PrescribedMotion:
    return pt.PrescribedMotion(name, lambda _, t: np.array(way) * (0.5 - 0.5 * np.cos(np.pi * min(t / RAMP, 1.0))))


class Liver:
    """A liver with patches, its cuts, and the statics of the uncut body."""

    def __init__(self, nodes: int) -> None:
        surface = organs.surface("generated")
        cloud = pt.fill(surface, organs.spacing_for(surface, nodes))
        points, on, self.spacing = cloud.points, cloud.group("surface"), cloud.spacing
        front = on[points[on, 1] < np.quantile(points[on, 1], 0.3)]
        self.center = np.median(points[front], axis=0)
        self.front = np.polyfit(*points[front[self._near(points[front])]][:, :2].T, 2)  # height y of the line by x
        self.center[1] = np.polyval(self.front, self.center[0])
        groups = {"surface": on, "back": on[points[on, 1] > BACK]}
        for name, side in (("one", 1.0), ("other", -1.0)):
            offset = np.abs(points[front] - self.center - (0.0, 0.0, side * ASIDE))
            groups[name] = front[(offset[:, 0] < PATCH[0]) & (offset[:, 2] < PATCH[1])]
        self.cloud = replace(cloud, groups=groups)
        material = pt.materials.MooneyRivlin(C1=1000.0, C2=0.0, poisson=0.45, density=1000.0)
        self.body: Any = pt.Solid(self.cloud, material, fixed="back", mass_damping=MASS_DAMPING)
        self.held = np.concatenate([self.cloud.group(name) for name in ("back", "one", "other")])

    def _near(self, places: Floats) -> Any:
        offset = np.abs(places - self.center)
        return (offset[:, 0] < LENGTH) & (offset[:, 2] < 1.5 * self.spacing)

    def triangles(self, length: float, advance: float = 0.0) -> Floats:
        """Return the triangles of a cut that begins at a fixed place."""
        start = self.center[0] - LENGTH / 2
        x = np.linspace(start, start + length + advance, max(2, round(length / (2 * self.spacing)) + 1))
        y = np.polyval(self.front, np.clip(x, self.center[0] - LENGTH, self.center[0] + LENGTH))
        z = np.full_like(x, self.center[2])
        edges = [np.stack([x, y + shift, z], axis=1) for shift in (DEPTH, -BEYOND * self.spacing)]
        return swept(np.stack(edges, axis=1))

    def cut(self, length: float, advance: float = 0.0) -> Any:
        return pt.cut(self.body, self.triangles(length, advance))

    def opening(self, displacements: Floats) -> float:
        """Return the gap [m] in the middle of the cut at the surface, from linear fits on either side."""
        offset, sides = self.cloud.points - self.center, []
        for side in (1.0, -1.0):
            near = (np.linalg.norm(offset, axis=1) < 2.6 * self.spacing) & (side * offset[:, 2] > 0)
            terms = np.column_stack([np.ones(near.sum()), offset[near]])
            sides.append(np.linalg.lstsq(terms, displacements[near, 2], rcond=None)[0][0])
        return float(sides[0] - sides[1])

    @cached_property
    def free(self) -> Ints:
        """Numbers of the components that are neither supported nor prescribed."""
        free = np.ones((len(self.cloud), 3), dtype=bool)
        free[self.held] = False
        return np.flatnonzero(free)

    @cached_property
    def stiffness(self) -> Any:
        return rest_stiffness(self.body)

    @cached_property
    def factor(self) -> Any:
        matrix = self.stiffness[self.free][:, self.free].toarray(order="F")
        return scipy.linalg.cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)


def forces(body: Any, displacements: Floats, work: Any) -> Floats:
    """Return the internal nodal forces (n, 3) [N]."""
    return np.asarray(body.force(displacements, work=work) * body.volumes[:, None])


def stiffness_times(body: Any, fields: Floats) -> Floats:
    """Return the stiffness at rest times fields (k, n, 3), by differences of forces."""
    work, result = body.workspace(), np.empty_like(fields)
    for field, row in zip(fields, result, strict=True):
        step = DIFFERENCE * body.cloud.spacing / max(np.abs(field).max(), 1e-300)
        row[:] = (forces(body, -step * field, work) - forces(body, step * field, work)) / (2 * step)
    return result


def static_changes(liver: Liver, body: Any, fields: Floats) -> tuple[Floats, int]:
    """Return K1^-1 (K0 - K1) q of fields q (k, n, 3), and the iterations of conjugate gradients.

    The factor of the uncut body preconditions them.
    """
    free, flat = liver.free, (len(fields), -1)
    right = (stiffness_times(liver.body, fields) - stiffness_times(body, fields)).reshape(flat)[:, free]
    solution, residual = np.zeros_like(right), right.copy()

    def solve(rows: Floats) -> Floats:
        return np.asarray(scipy.linalg.cho_solve(liver.factor, rows.T, check_finite=False).T)

    def apply(rows: Floats) -> Floats:
        full = np.zeros((len(rows), 3 * len(liver.cloud)))
        full[:, free] = rows
        return stiffness_times(body, full.reshape(len(rows), -1, 3)).reshape(len(rows), -1)[:, free]

    sizes, iterations = np.linalg.norm(right, axis=1), 0
    direction = image = solve(residual)
    product = np.sum(residual * image, axis=1)
    while np.any(np.linalg.norm(residual, axis=1) > 1e-3 * sizes) and iterations < 100:
        moved = apply(direction)
        step = (product / np.maximum(np.sum(direction * moved, axis=1), 1e-300))[:, None]
        solution, residual = solution + step * direction, residual - step * moved
        image, before = solve(residual), product
        product = np.sum(residual * image, axis=1)
        direction = image + (product / np.maximum(before, 1e-300))[:, None] * direction
        iterations += 1
    result = np.zeros((len(fields), 3 * len(liver.cloud)))
    result[:, free] = solution
    return result.reshape(fields.shape), iterations


@dataclass
class Trained:
    """A reduced model of the uncut body, and the parts of its basis."""

    model: pt.ReducedModel
    modes: Floats  # (m, n, 3)
    lifting: Floats  # (l, n, 3)
    states: Floats  # (t, m + l)

    @property
    def fields(self) -> Floats:
        return np.concatenate([self.modes, self.lifting])


def train(liver: Liver) -> Trained:
    """Reduce the uncut body."""
    runs = [
        pt.rollout(liver.body, moves(pull), duration=DURATION, every=FRAMES, progress=False) for pull in TRAINING
    ]  # fmt: skip
    model = pt.hyper_reduce(liver.body, runs, modes=MODES, prescribed=("one", "other"))
    data = model.data
    vectors = data.basis_vectors
    states = data.training_states
    return Trained(
        model, vectors[: data.modes], vectors[data.modes : model.count],
        states[np.linspace(0, len(states) - 1, STATES).astype(int)],
    )  # fmt: skip


@dataclass
class Columns:
    """Columns of a cut body, the coordinates that they have in training states, and how they were made."""

    fields: Floats  # (k, n, 3), orthonormal in the volumes
    states: Floats  # (t, k)
    iterations: int
    seconds: float


def columns_of(liver: Liver, trained: Trained, bodies: list[Any], count: int) -> Columns:
    """Return the main parts, in the volumes, of the static changes that cuts cause in the training states.

    The states are combined first to as many as there shall be columns, for the work of their forces D q on the uncut
    body's response K0^-1 D q. With several cuts, the coordinates are those of their mean.
    """
    begin, iterations, responses = thread_time(), 0, []
    for body in bodies:
        right = stiffness_times(liver.body, trained.fields) - stiffness_times(body, trained.fields)
        flat = right.reshape(len(right), -1)[:, liver.free]
        energies = flat @ scipy.linalg.cho_solve(liver.factor, flat.T, check_finite=False)
        values, vectors = np.linalg.eigh(0.5 * (energies + energies.T))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        combined = np.linalg.svd(trained.states @ root, full_matrices=False)[0][:, : -(-count // len(bodies))]
        changes, taken = static_changes(liver, body, np.tensordot(combined.T @ trained.states, trained.fields, 1))
        responses.append(np.tensordot(combined, changes, 1))
        iterations = max(iterations, taken)
    weights = np.sqrt(liver.body.volumes)[:, None]
    rows = (np.concatenate(responses) * weights).reshape(-1, 3 * len(weights))
    shapes = np.linalg.svd(rows, full_matrices=False)[2][:count]
    coordinates = (rows @ shapes.T).reshape(len(bodies), -1, count).mean(axis=0)
    fields = shapes.reshape(count, -1, 3) / weights
    return Columns(fields, coordinates, iterations, thread_time() - begin)


def with_free(columns: Columns, nodes: Ints) -> Columns:
    """Return columns and the fields of single components of nodes, which have no coordinates in training states."""
    n = columns.fields.shape[1]
    loose = np.zeros((len(nodes), 3, n, 3))
    for c in range(3):
        loose[np.arange(len(nodes)), c, nodes, c] = 1.0
    fields = np.concatenate([columns.fields, loose.reshape(-1, n, 3)])
    return replace(columns, fields=fields, states=np.pad(columns.states, ((0, 0), (0, 3 * len(nodes)))))


def near_cut(liver: Liver, triangles: Floats, reach: float) -> Ints:
    """Return the nodes within a distance [m] of triangles that are neither supported nor prescribed."""
    shares = np.random.default_rng(0).dirichlet(np.ones(3), 200)
    samples = np.einsum("sk,tkc->tsc", shares, triangles).reshape(-1, 3)
    distance, _ = cKDTree(samples).query(liver.cloud.points)
    return np.setdiff1d(np.flatnonzero(distance < reach), liver.held)


@dataclass
class Static:
    """A static state under a pull."""

    displacements: Floats
    force: Floats  # (3,) [N] on the first patch

    def figures(self, liver: Liver, exact: Static, bodies: tuple[Any, Any], area: float) -> dict[str, float]:
        """Return signed errors of opening, force, energy release and force of a blade, and that of the field."""
        release, true = (release_of(bodies, each.displacements, area) for each in (self, exact))
        along = exact.force / np.linalg.norm(exact.force)
        return {
            "opening": liver.opening(self.displacements) / liver.opening(exact.displacements) - 1,
            "force": float(self.force @ along) / float(np.linalg.norm(exact.force)) - 1,
            "release": release / true - 1,
            "blade": (TOUGHNESS - release) / (TOUGHNESS - true) - 1,
            "field": float(
                np.linalg.norm(self.displacements - exact.displacements) / np.linalg.norm(exact.displacements)
            ),
        }  # fmt: skip


def release_of(bodies: tuple[Any, Any], displacements: Floats, area: float) -> float:
    """Return the energy [J/m^2] that an advance of the front releases at fixed displacements."""
    before, after = (body.strain_energy(displacements) for body in bodies)
    return float(before - after) / area


def exact_statics(body: Any, pull: Any) -> Static:
    loads = [pt.PrescribedMotion(name, way) for name, way in zip(("one", "other"), pull, strict=True)]
    rest = pt.equilibrium(body, loads)
    return Static(rest.displacements, rest.reactions["one"])


def lifted(trained: Trained, pull: Any) -> Floats:
    """Return the lifting coordinates of translations of the patches; the first three of each are those."""
    result = np.zeros(len(trained.lifting))
    for k, way in enumerate(pull):
        result[k * len(trained.lifting) // 2 :][:3] = way
    return result


def newton(force: Callable[[Floats], Floats], tangent: Callable[[Floats], Floats], count: int) -> Floats:
    """Return coordinates without forces."""
    a, residual = np.zeros(count), force(np.zeros(count))
    for _ in range(12):
        step = scipy.linalg.lstsq(tangent(a), residual, cond=1e-12, check_finite=False)[0]
        for _ in range(5):  # shorter steps where tissue would be crushed
            trial = force(a + step)
            if np.linalg.norm(trial) < np.linalg.norm(residual):
                break
            step = 0.5 * step
        a, residual = a + step, trial
        if np.linalg.norm(step) < 1e-5 * np.linalg.norm(a):
            break
    return a


def projected_statics(body: Any, trained: Trained, basis: Floats, pull: Any) -> Static:
    """Return the statics of a basis (m, n, 3) with the energy of all nodes."""
    work, start = body.workspace(), np.tensordot(lifted(trained, pull), trained.lifting, 1)
    basis = basis / np.abs(basis).max(axis=(1, 2), keepdims=True)
    flat, step = basis.reshape(len(basis), -1), DIFFERENCE * body.cloud.spacing

    def at(a: Floats) -> Floats:
        return start + (a @ flat).reshape(start.shape)

    def tangent(a: Floats) -> Floats:
        u, rows = at(a), np.empty((len(flat), len(flat)))
        for field, row in zip(step * basis, rows, strict=True):
            row[:] = flat @ (forces(body, u - field, work) - forces(body, u + field, work)).ravel() / (2 * step)
        return 0.5 * (rows + rows.T)

    a = newton(lambda a: flat @ forces(body, at(a), work).ravel(), tangent, len(flat))
    u = at(a)
    return Static(u, -np.tensordot(trained.lifting[:3], forces(body, u, work), 2))


def frequency_of(body: Any, basis: Floats) -> float:
    """Return the highest frequency [rad/s] at rest of a basis."""
    flat = basis.reshape(len(basis), -1)
    stiffness = flat @ stiffness_times(body, basis).reshape(flat.shape).T
    mass = (flat * np.repeat(body.masses, 3)) @ flat.T
    return float(np.sqrt(scipy.linalg.eigvalsh(0.5 * (stiffness + stiffness.T), mass)[-1]))


def smoothing_matrix(body: Any) -> Any:
    """Return the matrix of the smoothing, sparse (n, n)."""
    near, weights, own = body.smoothing
    n = len(near)
    rows = np.repeat(np.arange(n), near.shape[1])
    return (sparse.csr_array((weights.ravel(), (rows, near.ravel())), (n, n)) + sparse.diags_array(own)).tocsr()


def sampled_model(
    trained: Trained, body: Any, columns: Columns, seconds: dict[str, float], also: Ints | None = None
) -> pt.ReducedModel:
    """Return a reduced model with additional columns: changed and some other nodes exactly, the rest sampled."""
    data: ReducedData = trained.model.data
    first = len(trained.fields)
    tests = data.basis_vectors[first : len(data.basis_vectors) - data.residual_fields]
    basis = np.concatenate([trained.modes, columns.fields, trained.lifting, tests])
    states = np.hstack([trained.states[:, : data.modes], columns.states, trained.states[:, data.modes :]])
    count, modes = states.shape[1], data.modes + len(columns.fields)
    begin = thread_time()
    fields = body.at_points(basis, slice(count, None))
    flat = basis[:count].reshape(count, -1)
    mass = (flat * np.repeat(body.masses, 3)) @ flat.T
    touched, smooth = body.cut_state.touched.copy(), smoothing_matrix(body)
    touched[[] if also is None else also] = True
    roots = np.sqrt(body.tissue.lame * body.volumes)
    theta = np.array([smooth @ (deformation(fields.gradients[:, :count], state)[2] - 1) for state in states])
    _, _, shapes = np.linalg.svd(theta * roots * ~touched, full_matrices=False)
    moments = np.asarray((shapes[:MOMENTS] * roots * ~touched) @ smooth)
    exact = np.asarray((sparse.diags_array(roots) @ smooth)[touched].todense())
    ring = np.any(exact != 0.0, axis=0) & ~touched
    others = np.flatnonzero(~touched)
    far = replace(fields, gradients=fields.gradients[others], nodes=others, volumes=fields.volumes[others])
    _, rule = choose_integration_points(body, far, modes, states, mass, CUBATURE, moments[:, others], 0)
    weights = np.where(touched, fields.volumes, 0.0)
    weights[rule.nodes] = rule.weights
    points = np.flatnonzero(touched | ring | (weights > 0))
    sampled, summed = [], []
    for state in (np.zeros(count), *states):
        _, cofactor, J = deformation(fields.gradients[:, :count], state)
        slope = np.matmul(fields.gradients[:, :count], cofactor.reshape(-1, 9, 1).astype(fields.gradients.dtype))[
            ..., 0
        ]
        rows = np.column_stack([slope, (J - 1) / max(float(np.linalg.norm(state)), 1e-300) * bool(state.any())])
        sampled.append(rows[points])
        summed.append(moments @ rows)
    fitted = fit_moments(np.hstack(sampled), np.hstack(summed))
    pressure = np.concatenate([exact[:, points], fitted])
    seconds["terms"] = thread_time() - begin
    return pt.ReducedModel(
        replace(
            data, basis_vectors=basis, modes=modes, gradients=np.asarray(fields.gradients[points], dtype=float),
            cubature=Cubature(points, weights[points], pressure, rule.residual), constant=fields.constant,
            training_states=states, residual_fields=0,
        )
    )  # fmt: skip


def sampled_statics(trained: Trained, model: pt.ReducedModel, pull: Any) -> Static:
    modes, work = model.data.modes, model.workspace()
    lifting = lifted(trained, pull)

    def full(a: Floats) -> Floats:
        return np.concatenate([a, lifting])

    a = full(newton(
        lambda a: model.body.force(full(a), work=work)[:modes],
        lambda a: model.body.stiffness(full(a), work=work)[:modes, :modes], modes,
    ))  # fmt: skip
    return Static(np.tensordot(a, model.body.vectors, 1), -model.body.force(a, work=work)[modes : modes + 3])


def evaluation_time(model: pt.ReducedModel) -> float:
    """Return the time [s] of an evaluation of the forces by the compiled kernel."""
    work, force, points = model.workspace(), model.body.sampled_force, model.body.points

    @njit
    def repeat(count, force, a, points, scratch, result):  # type: ignore[no-untyped-def]
        for _ in range(count):
            force(a, points, scratch, result)

    a = 1e-3 * model.data.training_states[-1]
    times = []
    for count in (1, *[REPEATS] * BATCHES):
        begin = thread_time()
        repeat(count, force, a, points, work.coordinates, work.force)
        times.append((thread_time() - begin) / count)
    return min(times[1:])


def full_time(body: Any) -> float:
    """Return the time [s] of an evaluation of the forces of a full body."""
    work, u, times = body.workspace(), np.zeros((len(body.cloud), 3)), []
    for _ in range(BATCHES):
        begin = thread_time()
        for _ in range(REPEATS):
            body.force(u, work=work)
        times.append((thread_time() - begin) / REPEATS)
    return min(times)


def stepping(seconds: float, frequency: float, damping: float) -> dict[str, float]:
    """Return the time of an evaluation, the stable step, and the computing time of a period [s]."""
    step = stable_step(frequency, damping)
    return {"evaluation": seconds, "step": step, "period": seconds * float(np.ceil(PERIOD / step))}


def dynamics(liver: Liver, body: Any, models: dict[str, Any]) -> list[dict[str, Any]]:
    """Return errors of openings and forces in runs, root mean squares over the largest, and the trust numbers."""
    rows = []
    for name, pull in PULLS.items():
        exact, *runs = (
            pt.rollout(each, moves(pull), duration=DURATION, every=FRAMES, progress=False)
            for each in (body, *models.values())
        )
        opening = np.array([liver.opening(u) for u in exact.displacements])
        force = exact.reactions["one"]
        for label, run in zip(models, runs, strict=True):
            missed = np.array([liver.opening(u) for u in run.displacements]) - opening
            rows.append({
                "pull": name, "basis": label, "opening": rms(missed) / float(np.abs(opening).max()),
                "force": rms(run.reactions["one"] - force) / float(np.linalg.norm(force, axis=1).max()),
                "trust": float(run.trust.max()),
            })  # fmt: skip
            print(rows[-1], flush=True)
    return rows


def rms(values: Floats) -> float:
    """Return the root mean square of values (t,), or of the norms of vectors (t, 3)."""
    return float(np.sqrt(np.mean(np.sum(values.reshape(len(values), -1) ** 2, axis=1))))


def nodes_of_stencils(body: Any, nodes: Ints) -> Ints:
    """Return the nodes whose stencils contain some of the nodes."""
    near = body.stencils.neighbours
    return np.flatnonzero(np.isin(near, nodes).any(axis=1) | np.isin(np.arange(len(near)), nodes))


def study(nodes: int) -> dict[str, Any]:
    """Measure a liver of about so many nodes."""
    liver = Liver(nodes)
    h, n = liver.spacing, len(liver.cloud)
    cut, ahead, older = liver.cut(LENGTH), liver.cut(LENGTH, ADVANCE * h), liver.cut(LENGTH - SHORTER * h)
    bodies, area = (cut, ahead), ADVANCE * h * DEPTH
    exact = {name: exact_statics(cut, pull) for name, pull in PULLS.items()}
    uncut = {name: exact_statics(liver.body, pull) for name, pull in PULLS.items()}
    trained = train(liver)
    begin = thread_time()
    assert liver.factor is not None
    found: dict[str, Any] = {
        "nodes": n, "spacing": h, "touched": int(cut.cut_state.touched.sum()), "factor_seconds": thread_time() - begin,
        "modes": len(trained.modes), "lifting": len(trained.lifting),
        "full": stepping(full_time(cut), cut.stability.highest_frequency, cut.stiffness_damping),
        "exact": [
            {
                "pull": name, "opening": liver.opening(each.displacements),
                "uncut_opening": liver.opening(uncut[name].displacements), "force": float(np.linalg.norm(each.force)),
                "release": release_of(bodies, each.displacements, area),
            }
            for name, each in exact.items()
        ],
    }  # fmt: skip
    print(found, flush=True)
    same = columns_of(liver, trained, [cut], COLUMNS)
    old = columns_of(liver, trained, [older], COLUMNS)
    around = [liver.cut(LENGTH, side * SHORTER / 2 * h) for side in (-1.0, 1.0)]
    both = columns_of(liver, trained, around, 2 * COLUMNS)
    free = near_cut(liver, liver.triangles(LENGTH), FREE * h)
    new = liver.triangles(LENGTH)
    new = new[new[..., 0].max(axis=1) > liver.center[0] + LENGTH / 2 - SHORTER * h]
    at_new = near_cut(liver, new, FREE_AT_NEW * h)
    nothing = Columns(np.zeros((0, n, 3)), np.zeros((STATES, 0)), 0, 0.0)
    bases: dict[str, tuple[Columns, Ints | None]] = {
        "modes": (nothing, None), "modes, free nodes": (with_free(nothing, free), free),
        "modes, 10 columns": (same, None),
        "modes, 10 older columns": (old, None), "modes, 10 older columns, free nodes": (with_free(old, at_new), at_new),
        "modes, 20 columns of the cuts around": (both, None),
    }  # fmt: skip
    found["columns"] = [
        {"basis": name, "iterations": each.iterations, "seconds": each.seconds} for name, (each, _) in bases.items()
        if each.iterations
    ]  # fmt: skip
    print(found["columns"], flush=True)
    rows: list[dict[str, Any]] = []
    models: dict[str, Any] = {}
    for name, (columns, nodes_free) in bases.items():
        basis = np.concatenate([trained.modes, columns.fields])
        terms = None if nodes_free is None else nodes_of_stencils(cut, nodes_free)
        row: dict[str, Any] = {"basis": name, "coordinates": len(basis), "terms": None, "projected": {}, "sampled": {}}
        for pull, way in PULLS.items():
            state = projected_statics(cut, trained, basis, way)
            row["projected"][pull] = state.figures(liver, exact[pull], bodies, area)
        if name in SAMPLED:
            seconds: dict[str, float] = {}
            model = models[name] = sampled_model(trained, cut, columns, seconds, terms)
            for pull, way in PULLS.items():
                row["sampled"][pull] = sampled_statics(trained, model, way).figures(liver, exact[pull], bodies, area)
            frequency = model.body.highest_frequency(np.zeros(model.count))
            row |= stepping(evaluation_time(model), frequency, model.stiffness_damping)
            row |= {"terms": len(model.data.cubature.nodes), "terms_seconds": seconds["terms"]}
        elif terms is not None:
            row["terms"] = len(np.union1d(terms, np.flatnonzero(cut.cut_state.touched)))
            row["step"] = stable_step(frequency_of(cut, basis), cut.stiffness_damping)
        rows.append(row)
        print(row, flush=True)
    begin = thread_time()
    model = models[FEATURE] = pt.cut_reduced(trained.model, liver.body, liver.triangles(LENGTH), columns=COLUMNS)
    row = {"basis": FEATURE, "coordinates": model.data.modes, "terms": len(model.data.cubature.nodes)}
    row |= {"terms_seconds": thread_time() - begin, "projected": {}, "sampled": {}}
    for pull, way in PULLS.items():
        state = projected_statics(cut, trained, model.body.vectors[: model.data.modes], way)
        row["projected"][pull] = state.figures(liver, exact[pull], bodies, area)
        row["sampled"][pull] = sampled_statics(trained, model, way).figures(liver, exact[pull], bodies, area)
    row |= stepping(
        evaluation_time(model), model.body.highest_frequency(np.zeros(model.count)), model.stiffness_damping
    )
    rows.append(row)
    print(row, flush=True)
    found["bases"] = rows
    found["runs"] = dynamics(liver, cut, models)
    found["lengths"] = []
    for length in LENGTHS:
        begin = thread_time()
        model = pt.cut_reduced(trained.model, liver.body, liver.triangles(length), columns=COLUMNS)
        seconds = thread_time() - begin
        frequency = model.body.highest_frequency(np.zeros(model.count))
        found["lengths"].append({
            "length": length, "touched": model.report["cut_nodes"], "terms": len(model.data.cubature.nodes),
            "coordinates": model.data.modes, "seconds": seconds,
            **stepping(evaluation_time(model), frequency, model.stiffness_damping),
        })  # fmt: skip
        print(found["lengths"][-1], flush=True)
    return found


def main() -> None:
    """Measure livers, and keep the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", nargs="+", type=int, default=[3000, 5000])
    options = parser.parse_args()
    for nodes in options.nodes:
        found = cuts.plain(study(nodes))
        others = [
            each for each in result_files.read("reduced_cuts", []) if abs(each["nodes"] / found["nodes"] - 1) > 0.1
        ]
        result_files.write("reduced_cuts", sorted([*others, found], key=lambda each: each["nodes"]))


if __name__ == "__main__":
    main()
