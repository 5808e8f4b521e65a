"""Computing time of a beam in palpate, MuJoCo and Newton on one thread: at equal nodes, or at equal accuracy.

    python benchmarks/peers.py [--cells 8] [--duration 0.1] [--rounds 3] [--json FILE]
    python benchmarks/peers.py --accuracy [--json FILE]

At equal nodes a beam of 0.4 m by 40 mm by 40 mm is clamped at one end and let go in gravity; all programs have the same
nodes, on a lattice of `--cells` cells across (8: 6,561 nodes).

At equal accuracy a beam of 0.16 m sinks by 1 % of its length in a weak gravity and swings back, in 1.2 s. The nodes
become more and more. The error of a run is the largest difference of its end's displacement from the reference, over
the reference's largest. The reference is the sum of the linear vibration modes of quadratic hexahedra (FElupe): at this
displacement every law is linear. The time at an error is interpolated between runs, in logarithms.

Young's modulus, Poisson's ratio, density and stiffness damping are in common. Every program takes its longest stable
step: palpate its own, the others the longest of a series that keeps the beam's end within 5 % (`--accuracy`: 1 %) of
that with an eighth of it. Programs run in turn, round after round; the least time counts.

MuJoCo and Newton are measured if they are installed (``pip install mujoco newton felupe``). Both have tetrahedra:
MuJoCo's obey the law of Saint-Venant and Kirchhoff; Newton's, a neo-Hookean law in single precision, have its
semi-implicit solver, the only one for solids whose result depends on no number of iterations.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

for _name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import numpy as np  # noqa: E402 - threads are set before libraries start them

YOUNG, POISSON, DENSITY = 12e3, 0.45, 1000.0  # [Pa], [-], [kg/m^3]
SHEAR, LAME = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))  # [Pa]
DAMPING = 1e-4  # [s], of the stiffness
WIDTH = 0.04  # [m]
SERIES = 2.0 ** (-0.5 * np.arange(16))  # steps tried, over the time in which a wave crosses a cell
REFINED = (3, 4, 6, 8, 12, 16)  # cells across, at equal accuracy
ERRORS = (0.1, 0.05, 0.03, 0.02)  # at which times are compared
LONGEST = 150.0  # [s]: no finer run follows one that took longer


class Beam(NamedTuple):
    """A clamped beam: length [m], cells across, gravity [m/s^2], duration [s], frames, and the tolerance of steps."""

    length: float
    cells: int
    gravity: float
    duration: float
    frames: int
    tolerance: float

    @property
    def spacing(self) -> float:
        """Distance of neighbouring nodes [m]."""
        return WIDTH / self.cells

    @property
    def counts(self) -> tuple[int, int, int]:
        """Nodes along the beam, across it and up."""
        return round(self.length / WIDTH) * self.cells + 1, self.cells + 1, self.cells + 1


class Result(NamedTuple):
    """One run: its steps, the displacement of the beam's end at each frame [m] and the computing time [s]."""

    steps: int
    ends: np.ndarray
    seconds: float


def palpate(beam: Beam, form: str) -> Callable[[], Result]:
    """Return a function that runs the beam in one form of the solid."""
    import palpate as pt

    tissue = pt.materials.NeoHookean(C1=SHEAR / 2, density=DENSITY, poisson=POISSON)
    cloud = pt.box((beam.length, WIDTH, WIDTH), beam.spacing)
    body = pt.Solid(cloud, tissue, "x-", form=form, stiffness_damping=DAMPING)
    weight = [pt.Gravity((0.0, 0.0, -beam.gravity))]
    every = beam.duration / beam.frames

    def run() -> Result:
        began = perf_counter()
        made = pt.rollout(body, weight, duration=beam.duration, every=every, progress=False)
        seconds = perf_counter() - began
        ends = made.displacements[1:, cloud.group("x+"), 2].mean(axis=1)
        return Result(int(made.steps[-1]), ends, seconds)

    return run


def longest_stable(beam: Beam, stepped: Callable[[float, float, int], Result]) -> Callable[[], Result]:
    """Return a function that runs `stepped` (duration [s], step [s], frames) with the longest stable step.

    The step keeps a first tenth of a second; where the whole run fails, the next shorter one is taken.
    """
    wave = beam.spacing / np.sqrt((LAME + 2 * SHEAR) / DENSITY)
    steps = iter(wave * SERIES)
    chosen: list[float] = []

    def shorter() -> float:
        duration = min(0.1, beam.duration)
        for step in steps:
            end, fine = (stepped(duration, part, 1).ends[-1] for part in (step, step / 8))
            if abs(end - fine) <= beam.tolerance * abs(fine):
                return float(step)
        raise SystemExit("no step of the series is stable")

    def run() -> Result:
        if not chosen:
            chosen.append(shorter())
        while not np.isfinite((result := stepped(beam.duration, chosen[0], beam.frames)).ends).all():
            chosen[0] = shorter()
        return result

    return run


def mujoco(beam: Beam, integrator: str) -> Callable[[], Result]:
    """Return a function that runs the beam of MuJoCo's tetrahedra with one integrator."""
    import mujoco as mj

    mj.set_mju_user_warning(lambda text: None)  # of unstable steps, which are tried
    along, across, up = beam.counts
    model = mj.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 {-beam.gravity}" integrator="{integrator}" solver="CG" tolerance="1e-8">
            <flag contact="disable"/>
          </option>
          <size memory="1G"/>
          <worldbody>
            <flexcomp name="beam" type="grid" dim="3" count="{along} {across} {up}" radius="1e-4"
                spacing="{beam.spacing} {beam.spacing} {beam.spacing}" mass="{DENSITY * beam.length * WIDTH**2}">
              <contact selfcollide="none"/>
              <elasticity young="{YOUNG}" poisson="{POISSON}" damping="{DAMPING}"/>
              <pin gridrange="0 0 0 0 {across - 1} {up - 1}"/>
            </flexcomp>
          </worldbody>
        </mujoco>""")

    def stepped(duration: float, step: float, frames: int) -> Result:
        data, steps = mj.MjData(model), int(np.ceil(duration / frames / step))
        model.opt.timestep = duration / frames / steps
        mj.mj_forward(model, data)
        rest = data.flexvert_xpos.copy()
        end = rest[:, 0] > rest[:, 0].max() - 0.5 * beam.spacing
        ends = np.full(frames, np.nan)
        began = perf_counter()
        for frame in range(frames):
            mj.mj_step(model, data, steps)
            if data.warning.number.any():
                break
            ends[frame] = (data.flexvert_xpos - rest)[end, 2].mean()
        return Result(steps * frames, ends, perf_counter() - began)

    return longest_stable(beam, stepped)


def newton(beam: Beam) -> Callable[[], Result]:
    """Return a function that runs the beam of Newton's tetrahedra with its semi-implicit solver on the CPU.

    Its constants are those of Smith et al. (ACM Trans. Graph. 37, 2018): 4/3 of the shear modulus, and 5/6 of it more
    in Lame's first one.
    """
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    import newton as nt

    builder = nt.ModelBuilder(gravity=(0.0, 0.0, -beam.gravity))
    along, across, up = beam.counts
    builder.add_soft_grid(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        vel=wp.vec3(0.0, 0.0, 0.0),
        dim_x=along - 1,
        dim_y=across - 1,
        dim_z=up - 1,
        cell_x=beam.spacing,
        cell_y=beam.spacing,
        cell_z=beam.spacing,
        density=DENSITY,
        k_mu=4 / 3 * SHEAR,
        k_lambda=LAME + 5 / 6 * SHEAR,
        k_damp=SHEAR * DAMPING,
        fix_left=True,
        particle_radius=1e-4,
    )
    model = builder.finalize(device="cpu")
    model.particle_grid = None  # no contact between particles
    solver = nt.solvers.SolverSemiImplicit(model, enable_tri_contact=False)
    rest = model.particle_q.numpy()
    end = rest[:, 0] > rest[:, 0].max() - 0.5 * beam.spacing

    def stepped(duration: float, step: float, frames: int) -> Result:
        steps = int(np.ceil(duration / frames / step))
        now, then, control = model.state(), model.state(), model.control()
        ends = np.full(frames, np.nan)
        began = perf_counter()
        for frame in range(frames):
            for _ in range(steps):
                now.clear_forces()
                solver.step(now, then, control, None, duration / frames / steps)
                now, then = then, now
            ends[frame] = (now.particle_q.numpy() - rest)[end, 2].mean(dtype=float)
            if not abs(ends[frame]) < beam.length:
                ends[frame] = np.nan
                break
        return Result(steps * frames, ends, perf_counter() - began)

    return longest_stable(beam, stepped)


def programs() -> dict[str, Callable[[Beam], Callable[[], Result]]]:
    """Return the programs that are installed, by name: functions from a beam to its run."""
    found: dict[str, Callable[[Beam], Callable[[], Result]]] = {
        "palpate, energy form": lambda beam: palpate(beam, "energy"),
        "palpate, strong form": lambda beam: palpate(beam, "strong"),
    }
    if importlib.util.find_spec("mujoco"):
        found["MuJoCo, explicit"] = lambda beam: mujoco(beam, "Euler")
        found["MuJoCo, implicit"] = lambda beam: mujoco(beam, "discrete")
    if importlib.util.find_spec("newton"):
        found["Newton, semi-implicit"] = newton
    return found


def reference(beam: Beam, half: int) -> np.ndarray:
    """Return the displacement of the end at each frame [m], by linear vibration modes of quadratic hexahedra.

    `half`: elements over half the width, shorter towards the clamp and the edges, of the half beam at a plane of
    symmetry. A mode of frequency w and damping b w^2 that a constant force q starts moves as
    q / w^2 (1 - exp(-d t) (cos(v t) + d / v sin(v t))), d = b w^2 / 2, v^2 = w^2 - d^2.
    """
    import felupe as fem
    from scipy.sparse.linalg import eigsh

    across = WIDTH / 2 * (1 - (1 - np.linspace(0.0, 1.0, half + 1)) ** 1.3)
    along = beam.length * np.linspace(0.0, 1.0, 6 * half + 1) ** 1.6
    grid = fem.Grid(along, across, np.concatenate([-across[:0:-1], across]))
    mesh = fem.mesh.convert(grid, 2, True, calc_midfaces=True, calc_midvolumes=True)
    field = fem.FieldContainer([fem.Field(fem.RegionTriQuadraticHexahedron(mesh), dim=3)])
    solid = fem.SolidBody(fem.LinearElastic(E=YOUNG, nu=POISSON), field)
    fixed = np.repeat((mesh.points[:, 0] < 1e-9)[:, None], 3, axis=1)
    fixed[mesh.points[:, 1] < 1e-9, 1] = True
    free = np.flatnonzero(~fixed)
    stiffness = solid.assemble.matrix().tocsc()[free][:, free]
    mass = solid.assemble.mass(DENSITY).tocsc()
    weight = mass @ np.tile((0.0, 0.0, -beam.gravity), len(mesh.points))
    squared, modes = eigsh(stiffness, 40, M=mass[free][:, free], sigma=0.0)
    end = np.isin(free, 3 * np.flatnonzero(mesh.points[:, 0] > beam.length - 1e-9) + 2)
    times = beam.duration * (1 + np.arange(beam.frames)) / beam.frames
    damping = DAMPING * squared / 2
    frequency = np.emath.sqrt(squared - damping**2)
    turn = frequency * times[:, None]
    swing = 1 - np.exp(-damping * times[:, None]) * (np.cos(turn) + damping / frequency * np.sin(turn))
    return np.real(swing * (modes.T @ weight[free]) / squared) @ modes[end].mean(axis=0)


def equal_nodes(beam: Beam, rounds: int) -> dict[str, Any]:
    """Print and return what a second of the beam costs each program, with the same nodes."""
    runs = {name: start(beam) for name, start in programs().items()}
    nodes = int(np.prod(beam.counts))
    for run in runs.values():
        run()  # compiles, or finds the step
    rows: dict[str, dict[str, Any]] = {}
    for _ in range(rounds):
        for name, run in runs.items():
            steps, ends, seconds = run()
            least = min(seconds, rows.get(name, {}).get("seconds", np.inf))
            rows[name] = {"steps": steps, "end": float(ends[-1]), "seconds": least}
    print(f"{nodes:,} nodes, {beam.duration:g} s, one thread")
    print(f"{'program':24} {'step':>9} {'s per s':>9} {'ns a node and step':>19} {'end':>10}")
    for name, row in rows.items():
        row["speed"] = row["seconds"] / beam.duration
        row["node"] = 1e9 * row["seconds"] / row["steps"] / nodes
        print(
            f"{name:24} {1e6 * beam.duration / row['steps']:6.0f} us {row['speed']:9.1f} {row['node']:19.0f} "
            f"{1e3 * row['end']:7.2f} mm"
        )
    return {"nodes": nodes, "duration": beam.duration, "rows": rows}


def time_at(error: float, runs: list[dict[str, Any]]) -> str:
    """Return the computing time [s] at an error, interpolated in logarithms; an inequality where it is not reached."""
    errors = np.minimum.accumulate([run["error"] for run in runs])
    if errors[-1] > error:
        return f"> {runs[-1]['seconds']:.0f}"
    after = int(np.argmax(errors <= error))
    if after == 0:
        return f"< {runs[0]['seconds']:.2g}"
    span = np.log(errors[after - 1 : after + 1][::-1])
    return f"{np.exp(np.interp(np.log(error), span, np.log([runs[after]['seconds'], runs[after - 1]['seconds']]))):.2g}"


def equal_accuracy(rounds: int) -> dict[str, Any]:
    """Print and return errors and computing times of a swinging beam, and times at equal errors."""
    beam = Beam(0.16, 4, 0.03125, 1.2, 24, 0.01)
    coarse, expected = (reference(beam, half) for half in (2, 4))
    largest = np.abs(expected).max()
    change = float(np.abs(coarse - expected).max() / largest)
    print(f"reference: the end sinks by {1e3 * largest:.2f} mm; it moves by {100 * change:.2f} % with the elements")
    print(f"{'program':24} {'nodes':>8} {'step':>9} {'time':>9} {'error':>8}")
    rows: dict[str, list[dict[str, Any]]] = {}
    for name, start in programs().items():
        rows[name] = []
        for cells in REFINED:
            finer = beam._replace(cells=cells)
            run = start(finer)
            run()  # compiles, or finds the step
            tries = [run() for _ in range(rounds)]
            row = {
                "nodes": int(np.prod(finer.counts)),
                "step": finer.duration / tries[0].steps,
                "seconds": min(result.seconds for result in tries),
                "error": float(np.abs(tries[0].ends - expected).max() / largest),
            }
            rows[name].append(row)
            print(
                f"{name:24} {row['nodes']:8,} {1e6 * row['step']:6.0f} us {row['seconds']:7.2f} s "
                f"{100 * row['error']:6.2f} %",
                flush=True,
            )
            if row["seconds"] > LONGEST or row["error"] < min(ERRORS) / 2:
                break
    print("computing time [s] at an error of " + ", ".join(f"{100 * error:g} %" for error in ERRORS))
    for name, runs in rows.items():
        print(f"{name:24} " + " ".join(f"{time_at(error, runs):>8}" for error in ERRORS))
    return {"beam": beam._asdict(), "reference": expected.tolist(), "change": change, "rows": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", action="store_true", help="compare times at equal accuracy")
    parser.add_argument("--cells", type=int, default=8, help="cells across the beam, at equal nodes")
    parser.add_argument("--duration", type=float, default=0.1, help="time of the motion at equal nodes [s]")
    parser.add_argument("--rounds", type=int, help="runs of each program (3; at equal accuracy 1)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    chosen = parser.parse_args()
    if chosen.accuracy:
        made = equal_accuracy(chosen.rounds or 1)
    else:
        made = equal_nodes(Beam(0.4, chosen.cells, 9.81, chosen.duration, 1, 0.05), chosen.rounds or 3)
    if chosen.json:
        chosen.json.write_text(json.dumps(made, indent=1))


if __name__ == "__main__":
    main()
