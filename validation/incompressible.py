"""Nearly incompressible blocks and Cook's slab against FElupe's three-field elements: answers, pressures, steps.

    python validation/incompressible.py reference     the elements; minutes
    python validation/incompressible.py blocks        [--spacings 0.005 0.004 0.0025] [--forms energy strong]
    python validation/incompressible.py cook          the same for Cook's slab
    python validation/incompressible.py volumetric    the three forms of U(J)
    python validation/incompressible.py shown         pressures of the blocks at 2.5 mm as `recovered_pressure` has them

All write docs/validation/incompressible.json, which validation/incompressible_table.py reads. A block of 40 x 20 x
20 mm of soft tissue (Young's modulus 8 kPa) is clamped at one end; its other end is pulled, pushed, turned about a
transverse axis or twisted, and the force or moment is compared. Cook's slab, 48 mm long, in plane strain, is
clamped on its left and sheared on its right, and the displacement of its upper right edge is compared. Jittered
clouds: nodes moved by 0.2 of the spacing.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import result_files
from scipy.interpolate import LinearNDInterpolator

import palpate as pt
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.solid.energy import DEFAULT_DAMPING
from palpate.meshfree.quadrature import integration_weights, quadratic_residuals
from palpate.meshfree.stencils import moving_least_squares

FIGURE = Path(__file__).parents[1] / "docs" / "images" / "incompressible.png"
SIZE = (0.04, 0.02, 0.02)
PANEL = (0.048, 0.03, 0.015)  # Cook's, before it is tapered: the height in its middle
SHEAR = 200.0  # Pa
POISSON = (0.49, 0.499)
MESHES = {"block": ((8, 4, 4), (10, 5, 5)), "cook": ((8, 8, 1), (12, 12, 1))}
JITTER = 0.2
UNEVEN = 64  # neighbours in Cook's slab, whose nodes are 2.75 times as far apart on its left as on its right
CENTRE = np.array([SIZE[0], SIZE[1] / 2, SIZE[2] / 2])
REFUSED = (pt.InputError, pt.CloudError, RuntimeError, ValueError)


def tissue(poisson: float, volumetric: str = "quadratic") -> pt.materials.NeoHookean:
    return pt.materials.NeoHookean(C1=1400.0, density=1000, poisson=poisson, volumetric=volumetric)


def turned(axis: int, angle: float):
    """The end turned by an angle [rad] about its middle."""

    def motion(points: np.ndarray, share: float) -> np.ndarray:
        i, j = ((1, 2), (2, 0), (0, 1))[axis]
        cosine, sine = np.cos(share * angle), np.sin(share * angle)
        arm, u = points - CENTRE, np.zeros_like(points)
        u[:, i] = (cosine - 1) * arm[:, i] - sine * arm[:, j]
        u[:, j] = sine * arm[:, i] + (cosine - 1) * arm[:, j]
        return u

    return motion


def shifted(by: float):
    return lambda points, share: share * np.array([by, 0.0, 0.0]) + np.zeros_like(points)


CASES = {  # motion of the end, and which of its force (0 to 2) and moment (3 to 5) counts
    "tension": (shifted(0.3 * SIZE[0]), 0),
    "compression": (shifted(-0.15 * SIZE[0]), 0),
    "bending": (turned(1, 0.5), 4),
    "torsion": (turned(0, 0.8), 3),
}


def tapered(points: np.ndarray) -> np.ndarray:
    """Cook's slab of a rectangular one: 44 mm high on its left, 16 mm on its right, 60 mm its top."""
    x, share = points[:, 0], points[:, 1] / PANEL[1]
    y = 0.044 * x / PANEL[0] + share * (0.044 - 0.028 * x / PANEL[0])
    return np.stack([x, y, points[:, 2]], axis=1)


def cook_cloud(spacing: float, jitter: float) -> pt.Cloud:
    """A box cloud mapped to Cook's slab; volumes and areas are taken at the middles of the cells."""
    box = pt.box(PANEL, spacing, jitter)
    step = PANEL[0] / np.rint(PANEL[0] / spacing)
    x = np.clip(box.points[:, 0], step / 4, PANEL[0] - step / 4)
    rise = (0.044 - 0.028 * box.points[:, 1] / PANEL[1]) / PANEL[0]
    height = (0.044 - 0.028 * x / PANEL[0]) / PANEL[1]
    at, N = box.face_nodes, box.face_normals
    end = (0.044 - 0.028 * box.points[at, 0] / PANEL[0]) / PANEL[1]
    N = np.stack([end * N[:, 0] - rise[at] * N[:, 1], N[:, 1], height[at] * N[:, 2]], axis=1)
    size = np.linalg.norm(N, axis=1)
    return replace(
        box, points=tapered(box.points), volumes=box.volumes * height, face_normals=N / size[:, None],
        face_areas=box.face_areas * size,
    )  # fmt: skip


# measures


def moment_and_force(model: pt.Solid, u: np.ndarray) -> np.ndarray:
    """Force [N] and moment [N m] on the moved end, (6,)."""
    x, end = model.cloud.points + u, model.cloud.group("x+")
    centre = x[end].mean(axis=0)
    if model.conservative:  # the slope of the energy
        force = -(model.volumes[:, None] * model.force(u))[end]
        return np.concatenate([force.sum(axis=0), np.cross(x[end] - centre, force).sum(axis=0)])
    # virtual work of fields that grow from nothing at the clamp to a motion of the rigid end
    P = model.stress(u) * integration_weights(model.cloud, full_stencils(model))[:, None, None]
    share, result = model.cloud.points[:, :1] / SIZE[0], []
    for axis in np.eye(3):
        result.append(np.sum(P * model.stencils.gradient(share * axis)))
    for axis in np.eye(3):
        result.append(np.sum(P * model.stencils.gradient(share * np.cross(axis, x - centre))))
    return np.array(result)


def full_stencils(model: pt.Solid):
    return moving_least_squares(model.cloud.points, order=2, neighbours=model.neighbours)


def pressures(model: pt.Solid, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressures [Pa] at the nodes: smoothed; as the nodal stress has it; and of each node's own J, not smoothed.

    The energy form smooths twice: its stress has what the transposed smoothing makes of the first.
    """
    work, lame = model.workspace(), model.material.lame
    model.force(u, work=work)
    work = work.passes
    own = lame * (np.linalg.det(model.deformation_gradient(u)) - 1)
    if model.conservative:
        return lame * work.smooth, lame * work.pressure, own
    return work.smooth.copy(), work.smooth.copy(), own


def roughness(model: pt.Solid, values: np.ndarray, lattice: np.ndarray) -> float:
    """Root mean square [Pa] of the checkerboard in a nodal field, off the ends: its height from black to white.

    `lattice` are the nodes of the box before they were jittered and tapered.
    Measured by what quadratic fits to the neighbours miss, root mean square over the middle half.
    """
    stencils, cloud = full_stencils(model), model.cloud
    misses = quadratic_residuals(stencils, cloud.points)[stencils.row]
    board = np.rint(lattice / lattice[lattice > 0].min()).sum(axis=1) % 2
    missed = [np.einsum("nk,nk->n", misses, f[stencils.neighbours] - f[:, None]) for f in (values, board)]
    length = cloud.points[:, 0].max()
    counted = np.abs(cloud.points[:, 0] - length / 2) < length / 4
    found, whole = (float(np.sqrt(np.mean(m[counted] ** 2))) for m in missed)
    return found / whole


def pressure_errors(cloud: pt.Cloud, fields: list[np.ndarray], target: dict) -> dict:
    """Root mean square difference [Pa] of fields from the elements' pressure off the ends, and its range there [Pa]."""
    where = np.array(target["where"])
    axes = np.ptp(where, axis=0) > 1e-6  # the slab's are in a plane
    expected = LinearNDInterpolator(where[:, axes], np.array(target["pressure"]))(cloud.points[:, axes])
    length = cloud.points[:, 0].max()
    counted = np.isfinite(expected) & (np.abs(cloud.points[:, 0] - length / 2) < length / 4)
    errors = [float(np.sqrt(np.mean((f - expected)[counted] ** 2))) for f in fields]
    return {"pressure_errors": errors, "range": float(np.ptp(expected[counted]))}


# runs


def settled(model: pt.Solid, motion) -> np.ndarray:
    """Displacements in equilibrium with the end moved."""
    return pt.equilibrium(model, [pt.PrescribedMotion("x+", motion)], time=1.0).displacements


def settled_panel(model: pt.Solid, seconds: float = 0.6, damping: float = 60.0) -> tuple[np.ndarray, int]:
    """Displacements of Cook's slab, its faces kept in their planes; the number of steps."""
    prepared = model.prepare(
        [pt.SurfaceForce("x+", force=lambda t: (0.0, SHEAR * 0.016 * PANEL[2] * min(t / 0.1, 1.0), 0.0))]
    )
    faces = np.union1d(model.cloud.group("z-"), model.cloud.group("z+"))
    u, v, now, steps = np.zeros_like(model.cloud.points), np.zeros_like(model.cloud.points), 0.0, 0
    while now < seconds:
        step = 0.8 * model.stable_step(pt.State(u, v, now), prepared)[0]
        for _ in range(200):
            a = model.acceleration(pt.State(u, v, now), prepared)
            a[faces, 2] = 0.0
            v = (v + step * a) * np.exp(-step * damping)
            u, now, steps = u + step * v, now + step, steps + 1
        if not np.isfinite(u).all():
            raise RuntimeError("unstable")
    return u, steps


def read() -> dict:
    return result_files.read("incompressible", {"reference": [], "rows": [], "volumetric": []})


def put(kind: str, key: dict, found: dict) -> None:
    """Write a result in place of an older one of the same key."""
    everything = read()
    others = [row for row in everything.get(kind, []) if any(row.get(k) != v for k, v in key.items())]
    everything[kind] = [*others, {**key, **found}]
    result_files.write("incompressible", everything)
    short = {k: v for k, v in found.items() if not isinstance(v, list) or len(v) < 4}
    print(*key.values(), short, flush=True)


def element_answer(case: str, law: pt.materials.NeoHookean, cells: tuple[int, int, int]) -> tuple[float, list, list]:
    """Answer of the elements, and their pressures [Pa] and where [m]."""
    import incompressible_elements as elements

    if case == "cook":
        body, end = elements.cook(law, PANEL, cells, tapered, SHEAR, 2)
        top = end & np.isclose(body.points[:, 1], 0.06)
        answer = body.displacements()[top, 1].mean()
    else:
        motion, which = CASES[case]
        body, end = elements.moved_end(law, SIZE, cells, motion, 2)
        x, force = (body.points + body.displacements())[end], body.reactions()[end]
        both = np.concatenate([force.sum(axis=0), np.cross(x - x.mean(axis=0), force).sum(axis=0)])
        answer = both[which]
    where, pressure = body.pressures()
    return float(answer), np.round(where, 6).tolist(), np.round(pressure, 2).tolist()


def reference(cases: list[str]) -> None:
    for case, poisson in product(cases, POISSON):
        coarse, fine = MESHES["cook" if case == "cook" else "block"]
        before, _, _ = element_answer(case, tissue(poisson), coarse)
        answer, where, pressure = element_answer(case, tissue(poisson), fine)
        found = {"answer": answer, "mesh_change": abs(answer / before - 1), "where": where, "pressure": pressure}
        put("reference", {"case": case, "poisson": poisson}, found)


def model_of(
    cloud: pt.Cloud, poisson: float, form: str, volumetric: str = "quadratic", neighbours: int = 42
) -> pt.Solid:
    """A model that comes to rest: the energy form has more than its default damping; static states do not change."""
    model = pt.Solid(cloud, tissue(poisson, volumetric), "x-", form=form, neighbours=neighbours)
    if form == "strong":
        return model
    stiffness_damping = 0.4 / model.stability.highest_frequency
    return pt.Solid(
        cloud, tissue(poisson, volumetric), "x-", form=form, neighbours=neighbours, stiffness_damping=stiffness_damping
    )


def default_step(model: pt.Solid) -> float:
    """Stable step [s] at rest with the default stiffness damping."""
    highest = model.stability.highest_frequency
    return stable_step(highest, DEFAULT_DAMPING / highest) if model.conservative else model.stability.step


def run(case: str, poisson: float, form: str, spacing: float, jitter: float) -> None:
    target = find(read()["reference"], case=case, poisson=poisson)
    key = {"case": case, "poisson": poisson, "form": form, "spacing": spacing, "jitter": jitter}
    try:
        cloud = cook_cloud(spacing, jitter) if case == "cook" else pt.box(SIZE, spacing, jitter)
        model = model_of(cloud, poisson, form, neighbours=UNEVEN if case == "cook" else 42)
        begin, steps = time.perf_counter(), 0
        if case == "cook":
            u, steps = settled_panel(model)
            corner = model.cloud.group("x+")[np.isclose(model.cloud.points[model.cloud.group("x+"), 1], 0.06)]
            answer = float(u[corner, 1].mean())
        else:
            u = settled(model, CASES[case][0])
            answer = float(moment_and_force(model, u)[CASES[case][1]])
    except REFUSED as error:
        put("rows", key, {"refused": str(error).splitlines()[0][:200]})
        return
    smooth, acting, own = pressures(model, u)
    lattice = pt.box(PANEL if case == "cook" else SIZE, spacing).points
    found = {
        "answer": answer, "error": answer / target["answer"] - 1, "nodes": len(cloud),
        "step": default_step(model), "stiffness_damping": model.stiffness_damping, "steps": steps,
        "seconds": time.perf_counter() - begin,
        "rough": [roughness(model, f, lattice) for f in (smooth, acting, own)],
        **pressure_errors(cloud, [smooth, acting, own], target),
    }  # fmt: skip
    if spacing == 0.0025 and form == "energy":
        np.savez_compressed(
            kept(case, poisson, jitter), u=u, smooth=smooth, acting=acting, own=own, points=cloud.points
        )
    put("rows", key, found)


def kept(case: str, poisson: float, jitter: float) -> Path:
    """Where the fields for the figure are kept between commands."""
    folder = Path("out/incompressible")
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{case}-{poisson}-{jitter}.npz"


def readouts() -> None:
    """Recover the pressures of the runs that are kept: what one would show of them."""
    for row in (r for r in read()["rows"] if r["form"] == "energy" and r["spacing"] == 0.0025 and "error" in r):
        case, poisson, jitter = row["case"], row["poisson"], row["jitter"]
        file = kept(case, poisson, jitter)
        if case == "cook" or not file.exists():
            continue
        target = find(read()["reference"], case=case, poisson=poisson)
        model = pt.Solid(pt.box(SIZE, 0.0025, jitter), tissue(poisson), "x-", form="energy")
        fields = dict(np.load(file))
        fields["shown"] = model.recovered_pressure(fields["u"])
        np.savez_compressed(file, **fields)
        found = pressure_errors(model.cloud, [fields["shown"]], target)
        found["rough"] = roughness(model, fields["shown"], pt.box(SIZE, 0.0025).points)
        put("shown", {"case": case, "poisson": poisson, "jitter": jitter}, found)


def find(rows: list[dict], **key) -> dict:
    return next(row for row in rows if all(row[k] == v for k, v in key.items()))


def volumetric_forms(spacing: float = 0.004, poisson: float = 0.3) -> None:
    """Tension and compression of a compressible block in the three forms, where they differ."""
    for case, name in product(("tension", "compression"), ("quadratic", "logarithmic", "mixed")):
        expected, _, _ = element_answer(case, tissue(poisson, name), MESHES["block"][0])
        for form in ("energy", "strong"):
            model = model_of(pt.box(SIZE, spacing), poisson, form, name)
            answer = float(moment_and_force(model, settled(model, CASES[case][0]))[CASES[case][1]])
            key = {"case": case, "volumetric": name, "form": form, "poisson": poisson, "spacing": spacing}
            put("volumetric", key, {"answer": answer, "elements": expected, "error": answer / expected - 1})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["reference", "blocks", "cook", "volumetric", "shown"])
    parser.add_argument("--spacings", type=float, nargs="+", default=[0.005, 0.004, 0.0025])
    parser.add_argument("--forms", nargs="+", default=["energy"])
    parser.add_argument("--poisson", type=float, nargs="+", default=list(POISSON))
    parser.add_argument("--cases", nargs="+", default=[*CASES, "cook"])
    parser.add_argument("--jitters", type=float, nargs="+", default=[0.0, JITTER])
    args = parser.parse_args()
    if args.what == "reference":
        reference(args.cases)
    elif args.what in ("blocks", "cook"):
        cases = ["cook"] if args.what == "cook" else [c for c in args.cases if c != "cook"]
        for spacing, form, jitter, case, poisson in product(
            args.spacings, args.forms, args.jitters, cases, args.poisson
        ):
            run(case, poisson, form, spacing, jitter)
    else:
        {"volumetric": volumetric_forms, "shown": readouts}[args.what]()


if __name__ == "__main__":
    main()
