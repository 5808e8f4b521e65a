"""Set palpate next to simulators that pip installs: the error at rest over the computing time, on one thread.

    pip install -e '.[peers]'
    python benchmarks/peers.py            # some twenty minutes; writes peers.json and peers.png of the docs
    python benchmarks/peers.py --draw     # draws the picture from the file again

Two cases of soft tissue (shear modulus 61.2 kPa, Poisson's ratio 0.45) come to rest under mass damping:

- beam: 0.2 x 0.02 x 0.02 m, one end held, 4 mN across the other. Measured: the displacement of its end.
- block: a cube of 0.04 m between two plates that hold its faces, pressed by 20 %. Measured: the force on a plate.

Each program has three lattices of nodes. The reference is FElupe's: 27-node hexahedra, the Richardson limit of three
meshes, with the program's own law, so that the error is of its discretization. Computing time is the processor time of
the process over the simulated time. FElupe solves statics: its time is that of the solve. A package that is not
installed is left out. docs/claims/peers.md names the settings.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import os
import sys
from collections.abc import Callable
from contextlib import chdir, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any, NamedTuple

if __name__ == "__main__":  # threads are set before libraries start them
    for _name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[_name] = "1"

import numpy as np

DOCS = Path(__file__).resolve().parents[1] / "docs"
sys.path.append(str(DOCS.parent / "validation"))

import result_files  # noqa: E402

PICTURE = DOCS / "images" / "peers.png"

SHEAR, POISSON, DENSITY = 61.2e3, 0.45, 1120.0  # [Pa], [-], [kg/m^3]
YOUNG, LAME = 2 * SHEAR * (1 + POISSON), 2 * SHEAR * POISSON / (1 - 2 * POISSON)  # [Pa]
WAVE_SPEED = np.sqrt((LAME + 2 * SHEAR) / DENSITY)  # [m/s]
DAMPING_RATIO = 0.9  # of the lowest mode: it rests to 0.1 % after the shortest time
STEP_SERIES = 2.0 ** (-0.5 * np.arange(12))  # steps tried, over the first
TRIAL_STEPS, TRIAL_STEPS_IMPLICIT = 1500, 40  # of a step that is tried

Array = np.ndarray


class Case(NamedTuple):
    """A body and how it comes to rest.

    The end at x = 0 is held. The other end bears `force` [N] along z, or moves towards the first end by `press` [m]
    within the time `ramp` [s]. `duration` [s] is simulated; `damping` [1/s] is over the mass.
    """

    name: str
    measured: str
    size: tuple[float, float, float]
    force: float
    press: float
    ramp: float
    duration: float
    damping: float
    cells: tuple[int, int, int]

    def counts(self, cells: int) -> tuple[int, int, int]:
        """Return the nodes along x, y and z for some cells across."""
        spacing = self.size[1] / cells
        return tuple(round(side / spacing) + 1 for side in self.size)  # type: ignore[return-value]


_beam_frequency = 1.875**2 * np.sqrt(YOUNG / DENSITY / 12) * 0.02 / 0.2**2  # [rad/s], of Euler and Bernoulli
_block_frequency = np.pi * np.sqrt(SHEAR / DENSITY) / 0.04  # [rad/s], of a shear layer between plates
BEAM = Case("beam", "displacement of the end", (0.2, 0.02, 0.02), -4e-3, 0.0, 0.0, 1.2, 2 * DAMPING_RATIO
            * _beam_frequency, (3, 4, 6))  # fmt: skip
BLOCK = Case("block", "force on the plate", (0.04, 0.04, 0.04), 0.0, 0.008, 0.04, 0.08, 2 * DAMPING_RATIO
             * _block_frequency, (4, 8, 12))  # fmt: skip


class Run(NamedTuple):
    """What a run gives: the measured value [m or N], steps, and processor time [s]."""

    value: float
    steps: int
    seconds: float


# First Piola-Kirchhoff stresses of deformation gradients F (..., 3, 3) [Pa], with the shear modulus and Lame's first
# constant of both cases in the limit of small strain.


def _cofactor(F: Array) -> tuple[Array, Array]:
    J = np.linalg.det(F)[..., None, None]
    return J, J * np.swapaxes(np.linalg.inv(F), -1, -2)


def neo_hookean(F: Array) -> Array:
    """Return the stress of mu/2 (I1 - 3) - mu ln J + lambda/2 (J - 1)^2: palpate's law."""
    J, cofactor = _cofactor(F)
    return SHEAR * (F - cofactor / J) + LAME * (J - 1) * cofactor


def logarithmic(F: Array) -> Array:
    """Return the stress of mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2: FElupe's NeoHookeCompressible."""
    J, cofactor = _cofactor(F)
    return SHEAR * (F - cofactor / J) + LAME * np.log(J) * cofactor / J


def saint_venant_kirchhoff(F: Array) -> Array:
    """Return the stress of lambda/2 (tr E)^2 + mu E:E, E the strain of Green and Lagrange: MuJoCo's law."""
    E = 0.5 * (np.swapaxes(F, -1, -2) @ F - np.eye(3))
    return F @ (LAME * np.trace(E, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) + 2 * SHEAR * E)


def stable_neo_hookean(F: Array) -> Array:
    """Return the stress of mu/2 (I1 - 3) - mu (J - 1) + (lambda + mu)/2 (J - 1)^2: that of Newton's VBD."""
    J, cofactor = _cofactor(F)
    return SHEAR * F + ((LAME + SHEAR) * (J - 1) - SHEAR) * cofactor


SMITH_SHEAR, SMITH_LAME = 4 / 3 * SHEAR, LAME + 5 / 6 * SHEAR  # Smith et al., ACM Trans. Graph. 37, 2018


def smith_neo_hookean(F: Array) -> Array:
    """Return the stress of the law of Smith et al. with its logarithm: that of Newton's semi-implicit solver."""
    J, cofactor = _cofactor(F)
    first = (F * F).sum(axis=(-2, -1))[..., None, None]
    shift = 1 + SMITH_SHEAR / SMITH_LAME - SMITH_SHEAR / (4 * SMITH_LAME)
    return SMITH_SHEAR * (1 - 1 / (first + 1)) * F + SMITH_LAME * (J - shift) * cofactor


def palpate_body(case: Case, cells: int) -> tuple[Any, list[Any]]:
    """Return palpate's `Solid` with its defaults, and its loads."""
    import palpate as pt

    tissue = pt.materials.NeoHookean(C1=SHEAR / 2, density=DENSITY, poisson=POISSON)
    cloud = pt.box(case.size, case.size[1] / cells)
    body = pt.Solid(cloud, tissue, "x-", mass_damping=case.damping)
    if case.press:
        return body, [pt.PrescribedMotion("x+", lambda points, t: (-case.press * min(1.0, t / case.ramp), 0.0, 0.0))]
    return body, [pt.SurfaceForce("x+", force=(0.0, 0.0, case.force))]


def palpate_statics(case: Case, cells: int) -> tuple[Callable[[], Run], float]:
    """Return a static solve of palpate."""
    import palpate as pt

    body, loads = palpate_body(case, cells)

    def solve() -> Run:
        began = process_time()
        rest = pt.equilibrium(body, loads, time=case.duration)
        seconds = process_time() - began
        end = rest.displacements[body.cloud.group("x+"), 2].mean()
        return Run(float(abs(rest.reactions["x+"][0]) if case.press else end), 0, seconds)

    solve()  # compiles
    return solve, 0.0


def palpate(case: Case, cells: int) -> tuple[Callable[[], Run], float]:
    """Return a run of palpate, and its duration for compilation [s]."""
    import palpate as pt

    body, loads = palpate_body(case, cells)
    end = body.cloud.group("x+")

    def run(duration: float = case.duration) -> Run:
        began = process_time()
        made = pt.rollout(body, loads, duration=duration, every=duration, progress=False)
        seconds = process_time() - began
        rest = abs(made.reactions["x+"][-1, 0]) if case.press else made.displacements[-1, end, 2].mean()
        return Run(float(rest), int(made.steps[-1]), seconds)

    return run, case.duration / 50


def mujoco(case: Case, cells: int, integrator: str, first_step: float) -> tuple[Callable[[float], Run], float]:
    """Return a run of MuJoCo's flex for a step [s] with one integrator, and the first step to try [s]."""
    import mujoco as mj

    mj.set_mju_user_warning(lambda text: None)  # of unstable steps, which are tried
    along, across, up = case.counts(cells)
    spacing = case.size[1] / cells
    model = mj.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 0" integrator="{integrator}"><flag contact="disable"/></option>
          <size memory="1G"/>
          <worldbody>
            <flexcomp name="body" type="grid" dim="3" count="{along} {across} {up}" radius="1e-4"
                spacing="{spacing} {spacing} {spacing}" mass="{DENSITY * np.prod(case.size)}">
              <contact selfcollide="none"/>
              <elasticity young="{YOUNG}" poisson="{POISSON}"/>
              <pin gridrange="0 0 0 0 {across - 1} {up - 1}"/>
            </flexcomp>
          </worldbody>
        </mujoco>""")
    bodies = model.flex_vertbodyid
    dofs = model.body_dofadr[bodies]  # first of three, -1 where held
    data = mj.MjData(model)
    mj.mj_forward(model, data)
    rest = data.flexvert_xpos.copy()
    end = np.flatnonzero(rest[:, 0] > rest[:, 0].max() - 0.5 * spacing)
    for body, dof in zip(bodies, dofs, strict=True):
        if dof >= 0:
            model.dof_damping[dof : dof + 3] = case.damping * model.body_mass[body]
    if case.press:  # so heavy that it keeps the velocity that it is given
        for k in range(3):
            model.dof_armature[dofs[end] + k] = 1e9
            model.dof_damping[dofs[end] + k] = 0.0
        mj.mj_setConst(model, data)
    share = end_weights(rest[end, 1:])

    def run(step: float, steps: int = 0) -> Run:
        mj.mj_resetData(model, data)
        parts = [case.ramp, case.duration - case.ramp] if case.press else [case.duration]
        total, began = 0, process_time()
        data.qfrc_applied[dofs[end] + 2] = case.force * share
        for part, speed in zip(parts, (-case.press / case.ramp if case.press else 0.0, 0.0), strict=False):
            count = steps or max(1, round(part / step))
            model.opt.timestep = step if steps else part / count
            if case.press:
                data.qvel[dofs[end]] = speed
            mj.mj_step(model, data, count)
            total += count
            if data.warning.number.any():
                return Run(np.nan, total, np.nan)
        seconds = process_time() - began
        mj.mj_forward(model, data)
        moved = data.flexvert_xpos - rest
        value = data.qfrc_spring[dofs[end]].sum() if case.press else moved[end, 2] @ share
        return Run(float(value), total, seconds)

    return run, first_step or spacing / WAVE_SPEED


def newton(case: Case, cells: int, solver: str) -> tuple[Callable[[float], Run], float]:
    """Return a run of Newton's tetrahedra for a step [s] with one solver on the CPU, and a first step [s]."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    import newton as nt

    along, across, up = case.counts(cells)
    spacing = case.size[1] / cells
    vbd = solver == "VBD"
    builder = nt.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_soft_grid(
        pos=wp.vec3(0.0, 0.0, 0.0), rot=wp.quat_identity(), vel=wp.vec3(0.0, 0.0, 0.0), dim_x=along - 1,
        dim_y=across - 1, dim_z=up - 1, cell_x=spacing, cell_y=spacing, cell_z=spacing, density=DENSITY,
        k_mu=SHEAR if vbd else SMITH_SHEAR, k_lambda=LAME if vbd else SMITH_LAME, k_damp=0.0, fix_left=True,
        fix_right=bool(case.press), particle_radius=1e-4,
    )  # fmt: skip
    if vbd:
        builder.color()
    model = builder.finalize(device="cpu")
    model.particle_grid = None  # no contact between particles
    if vbd:
        stepper = nt.solvers.SolverVBD(model, iterations=VBD_ITERATIONS, particle_enable_tile_solve=False)
    else:
        stepper = nt.solvers.SolverSemiImplicit(model, enable_tri_contact=False)
    rest = model.particle_q.numpy().astype(float)
    end = np.flatnonzero(rest[:, 0] > rest[:, 0].max() - 0.5 * spacing)
    share = end_weights(rest[end, 1:])
    load = np.zeros(rest.shape)
    load[end, 2] = case.force * share
    push, mass = wp.array(load, dtype=wp.vec3, device="cpu"), model.particle_mass
    ends, goals = (wp.array(a, dtype=t, device="cpu") for a, t in ((end, int), (rest[end], wp.vec3)))
    tets, stress = model.tet_indices.numpy(), stable_neo_hookean if vbd else smith_neo_hookean
    load_and_damp, place_end = newton_kernels()

    def run(step: float, steps: int = 0) -> Run:
        count = steps or max(1, round(case.duration / step))
        step = step if steps else case.duration / count
        now, then, control = model.state(), model.state(), model.control()
        began = process_time()
        for k in range(count):
            now.clear_forces()
            inputs = [now.particle_f, now.particle_qd, mass, push, case.damping]
            wp.launch(load_and_damp, len(rest), inputs, device="cpu")
            stepper.step(now, then, control, None, step)
            if case.press:
                pressed = case.press * min(1.0, (k + 1) * step / case.ramp)
                wp.launch(place_end, len(end), [then.particle_q, then.particle_qd, ends, goals, pressed], device="cpu")
            now, then = then, now
        seconds = process_time() - began
        places = now.particle_q.numpy().astype(float)
        if not np.isfinite(places).all() or np.abs(places - rest).max() > case.size[0]:
            return Run(np.nan, count, np.nan)
        if case.press:
            value = -tetrahedra_force(rest, places, tets, stress)[end, 0].sum()
        else:
            value = (places - rest)[end, 2] @ share
        return Run(float(value), count, seconds)

    return run, (VBD_WAVE_CELLS if vbd else 1.0) * spacing / WAVE_SPEED


def newton_kernels() -> tuple[Any, Any]:
    """Return Warp kernels: one adds loads and mass damping, one places the moved end."""
    import warp as wp

    def load_and_damp(f: Any, v: Any, mass: Any, push: Any, damping: float) -> None:
        i = wp.tid()
        f[i] = f[i] + push[i] - damping * mass[i] * v[i]

    def place_end(q: Any, v: Any, ends: Any, goals: Any, pressed: float) -> None:
        i = wp.tid()
        q[ends[i]] = goals[i] - wp.vec3(pressed, 0.0, 0.0)
        v[ends[i]] = wp.vec3(0.0, 0.0, 0.0)

    vectors, numbers, integers = (wp.array(dtype=kind) for kind in (wp.vec3, float, int))
    load_and_damp.__annotations__ = {"f": vectors, "v": vectors, "mass": numbers, "push": vectors, "damping": float}
    place_end.__annotations__ = {"q": vectors, "v": vectors, "ends": integers, "goals": vectors, "pressed": float}
    return wp.kernel(load_and_damp), wp.kernel(place_end)


def tetrahedra_force(rest: Array, places: Array, tets: Array, stress: Callable[[Array], Array]) -> Array:
    """Return the forces (n, 3) [N] that hold the nodes of linear tetrahedra in place."""
    edges, moved = (np.swapaxes(p[tets[:, 1:]] - p[tets[:, :1]], 1, 2) for p in (rest, places))
    inverse = np.linalg.inv(edges)
    columns = stress(moved @ inverse) @ np.swapaxes(inverse, 1, 2) * (np.linalg.det(edges) / 6)[:, None, None]
    forces = np.zeros(rest.shape)
    for k in range(3):
        np.add.at(forces, tets[:, k + 1], columns[..., k])
        np.add.at(forces, tets[:, 0], -columns[..., k])
    return forces


def end_weights(places: Array) -> Array:
    """Return the shares of nodes (n, 2) [m] of a rectangle in its area, half at an edge and a quarter at a corner."""
    inside = [~np.isclose(places[:, k], limit) for k in range(2) for limit in (places[:, k].min(), places[:, k].max())]
    weights = np.prod(np.where(inside, 1.0, 0.5), axis=0)
    return weights / weights.sum()


def elements(
    case: Case, axes: tuple[Array, Array, Array], law: Any, mirrored: tuple[int, ...] = (), solver: Any = None
) -> Run:
    """Return FElupe's equilibrium of 27-node hexahedra between planes [m], with planes of symmetry at y and z = 0.

    The block has one more plane of symmetry, half way between its plates, if its `axes` reach only half as far.
    """
    import felupe as fem

    mesh = fem.mesh.convert(fem.Grid(*axes), 2, True, calc_midfaces=True, calc_midvolumes=True)
    field = fem.FieldContainer([fem.Field(fem.RegionTriQuadraticHexahedron(mesh), dim=3)])
    solid = fem.SolidBody(law, field)
    x, size = mesh.points, np.array([axis[-1] for axis in axes])
    start, end = np.isclose(x[:, 0], 0.0), np.isclose(x[:, 0], size[0])
    half = 0.5 if case.press and size[0] < 0.75 * case.size[0] else 1.0
    held, values = np.zeros(x.shape, dtype=bool), np.zeros(x.shape)
    held[end if half < 1 else start] = True
    for axis in mirrored:
        held[np.isclose(x[:, axis], 0.0), axis] = True
    items: list[Any] = [solid]
    if case.press:
        held[end] = True
        values[end, 0] = -half * case.press
        if half < 1:
            held[start, 0] = True
    else:
        boundary = fem.RegionTriQuadraticHexahedronBoundary(mesh, mask=end)
        area = fem.FieldContainer([fem.Field(boundary, dim=1)])
        ones = np.ones((1, *boundary.dV.shape))
        weights = fem.IntegralForm([ones], v=area, dV=boundary.dV, grad_v=[False]).assemble().toarray().ravel()
        loaded = np.flatnonzero(weights)
        forces = np.zeros((len(loaded), 3))
        forces[:, 2] = case.force / 2 ** len(mirrored) * weights[loaded] / weights.sum()
        items.append(fem.PointLoad(field, list(loaded), values=forces))
    flat = held.ravel()
    options = {"solver": solver} if solver else {}
    parts = LOAD_PARTS if case.press else 1
    began = process_time()
    for part in range(parts):
        fem.newtonraphson(items=items, dof0=np.flatnonzero(flat), dof1=np.flatnonzero(~flat),
                          ext0=(part + 1) / parts * values.ravel()[flat], verbose=0, tol=1e-6, **options)  # fmt: skip
    seconds = process_time() - began
    if case.press:
        inner = solid.assemble.vector(field).toarray().reshape(-1, 3)
        return Run(-float(inner[end, 0].sum() * 2 ** len(mirrored)), 0, seconds)
    return Run(float(weights @ field[0].values[:, 2] / weights.sum()), 0, seconds)


LOAD_PARTS = 4  # of a statics solve of the pressed block
GRADING = 1.6  # of the meshes of the reference


def symmetric_solve(matrix: Any, right: Array) -> Array:
    """Solve a system with SuperLU in an order for symmetric matrices, which is faster than SciPy's default."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve(right)


def felupe(case: Case, cells: int) -> tuple[Callable[[], Run], float]:
    """Return a static solve of FElupe's quadratic hexahedra with as many nodes across."""
    import felupe as fem

    axes = tuple(np.linspace(0.0, side, (n + 1) // 2) for side, n in zip(case.size, case.counts(cells), strict=True))
    return lambda: elements(case, axes, fem.NeoHookeCompressible(mu=SHEAR, lmbda=LAME)), 0.0  # type: ignore[arg-type]


def law_of(stress: Callable[[Array], Array]) -> Any:
    """Return a material of FElupe's of a stress, with its tangent by central differences."""
    import felupe as fem

    def stresses(fields: list[Any]) -> list[Any]:
        return [np.moveaxis(stress(np.moveaxis(fields[0], (0, 1), (-2, -1))), (-2, -1), (0, 1)), fields[-1]]

    def tangent(fields: list[Any]) -> list[Any]:
        F, step = fields[0], 1e-6
        A = np.empty((3, 3, *F.shape))
        for k, m in np.ndindex(3, 3):
            change = np.zeros_like(F)
            change[k, m] = step
            A[:, :, k, m] = (stresses([F + change, None])[0] - stresses([F - change, None])[0]) / (2 * step)
        return [A]

    return fem.Material(stress=stresses, elasticity=tangent)


def graded(case: Case, law: Any, cells: int) -> float:
    """Return the value of a mesh of so many elements over half the width, smaller towards edges and held ends."""
    fine = 1 - (1 - np.linspace(0.0, 1.0, cells + 1)) ** GRADING
    across = 0.5 * case.size[1] * fine
    if case.press:
        axes, mirrored = (0.5 * case.size[0] * fine, across, across), (1, 2)
        return elements(case, axes, law, mirrored, symmetric_solve).value
    along = case.size[0] * np.linspace(0.0, 1.0, 8 * cells + 1) ** GRADING
    return elements(case, (along, across, np.concatenate([-across[:0:-1], across])), law, (1,), symmetric_solve).value


def references(case: Case, stresses: set[Callable[[Array], Array]]) -> dict[str, Any]:
    """Return the converged values of laws: the Richardson limit of three meshes of palpate's law, and its last mesh.

    The limit of another law has the ratio of both laws on the middle mesh. Under a small load all laws are the same.
    A law without an equilibrium there, as Saint Venant and Kirchhoff's under the plates' edges, is compared with
    palpate's.
    """
    import felupe as fem

    sizes = (2, 4, 8) if case.press else (1, 2, 4)
    meshes = [graded(case, law_of(neo_hookean), cells) for cells in sizes]
    ratio = (meshes[1] - meshes[0]) / (meshes[2] - meshes[1])
    limit = meshes[2] + (meshes[2] - meshes[1]) / (ratio - 1)
    laws = {neo_hookean.__name__: limit}
    for stress in stresses - {neo_hookean}:
        try:
            laws[stress.__name__] = limit * (graded(case, law_of(stress), sizes[1]) / meshes[1] if case.press else 1.0)
        except fem.NewtonConvergenceError:
            print(f"{case.name}: no equilibrium of {stress.__name__}")
    return {"laws": dict(sorted(laws.items())), "meshes": meshes}


VBD_ITERATIONS, VBD_WAVE_CELLS = 10, 1.5  # iterations a step, and how many cells a wave crosses in a step
IMPLICIT = {"MuJoCo, discrete", "Newton, VBD"}
MAX_SECONDS = 60.0  # no finer lattice follows a run that took longer
CASES = {case.name: case for case in (BEAM, BLOCK)}
PROGRAMS: dict[str, tuple[str, str, Callable[[float], Array], Callable[[Case, int], Any]]] = {
    # name in figures: package, what it solves, its law, and its runs
    "palpate": ("palpate", "dynamics", neo_hookean, palpate),
    "palpate, statics": ("palpate", "statics", neo_hookean, palpate_statics),
    "MuJoCo, Euler": ("mujoco", "dynamics", saint_venant_kirchhoff, lambda c, n: mujoco(c, n, "Euler", 0.0)),
    "MuJoCo, discrete": ("mujoco", "dynamics", saint_venant_kirchhoff, lambda c, n: mujoco(c, n, "discrete", 2e-3)),
    "Newton, semi-implicit": ("newton", "dynamics", smith_neo_hookean, lambda c, n: newton(c, n, "semi-implicit")),
    "Newton, VBD": ("newton", "dynamics", stable_neo_hookean, lambda c, n: newton(c, n, "VBD")),
    "FElupe": ("felupe", "statics", logarithmic, felupe),
}  # fmt: skip


def longest_stable(run: Callable[..., Run], first: float, trial_steps: int) -> float:
    """Return the longest step [s] of the series from `first` whose first steps stay bounded and raise no warning."""
    for step in first * STEP_SERIES:
        if np.isfinite(run(float(step), trial_steps).value):
            return float(step)
    raise SystemExit("no step of the series is stable")


def measure(case: Case, name: str, cells: int) -> dict[str, Any]:
    """Return the row of one program with some cells across."""
    run, first = PROGRAMS[name][3](case, cells)
    if name == "palpate":
        run(first)  # compiles
        result = run()
    elif PROGRAMS[name][1] == "statics":
        result = run()
    else:
        step = longest_stable(run, first, TRIAL_STEPS_IMPLICIT if name in IMPLICIT else TRIAL_STEPS)
        while not np.isfinite((result := run(step)).value):
            step /= 2**0.5
    nodes = int(np.prod(case.counts(cells)))
    if name == "FElupe":
        nodes = int(np.prod([2 * ((n + 1) // 2) - 1 for n in case.counts(cells)]))
    row: dict[str, Any] = {"case": case.name, "program": name, "cells": cells, "nodes": nodes, "value": result.value}
    if result.steps:
        row |= {"step": case.duration / result.steps, "seconds_per_second": result.seconds / case.duration}
    else:
        row |= {"solve_seconds": result.seconds}
    return row


def versions() -> dict[str, str]:
    """Return the versions of palpate, its peers and the numerics."""
    installed = {}
    for package in ("palpate", "mujoco", "newton", "warp-lang", "felupe", "numpy", "scipy", "numba"):
        with suppress(importlib.metadata.PackageNotFoundError):
            installed[package] = importlib.metadata.version(package)
    return installed


def measure_all(only: str | None) -> dict[str, Any]:
    """Return references and rows of all installed programs, or those of the file with one program measured again."""
    names = [name for name, (package, *_) in PROGRAMS.items() if importlib.util.find_spec(package)]
    for name in PROGRAMS.keys() - set(names):
        print(f"{name} is left out: pip install {PROGRAMS[name][0]}")
    if "FElupe" not in names and not only:
        raise SystemExit("FElupe gives the reference: pip install felupe")
    results = result_files.read("peers", {}) if only else {}
    expected = results.get("references", {})
    rows = [row for row in results.get("rows", []) if row["program"] != only]
    for case in CASES.values():
        if not only:
            expected[case.name] = references(case, {PROGRAMS[name][2] for name in names})
            print(case.name, expected[case.name], flush=True)
        for name in [only] if only else names:
            rows += measure_program(case, name, expected[case.name]["laws"])
    rows.sort(key=lambda row: (list(CASES).index(row["case"]), list(PROGRAMS).index(row["program"]), row["nodes"]))
    installed = results.get("versions", {}) | versions()
    return {"versions": installed, "shear": SHEAR, "poisson": POISSON, "references": expected, "rows": rows}


def measure_program(case: Case, name: str, laws: dict[str, float]) -> list[dict[str, Any]]:
    """Return the rows of one program on all lattices, until one takes too long."""
    exact, rows = laws.get(PROGRAMS[name][2].__name__, laws[neo_hookean.__name__]), []
    for cells in case.cells:
        row = measure(case, name, cells)
        row["error"] = row["value"] / exact - 1
        time = row.get("seconds_per_second", row.get("solve_seconds"))
        print(f"{name:22} {row['nodes']:6,} nodes {time:9.3g} s {100 * row['error']:+8.2f} %", flush=True)
        rows.append(row)
        if time * (case.duration if "step" in row else 1.0) > MAX_SECONDS:
            break
    return rows


MARKERS = {"FElupe": ("x", "#555555"), "Newton, VBD": ("v", "#CC79A7"), "Newton, semi-implicit": ("^", "#009E73"),
           "MuJoCo, discrete": ("D", "#56B4E9"), "MuJoCo, Euler": ("s", "#0072B2"),
           "palpate": ("o", "#D55E00"), "palpate, statics": ("P", "#D55E00")}  # fmt: skip


def check() -> None:
    """Print what FElupe's linear tetrahedra on a peer's mesh of the beam give, and the peer's own value."""
    import felupe as fem
    import mujoco as mj

    cells = BEAM.cells[0]
    counts, spacing = BEAM.counts(cells), BEAM.size[1] / cells
    grid = f'count="{counts[0]} {counts[1]} {counts[2]}" spacing="{spacing} {spacing} {spacing}"'
    model = mj.MjModel.from_xml_string(
        f"""<mujoco><option integrator="Euler"/><worldbody><flexcomp name="body" type="grid" dim="3" {grid}
        radius="1e-4" mass="1"><elasticity young="{YOUNG}" poisson="{POISSON}"/></flexcomp></worldbody></mujoco>"""
    )
    data = mj.MjData(model)
    mj.mj_forward(model, data)
    x, tets = data.flexvert_xpos - data.flexvert_xpos.min(axis=0), np.array(model.flex_elem).reshape(-1, 4)
    turned = np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]]) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    field = fem.FieldContainer([fem.Field(fem.RegionTetra(fem.Mesh(x, tets, "tetra")), dim=3)])
    solid = fem.SolidBody(fem.LinearElastic(E=YOUNG, nu=POISSON), field)
    free = np.flatnonzero(np.repeat(x[:, 0] > 1e-9, 3))
    end = np.flatnonzero(np.isclose(x[:, 0], BEAM.size[0]))
    share, loads, u = end_weights(x[end, 1:]), np.zeros(x.size), np.zeros(x.size)
    loads[3 * end + 2] = BEAM.force * share
    u[free] = symmetric_solve(solid.assemble.matrix().tocsc()[free][:, free], loads[free])
    run, first = mujoco(BEAM, cells, "Euler", 0.0)
    own = run(longest_stable(run, first, TRIAL_STEPS)).value
    print(f"beam, {len(x)} nodes: MuJoCo {1e3 * own:.4f} mm, linear tetrahedra {1e3 * u[3 * end + 2] @ share:.4f} mm")


def draw(result: dict[str, Any]) -> None:
    """Draw errors over computing times, a panel for each case."""
    from palpate.app.common.figures import figure, legend_below, percent_axis

    titles = {"beam": "Beam under a small load: its end", "block": "Block pressed by 20 %: the force"}
    with figure(PICTURE, (9.6, 4.8)) as drawn:
        panels = drawn.subplots(1, 2)
        for axes, name in zip(panels, CASES, strict=True):
            for program, (marker, colour) in MARKERS.items():
                rows = [row for row in result["rows"] if row["case"] == name and row["program"] == program]
                if not rows:
                    continue
                times = [row.get("seconds_per_second", row.get("solve_seconds")) for row in rows]
                static = "solve_seconds" in rows[0]
                label = f"{program.partition(',')[0]}, statics: time of the solve" if static else program
                style = {"ls": ":" if static else "-", "lw": 2.2 if program.startswith("palpate") else 1.4, "ms": 7}
                axes.plot(times, [100 * abs(row["error"]) for row in rows], marker=marker, color=colour, label=label,
                          **style)  # fmt: skip
            axes.set_xscale("log")
            percent_axis(axes)
            axes.axvline(1.0, color="#999999", lw=1, ls="--", zorder=0)
            axes.annotate("real time", (1.0, 0.02), (3, 0), xycoords=("data", "axes fraction"),
                          textcoords="offset points", fontsize=8, color="#666666")  # fmt: skip
            other = [row for row in result["rows"] if row["case"] == name and row["program"] == "MuJoCo, Euler"]
            if CASES[name].press and other:
                at = other[0]["seconds_per_second"], 100 * abs(other[0]["error"])
                axes.annotate("MuJoCo's law is softer", at, (0, -14), textcoords="offset points", fontsize=8,
                              color="#0072B2")  # fmt: skip
            axes.set(title=titles[name], xlabel="computing time per second of tissue [s/s], one thread")
            axes.set_ylabel("error at rest [%]")
        legend_below(drawn, panels[0], columns=3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="measure nothing; draw the picture")
    parser.add_argument("--check", action="store_true", help="only compare MuJoCo's beam with FElupe on its mesh")
    parser.add_argument("--only", choices=PROGRAMS, help="measure this program again, and keep the others")
    chosen = parser.parse_args()
    if chosen.check:
        check()
        return
    if not chosen.draw:
        with TemporaryDirectory() as folder, chdir(folder):  # where MuJoCo leaves its log
            result = measure_all(chosen.only)
        result_files.write("peers", result)
    draw(result_files.read("peers", None))


if __name__ == "__main__":
    main()
