"""Reduced models of a cut liver against the full one: opening, forces, energy release, and the period of a loop.

    python validation/reduced_cuts.py [--nodes 3000]

A generated liver is attached at its back. A cut of 40 mm and a depth of 15 mm is on its front. Two patches next to
the cut are moved apart, or one of them is lifted. Models are trained on other motions of the patches: one of the uncut
body, which spans no opening of the cut, and others of the cut body with several numbers of modes. Results are kept in
docs/validation/reduced_cuts.json, and printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time, thread_time
from typing import Any

import cuts
import numpy as np
import organs
import result_files
import scipy.linalg
from numba import njit

import palpate as pt
from palpate.core.arrays import Floats
from palpate.dynamics.nodal.stability import stable_step
from palpate.meshfree.cut.surface import swept

LENGTH, DEPTH = 0.04, 0.015  # of the cut [m]
BACK, BEYOND = 0.0053, 3.0  # [m] from where the back is attached; of the cut beyond the surface, in spacings
ASIDE, PATCH = 0.015, (0.015, 0.006)  # from the cut to a patch's center, and half its length and width [m]
MODES, CUT_MODES = 20, (20, 40)  # of the models of the uncut and of the cut body
ADVANCE = 0.25  # of the front whose energy release is measured, in spacings
TOUGHNESS = 20.0  # [J/m^2]
RAMP, DURATION, FRAMES = 0.2, 0.4, 0.01  # of the runs [s]
MASS_DAMPING = 8.0  # [1/s]
PERIOD = 1e-3  # [s]
REPEATS, BATCHES = 20, 60  # evaluations; the fastest batch counts, in time of the processor
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


def lifted(model: pt.ReducedModel, pull: Any) -> Floats:
    """Return the lifting coordinates of translations of the patches; the first three of each are those."""
    result = np.zeros(model.data.lifting_count)
    for k, way in enumerate(pull):
        result[k * len(result) // 2 :][:3] = way
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


def reduced_statics(model: pt.ReducedModel, pull: Any) -> Static:
    modes, work = model.data.modes, model.workspace()
    lifting = lifted(model, pull)

    def full(a: Floats) -> Floats:
        return np.concatenate([a, lifting])

    a = full(newton(
        lambda a: model.body.force(full(a), work=work)[:modes],
        lambda a: model.body.stiffness(full(a), work=work)[:modes, :modes], modes,
    ))  # fmt: skip
    return Static(np.tensordot(a, model.body.vectors, 1), -model.body.force(a, work=work)[modes : modes + 3])


def evaluation_time(model: pt.ReducedModel) -> float:
    """Return the time [s] of an evaluation of the forces by the compiled kernel."""
    work, force, points = model.workspace(), model.body.sampled.force, model.body.points

    @njit
    def repeat(count, force, a, points, scratch, result):
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
    """Return errors of openings and forces in runs, root mean squares over the largest, and the error indicators."""
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


def trained(body: Any, modes: int) -> tuple[pt.ReducedModel, float]:
    """Return a model of a body, and the time [s] of all processors for its runs and its training."""
    begin = process_time()
    runs = [pt.rollout(body, moves(pull), duration=DURATION, every=FRAMES, progress=False) for pull in TRAINING]
    model = pt.hyper_reduce(body, runs, modes=modes, prescribed=("one", "other"))
    return model, process_time() - begin


def study(nodes: int) -> dict[str, Any]:
    """Measure a liver of about so many nodes."""
    liver = Liver(nodes)
    h = liver.spacing
    cut, ahead = liver.cut(LENGTH), liver.cut(LENGTH, ADVANCE * h)
    bodies, area = (cut, ahead), ADVANCE * h * DEPTH
    exact = {name: exact_statics(cut, pull) for name, pull in PULLS.items()}
    found: dict[str, Any] = {
        "nodes": len(liver.cloud), "spacing": h, "touched": int(cut.cut_state.touched.sum()),
        "full": stepping(full_time(cut), cut.stability.highest_frequency, cut.stiffness_damping), "models": [],
    }  # fmt: skip
    models: dict[str, Any] = {}
    for name, body, modes in (("uncut", liver.body, MODES), *(("cut", cut, modes) for modes in CUT_MODES)):
        basis = f"{name} body, {modes} modes"
        model, seconds = trained(body, modes)
        models[basis] = model
        row: dict[str, Any] = {"basis": basis, "coordinates": model.count, "terms": len(model.data.cubature.nodes)}
        row |= stepping(
            evaluation_time(model), model.body.highest_frequency(np.zeros(model.count)), model.stiffness_damping
        )
        row |= {pull: reduced_statics(model, way).figures(liver, exact[pull], bodies, area)
                for pull, way in PULLS.items()}  # fmt: skip
        found["models"].append(row | {"seconds": seconds})
        print(row, flush=True)
    found["runs"] = dynamics(liver, cut, models)
    return found


def main() -> None:
    """Measure livers, and keep the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", nargs="+", type=int, default=[3000])
    options = parser.parse_args()
    for nodes in options.nodes:
        found = cuts.plain(study(nodes))
        others = [
            each for each in result_files.read("reduced_cuts", []) if abs(each["nodes"] / found["nodes"] - 1) > 0.1
        ]
        result_files.write("reduced_cuts", sorted([*others, found], key=lambda each: each["nodes"]))


if __name__ == "__main__":
    main()
