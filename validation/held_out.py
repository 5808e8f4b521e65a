"""How well reduced models repeat motions that they were not trained on.

    python validation/held_out.py [--runs FOLDER] [accuracy|trust|stability|stepping|sampling|enrichment ...]

The paper's beam at 5 mm, nu = 0.49, in its energy form, is pulled, bent and twisted at its end for 1 s at a time:
14 training motions, and 20 others inside their range, 5 outside it, 5 pushed into buckling (`validation/motions.py`).
The runs of the full model are kept in FOLDER (an hour on one core); results go to docs/validation/held_out.json.

accuracy    errors of displacement, velocity, energy and reaction over the number of modes, for the three sets
trust       what the error indicator says of errors, calibrated on half of the runs inside, judged on all others
stability   2 to 100 modes, whatever the motion: does a run ever blow up?
stepping    explicit steps against the implicit rule: cost at equal error, and energy of a free body
sampling    the sampled energy against plain force sampling and Q-DEIM, on the same data
enrichment  vibration modes and modal derivatives, alone and together with the trained modes
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import result_files
import scipy.linalg
from motions import random_motion, training_motions
from numpy.typing import NDArray
from scipy.stats import spearmanr

import palpate as pt
from palpate.reduction.hyper.cubature import sparse_nnls
from palpate.reduction.hyper.error_indicator import mean_size
from palpate.reduction.training.calibrate_indicator import Frames, error_indicators, repeat_run
from palpate.reduction.training.reduce import hyper_reduce

Floats = NDArray[np.float64]

DURATION, EVERY = 1.0, 0.005
SETS = {"inside": 20, "outside": 5, "buckling": 5}
TRAINED, CALIBRATED = 14, 10
NAMES = ("displacement", "velocity", "energy", "reaction")


def body() -> pt.Solid:
    """Return the paper's beam in its energy form."""
    tissue = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.49)
    return pt.Solid(pt.box((0.2, 0.02, 0.02), 0.005), tissue, "x-", form="energy")


def motions(kind: str) -> list[Any]:
    """Return the loads of a set of runs."""
    if kind == "train":
        return training_motions(TRAINED)
    return [random_motion(seed, kind) for seed in range(SETS[kind])]


def full_runs(model: pt.Solid, kind: str, folder: Path) -> list[pt.Trajectory]:
    """Return the full model's runs of a set, from their files where there are any."""
    folder.mkdir(parents=True, exist_ok=True)
    runs = []
    for k, loads in enumerate(motions(kind)):
        path = folder / f"{kind}_{k:02d}.h5"
        if not path.exists():
            run = pt.rollout(model, loads, duration=DURATION, every=EVERY)
            run.save(path)
            print(f"{path.name}: {run.wall_seconds:.0f} s", flush=True)
        runs.append(pt.Trajectory.load(path))
    return runs


def whole(full: Floats, other: Floats) -> float:
    """Relative root mean square difference over a whole run."""
    return float(np.linalg.norm(other - full) / np.linalg.norm(full))


def tried(model: Any, loads: Any, full: pt.Trajectory) -> dict[str, float]:
    """Repeat a run with a reduced model and compare."""
    try:
        run = pt.rollout(model, loads, duration=DURATION, every=EVERY, progress=False)
    except pt.DivergenceError as error:
        print(f"    failed: {str(error)[:100]}", flush=True)
        return {"failed": True}
    found = dict(pt.relative_errors(full, run).as_dict())
    found |= {"displacement_rms": whole(full.displacements, run.displacements)}
    found |= {"velocity_rms": whole(full.velocities, run.velocities)}
    largest = np.abs(run.external).max()
    found |= {"ratio": run.wall_seconds / full.wall_seconds, "steps": float(run.steps[-1])}
    return found | {"balance": float(np.abs(run.balance).max() / largest), "seconds": run.wall_seconds}


def summary(found: list[dict[str, float]]) -> dict[str, Any]:
    """Median and 95th percentile of every error of a set."""
    good = [f for f in found if "failed" not in f]
    result: dict[str, Any] = {"runs": len(found), "failed": len(found) - len(good)}
    for name in (*NAMES, "displacement_rms", "velocity_rms", "balance"):
        values = [f[name] for f in good]
        result[name] = {"median": float(np.median(values)), "percentile_95": float(np.quantile(values, 0.95))}
    return result


def shown(summaries: dict[str, Any]) -> str:
    """One line a set: 95th percentiles."""
    names = (*NAMES, "displacement_rms", "velocity_rms")
    lines = []
    for kind, values in summaries.items():
        numbers = "  ".join(f"{name} {values[name]['percentile_95']:.2%}" for name in names)
        lines.append(f"  {kind:9s} failed {values['failed']}/{values['runs']}  {numbers}")
    return "\n".join(lines)


def study_accuracy(model: pt.Solid, runs: dict[str, list[pt.Trajectory]]) -> list[Any]:
    """Errors over the number of modes."""
    table = []
    for modes in (8, 16, 24, 32, 48, 64, 96):
        rom = hyper_reduce(model, runs["train"], modes=modes)
        sets = {}
        for kind in SETS:
            found = [tried(rom, loads, full) for loads, full in zip(motions(kind), runs[kind], strict=True)]
            sets[kind] = summary(found)
        table.append({"modes": modes, "report": rom.report, "sets": sets})
        print(f"{modes} modes, {rom.report['nodes']} nodes\n{shown(sets)}", flush=True)
    return table


def study_trust(model: pt.Solid, runs: dict[str, list[pt.Trajectory]]) -> list[Any]:
    """The error indicator and its table, calibrated on half the runs inside, judged on all others."""
    pairs = {kind: list(zip(motions(kind), runs[kind], strict=True)) for kind in SETS}
    table = []
    for modes in (16, 32, 64):
        rom = hyper_reduce(model, runs["train"], modes=modes, held_out=pairs["inside"][:CALIBRATED])
        entry: dict[str, Any] = {
            "modes": modes,
            "distance_scale": rom.data.scales.distance_scale,
            "residual_scale": rom.data.scales.residual_scale,
        }
        entry["curves"] = rom.report["held_out"]["expected_error"]
        others = pairs | {"inside": pairs["inside"][CALIBRATED:]}
        frames = {kind: [_repeated(rom, *pair) for pair in some] for kind, some in others.items()}
        frames["all"] = [f for some in frames.values() for f in some]
        for kind, some in frames.items():
            entry[kind] = _judged(rom, some)
            print(f"{modes} modes, {kind}: {entry[kind]}", flush=True)
        table.append(entry)
    return table


def _repeated(rom: pt.ReducedModel, loads: Any, full: pt.Trajectory) -> Frames:
    return repeat_run(rom, loads, full)[1]


def _judged(rom: pt.ReducedModel, some: list[Frames]) -> dict[str, float]:
    """How distance, residual norm and trust rank errors (Spearman), and how well the table foretells them."""
    typical = rom.report["held_out"]["expected_error"]["displacement"]["typical_size"]
    relative = [f.errors["displacement"] / mean_size(f.sizes["displacement"], typical) for f in some]
    errors, scales = np.concatenate(relative), rom.data.scales
    numbers = {
        "distance": [f.measures.distances / scales.distance_scale for f in some],
        "residual norm": [f.measures.residual_norms / scales.residual_scale for f in some],
        "trust": [error_indicators(f.measures, scales) for f in some],
    }
    found: dict[str, float] = {"frames": len(errors)}
    for name, own in numbers.items():
        found[f"{name}_now"] = float(spearmanr(np.concatenate(own), errors)[0])
        found[f"{name}_so_far"] = float(spearmanr(np.concatenate([np.maximum.accumulate(n) for n in own]), errors)[0])
        found[f"{name}_of_runs"] = float(spearmanr([n.max() for n in own], [own.max() for own in relative])[0])
    reached = np.concatenate([np.maximum.accumulate(n) for n in numbers["trust"]])
    bounds = np.array([rom.expected_error(number).bound for number in reached])
    known = np.isfinite(bounds)
    found["above_1"] = float(np.mean(np.concatenate(numbers["trust"]) > 1))
    found |= {"unknown": float(np.mean(~known)), "covered": float(np.mean(errors[known] <= bounds[known]))}
    ends = np.cumsum([len(own) for own in relative])[:-1]
    within = [bool(each.all()) for each in np.split(errors <= bounds, ends)]
    found["runs_kept"] = float(np.mean(within))
    for name, where in (("known", known), ("unknown", ~known)):
        if where.any():
            found |= {f"{name}_median": float(np.median(errors[where]))}
            found |= {f"{name}_percentile_95": float(np.quantile(errors[where], 0.95))}
    return found


def study_stability(model: pt.Solid, runs: dict[str, list[pt.Trajectory]]) -> list[Any]:
    """Runs at every size: the wildest motions, explicit and implicit."""
    table = []
    for modes in (2, 4, 6, 8, 12, 20, 32, 50, 75, 100):
        rom = hyper_reduce(model, runs["train"], modes=modes)
        entry: dict[str, Any] = {"modes": modes, "nodes": rom.report["nodes"]}
        for name, stepped in (("explicit", rom), ("implicit", rom.with_step(1e-3))):
            found = []
            for kind in ("outside", "buckling"):
                some = list(zip(motions(kind), runs[kind], strict=True))[:3]
                found += [tried(stepped, loads, full) for loads, full in some]
            good = [f for f in found if "failed" not in f]
            entry[name] = {
                "runs": len(found),
                "failed": len(found) - len(good),
                "worst_balance": max(f["balance"] for f in good),
            }
        table.append(entry)
        print(entry, flush=True)
    return table


def study_stepping(model: pt.Solid, runs: dict[str, list[pt.Trajectory]]) -> dict[str, Any]:
    """Cost and error of steps, against tiny explicit ones; energy of a free body over a long time."""
    table = []
    for modes in (8, 32, 64):
        rom = hyper_reduce(model, runs["train"], modes=modes)
        loads = motions("inside")[5]
        fine = pt.rollout(rom, loads, duration=DURATION, every=EVERY, step=1e-5, progress=False)
        for name, stepped, step in (
            ("explicit", rom, None),
            *(("implicit", rom.with_step(step), None) for step in (0.25e-3, 0.5e-3, 1e-3, 2.5e-3)),
        ):
            pt.rollout(stepped, loads, duration=0.01, every=EVERY, step=step, progress=False)
            run = pt.rollout(stepped, loads, duration=DURATION, every=EVERY, step=step, progress=False)
            entry = {"modes": modes, "rule": name, "step": DURATION / float(run.steps[-1]), "seconds": run.wall_seconds}
            entry |= {"velocity_error": whole(fine.velocities, run.velocities)}
            table.append(entry | {"displacement_error": whole(fine.displacements, run.displacements)})
            print(table[-1], flush=True)
    return {"cost": table, "free": _free_energy(model, runs)}


def _free_energy(model: pt.Solid, runs: dict[str, list[pt.Trajectory]]) -> list[Any]:
    """Let the bent body go without stiffness damping for 20 s; say how far its energy strays."""
    from dataclasses import replace

    rom = hyper_reduce(model, runs["train"], modes=16)
    calm = pt.ReducedModel(replace(rom.data, stiffness_damping=0.0))
    bent = runs["inside"][5]
    start = bent.displacements[np.argmax(np.abs(bent.displacements).max(axis=(1, 2)))]
    result = []
    for name, stepped, step in (("explicit", calm, 5e-5), ("implicit", calm.with_step(1e-3), None)):
        run = pt.rollout(stepped, (), duration=20.0, every=0.05, displacement=start, step=step, progress=False)
        energy = run.kinetic + run.strain
        result.append({
            "rule": name,
            "largest_change": float(np.abs(energy / energy[0] - 1).max()),
            "mean_of_last_second": float(energy[-20:].mean() / energy[0] - 1),
        })  # fmt: skip
        print(result[-1], flush=True)
    return result


def study_sampling(model: pt.Solid, runs: dict[str, list[pt.Trajectory]]) -> list[Any]:
    """The sampled energy against two samplings of nodal forces, with as many nodes."""
    table = []
    cases = [("train", 0), ("inside", 0)]
    for modes in (8, 24):
        rom = hyper_reduce(model, runs["train"], modes=modes)
        some = np.concatenate([run.displacements[2::20] for run in runs["train"]])
        shapes = rom.data.trial_and_test_basis[:modes]
        project = (shapes * model.volumes[:, None]).reshape(modes, -1)
        states = (project @ some.reshape(len(some), -1).T).T
        nodal = np.array([model.force(np.tensordot(a, shapes, 1)) for a in states])
        nodes = rom.report["nodes"]
        samplings = {
            "all nodes": lambda force, project=project: project @ force.reshape(-1),
            "plain force sampling": _plain(project, nodal, nodes),
            "Q-DEIM": _deim(project, nodal, nodes),
        }
        for kind, k in cases:
            loads, full = motions(kind)[k], runs[kind][k]
            own = tried(rom, loads, full)
            entry: dict[str, Any] = {"modes": modes, "run": f"{kind} {k}", "nodes": nodes}
            entry["sampled energy"] = own.get("displacement_rms", np.inf)
            for name, force in samplings.items():
                entry[name] = _leapfrog(model, shapes, force, loads, full, rom)
            table.append(entry)
            print(entry, flush=True)
    return table


def _plain(project: Floats, nodal: Floats, nodes: int) -> Callable[[Floats], Floats]:
    """Projected nodal forces at few nodes with positive weights."""
    modes, n = len(project), nodal.shape[1]
    parts = np.einsum("mnc,snc->smn", project.reshape(modes, n, 3), nodal)
    sizes = np.linalg.norm(parts.sum(axis=2), axis=1)[:, None, None] + 1e-300
    rows = (parts / sizes).reshape(-1, n)
    weights, _ = sparse_nnls(rows, rows.sum(axis=1), 0.0, nodes)
    return lambda force: np.einsum("mnc,nc->m", project.reshape(modes, n, 3), weights[:, None] * force)


def _deim(project: Floats, nodal: Floats, nodes: int) -> Callable[[Floats], Floats]:
    """Discrete empirical interpolation of the nodal forces, its points by pivoted QR (Drmac and Gugercin 2016)."""
    u, _, _ = np.linalg.svd(nodal.reshape(len(nodal), -1).T, full_matrices=False)
    basis = u[:, : min(nodes, u.shape[1])]
    _, _, pivots = scipy.linalg.qr(basis.T, mode="economic", pivoting=True)
    points = pivots[: basis.shape[1]]
    matrix = project @ basis @ np.linalg.inv(basis[points])
    return lambda force: matrix @ force.reshape(-1)[points]


def _leapfrog(
    model: pt.Solid, shapes: Floats, sampled: Any, loads: Any, full: pt.Trajectory, rom: pt.ReducedModel
) -> float:
    """Displacement error of explicit steps with a sampled force; infinite if it blows up."""
    prepared, density = model.prepare(loads), model.material.density
    forces = rom._loads(rom.prepare(loads)).at(np.arange(0.0, DURATION + 1e-9, 1e-4))[:, : len(shapes)] / density
    a, v, frames = np.zeros(len(shapes)), np.zeros(len(shapes)), [np.zeros(len(shapes))]
    del prepared
    for s in range(round(DURATION / 1e-4)):
        nodal = model.force(np.tensordot(a + model.stiffness_damping * v, shapes, 1))
        v = v + 1e-4 * (sampled(nodal) / density + forces[s])
        a = a + 1e-4 * v
        if not np.isfinite(a).all() or np.abs(a).max() > 1e3:
            return float("inf")
        if (s + 1) % round(EVERY / 1e-4) == 0:
            frames.append(a)
    return whole(full.displacements, np.tensordot(np.array(frames), shapes, 1))


def study_enrichment(model: pt.Solid, runs: dict[str, list[pt.Trajectory]]) -> list[Any]:
    """Bases of 32 fields from vibration modes, their derivatives, and training."""
    table = []
    slow, _ = pt.vibration_modes(model, 32)
    derived = pt.modal_derivatives(model, slow[:6])
    some = list(zip(motions("inside"), runs["inside"], strict=True))[:8]
    for name, modes, fields in (
        ("32 trained modes", 32, None),
        ("32 vibration modes", 0, slow),
        ("11 vibration modes and 21 derivatives", 0, np.concatenate([slow[:11], derived])),
        ("20 trained modes and 12 vibration modes", 20, slow[:12]),
        ("20 trained modes and 12 derivatives", 20, derived[:12]),
    ):
        rom = hyper_reduce(model, runs["train"], modes=modes, enrichment=fields)
        found = summary([tried(rom, loads, full) for loads, full in some])
        table.append({"basis": name, "nodes": rom.report["nodes"], "inside": found})
        print(f"{name}\n{shown({'inside': found})}", flush=True)
    return table


STUDIES: dict[str, Callable[..., Any]] = {
    "accuracy": study_accuracy,
    "trust": study_trust,
    "stability": study_stability,
    "stepping": study_stepping,
    "sampling": study_sampling,
    "enrichment": study_enrichment,
}


def main() -> None:
    """Run the studies asked for and keep their figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="*", choices=[[], *STUDIES], default=[], help="all by default")
    parser.add_argument("--runs", type=Path, default=Path("out/held_out"))
    args = parser.parse_args()
    model = body()
    runs = {kind: full_runs(model, kind, args.runs) for kind in ("train", *SETS)}
    results = result_files.read("held_out", {})
    for name in args.studies or STUDIES:
        began = perf_counter()
        results[name] = STUDIES[name](model, runs)
        result_files.write("held_out", results)
        print(f"{name}: {perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
