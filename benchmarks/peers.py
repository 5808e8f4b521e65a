"""Computing time of a beam under its weight in palpate and in MuJoCo, with the same nodes, on one thread.

    python benchmarks/peers.py [--cells 8] [--duration 0.1] [--rounds 3] [--json FILE]

A beam of 0.4 m by 40 mm by 40 mm is clamped at one end and let go in gravity. All programs have the same nodes, on a
lattice of `--cells` cells across (8: 6,561 nodes), and Young's modulus, Poisson's ratio, density and stiffness damping
in common. Every program takes its longest stable step: palpate its own, MuJoCo the longest of a series that keeps the
end of the beam within 5 % of that with an eighth of it. Programs run in turn, round after round; the least time counts.

MuJoCo is measured if it is installed (``pip install 'mujoco>=3.17'``). Its tetrahedra obey the law of Saint-Venant and
Kirchhoff, which is neo-Hooke's at small strains.
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

LENGTH, WIDTH = 0.4, 0.04  # [m]
YOUNG, POISSON, DENSITY = 12e3, 0.45, 1000.0  # [Pa], [-], [kg/m^3]
DAMPING = 1e-4  # [s], of the stiffness
GRAVITY = 9.81  # [m/s^2]
TOLERANCE = 0.05  # of the end's displacement, for the step of a program without a stable step of its own
SERIES = 2.0 ** (-0.5 * np.arange(12))  # steps tried, over the time in which a wave crosses a cell


class Result(NamedTuple):
    """One run: its steps, the displacement of the beam's end [m] and the computing time [s]."""

    steps: int
    end: float
    seconds: float


def palpate(form: str, cells: int) -> Callable[[float], Result]:
    """Return a function that runs the beam in one form for a duration [s]."""
    import palpate as pt

    shear = YOUNG / (2 * (1 + POISSON))
    tissue = pt.materials.NeoHookean(C1=shear / 2, density=DENSITY, poisson=POISSON)
    cloud = pt.box((LENGTH, WIDTH, WIDTH), WIDTH / cells)
    body = pt.Solid(cloud, tissue, "x-", form=form, stiffness_damping=DAMPING)
    weight = [pt.Gravity((0.0, 0.0, -GRAVITY))]

    def run(duration: float) -> Result:
        began = perf_counter()
        made = pt.rollout(body, weight, duration=duration, every=duration, progress=False)
        seconds = perf_counter() - began
        return Result(int(made.steps[-1]), float(made.displacements[-1, cloud.group("x+"), 2].mean()), seconds)

    return run


def mujoco(integrator: str, cells: int) -> Callable[[float], Result]:
    """Return a function that runs the beam of tetrahedra with one integrator for a duration [s]."""
    import mujoco as mj

    mj.set_mju_user_warning(lambda text: None)  # of unstable steps, which are tried
    along, spacing = round(LENGTH / WIDTH) * cells, WIDTH / cells
    model = mj.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 {-GRAVITY}" integrator="{integrator}" solver="CG" tolerance="1e-8">
            <flag contact="disable"/>
          </option>
          <size memory="1G"/>
          <worldbody>
            <flexcomp name="beam" type="grid" dim="3" count="{along + 1} {cells + 1} {cells + 1}"
                spacing="{spacing} {spacing} {spacing}" radius="1e-4" mass="{DENSITY * LENGTH * WIDTH**2}">
              <contact selfcollide="none"/>
              <elasticity young="{YOUNG}" poisson="{POISSON}" damping="{DAMPING}"/>
              <pin gridrange="0 0 0 0 {cells} {cells}"/>
            </flexcomp>
          </worldbody>
        </mujoco>""")

    def stepped(duration: float, step: float) -> Result:
        data, steps = mj.MjData(model), int(np.ceil(duration / step))
        model.opt.timestep = duration / steps
        mj.mj_forward(model, data)
        rest = data.flexvert_xpos.copy()
        ends = rest[:, 0] > rest[:, 0].max() - 0.5 * spacing
        began = perf_counter()
        mj.mj_step(model, data, steps)
        seconds = perf_counter() - began
        good = not data.warning.number.any()
        return Result(steps, float((data.flexvert_xpos - rest)[ends, 2].mean()) if good else np.nan, seconds)

    wave = spacing / np.sqrt(YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON)) / DENSITY)
    chosen: list[float] = []

    def run(duration: float) -> Result:
        if not chosen:
            for step in wave * SERIES:
                end, fine = stepped(duration, step).end, stepped(duration, step / 8).end
                if abs(end - fine) <= TOLERANCE * abs(fine):
                    chosen.append(step)
                    break
            else:
                raise SystemExit(f"no step of MuJoCo's {integrator} is stable")
        return stepped(duration, chosen[0])

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=8, help="cells across the beam")
    parser.add_argument("--duration", type=float, default=0.1, help="time of the motion [s]")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path, help="file for the figures")
    chosen = parser.parse_args()
    runs = {f"palpate, {form} form": palpate(form, chosen.cells) for form in ("energy", "strong")}
    if importlib.util.find_spec("mujoco"):
        runs["MuJoCo, explicit"] = mujoco("Euler", chosen.cells)
        runs["MuJoCo, implicit"] = mujoco("discrete", chosen.cells)
    nodes = (round(LENGTH / WIDTH) * chosen.cells + 1) * (chosen.cells + 1) ** 2
    for run in runs.values():
        run(chosen.duration)  # compiles, or finds the step
    rows: dict[str, dict[str, Any]] = {}
    for _ in range(chosen.rounds):
        for name, run in runs.items():
            steps, end, seconds = run(chosen.duration)
            least = min(seconds, rows.get(name, {}).get("seconds", np.inf))
            rows[name] = {"steps": steps, "end": end, "seconds": least}
    print(f"{nodes:,} nodes, {chosen.duration:g} s, one thread")
    print(f"{'program':24} {'step':>9} {'s per s':>9} {'ns a node and step':>19} {'end':>10}")
    for name, row in rows.items():
        row["speed"] = row["seconds"] / chosen.duration
        row["node"] = 1e9 * row["seconds"] / row["steps"] / nodes
        print(
            f"{name:24} {1e6 * chosen.duration / row['steps']:6.0f} us {row['speed']:9.1f} {row['node']:19.0f} "
            f"{1e3 * row['end']:7.2f} mm"
        )
    if chosen.json:
        chosen.json.write_text(json.dumps({"nodes": nodes, "duration": chosen.duration, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
