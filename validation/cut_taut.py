"""A blade in taut tissue, against other energy release rates; `cuts.py` runs it.

The edge crosses a sheet of thickness t, and moves along its middle. Its force is to be (Gamma - G) t in every frame.

- **strip**: both sides have moved apart, and the front is far from the ends, so that G is the energy of the uncut strip
  for a unit of its length and thickness (Rivlin and Thomas, J. Polym. Sci. 10, 1953).
- **edge crack**: a constant stress s pulls the ends of a long sheet across a cut of length a, and its far side does not
  turn. It is half of a sheet of twice the width b, with a crack in each edge: G = K^2 / E and

      K = s sqrt(pi a) (1.122 - 0.561 c - 0.205 c^2 + 0.471 c^3 - 0.190 c^4) / sqrt(1 - c),  c = a / b

  (Tada, Paris and Irwin, The Stress Analysis of Cracks Handbook, 2000). G rises with a: from G = Gamma on, the cut
  would run ahead of the blade by itself.
"""

from __future__ import annotations

import time
from itertools import product
from typing import Any

import numpy as np

import palpate as pt
from palpate.core.arrays import Floats

THICKNESS, DENSITY, SHEAR_MODULUS, POISSON = 6e-3, 1000.0, 16e3, 0.45
TISSUE = pt.materials.MooneyRivlin(C1=SHEAR_MODULUS, C2=0.0, density=DENSITY, poisson=POISSON)
ACROSS = (0.0, -np.pi / 2, 0.0)  # the edge along z of the sheet, cutting towards x
STRIP, SHEET = (56e-3, 18e-3), (24e-3, 60e-3)  # length along the cut, and height [m]
TOUGHNESS = {"strip": 5.0, "edge crack": 4.0}  # [J/m^2]
TENSIONS = {"strip": (0.03, 0.05, 0.07), "edge crack": (900.0, 1200.0, 1500.0)}  # strain; stress [Pa]
SPACINGS = (2e-3, 1.5e-3)
SPEEDS = {"strip": (0.1, 0.3), "edge crack": (0.05, 0.1)}  # [m/s]
PLACE = 0.1  # of the cut above the middle, in spacings: between nodes
PULL_TIME, REST = 0.08, 0.04  # [s] in which the tension grows, and until the blade moves
FIRST_END = 6e-3  # [m] of the edge crack
BEHIND = 3e-3  # [m] from the sheet where the blade begins
MIDDLE = (0.4, 0.6)  # of the length of the strip, between which its energy is that of a long one
MASS_DAMPING = 100.0  # [1/s]


def energy_per_area(body: pt.Solid, loads: list[Any]) -> float:
    """Return the energy [J/m^2] of an uncut strip for a unit of its length and thickness, far from its ends."""
    cloud, length = body.cloud, STRIP[0]
    state = pt.equilibrium(body, [pt.PrescribedMotion(each.group, each.displacement(None, 1.0)) for each in loads])
    energies = body.evaluate(state.displacements).energy_density * body.volumes
    columns = np.rint(cloud.points[:, 0] / cloud.spacing).astype(int)
    first, last = (round(share * length / cloud.spacing) for share in MIDDLE)
    return float(np.bincount(columns, energies)[first : last + 1].mean() / (cloud.spacing * THICKNESS))


def sheet(kind: str, tension: float, spacing: float) -> tuple[pt.Solid, list[Any], Any]:
    """Return a sheet, its loads, and the energy release rate [J/m^2] of cuts of lengths (k,) [m]."""
    length, height = STRIP if kind == "strip" else SHEET
    cloud = pt.box((length, height, THICKNESS), spacing)
    if kind == "strip":
        loads = [
            pt.PrescribedMotion(
                side, lambda _, t, sign=sign: (0.0, sign * 0.5 * tension * height * min(t / PULL_TIME, 1.0), 0.0)
            )
            for side, sign in (("y-", -1.0), ("y+", 1.0))
        ]
        body = pt.Solid(cloud, TISSUE, (), mass_damping=MASS_DAMPING)
        density = energy_per_area(body, loads)
        return body, loads, lambda a: np.full_like(a, density)
    force = tension * length * THICKNESS
    loads = [
        pt.SurfaceForce(side, lambda t, sign=sign: (0.0, sign * force * min(t / PULL_TIME, 1.0), 0.0))
        for side, sign in (("y-", -1.0), ("y+", 1.0))
    ]
    modulus = 2 * SHEAR_MODULUS * (1 + POISSON)
    body = pt.Solid(cloud, TISSUE, pt.Roller("x+"), mass_damping=MASS_DAMPING)
    return body, loads, lambda a: edge_crack(tension, a, modulus)


def edge_crack(stress: float, a: Floats, modulus: float) -> Floats:
    """Return the energy release rates (k,) [J/m^2] of edge cracks of lengths (k,) [m] in the sheet."""
    c = np.clip(a / SHEET[0], 0.0, 0.9)
    shape = (1.122 - 0.561 * c - 0.205 * c**2 + 0.471 * c**3 - 0.190 * c**4) / np.sqrt(1 - c)
    return np.asarray(stress**2 * np.pi * a * shape**2 / modulus)


def compared(kind: str, tension: float, spacing: float, speed: float) -> dict[str, Any]:
    """Return errors of the force of a blade and of the cost of its cut, by frames in which it moves by a spacing."""
    began, toughness = time.perf_counter(), TOUGHNESS[kind]
    body, loads, release = sheet(kind, tension, spacing)
    length, height = STRIP if kind == "strip" else SHEET
    blade = pt.tools.Blade(edge=[(-THICKNESS, 0, 0), (THICKNESS, 0, 0)], toughness=toughness)
    start, middle = PULL_TIME + REST, 0.5 * height + PLACE * spacing
    path = lambda t: ((-BEHIND + speed * max(t - start, 0.0), middle, 0.5 * THICKNESS), ACROSS)  # noqa: E731
    way = BEHIND + (length - height if kind == "strip" else 0.5 * length)
    run = pt.rollout(
        body, [pt.tools.Contact(blade, path, name="knife"), *loads], duration=start + way / speed,
        every=spacing / speed, progress=False,
    )  # fmt: skip
    ends = run.cut_area / THICKNESS
    a = 0.5 * (ends[1:] + ends[:-1])
    used = (a > height) & (a < length - height) if kind == "strip" else (a > FIRST_END) & (a < 0.5 * length)
    area = np.diff(run.cut_area)[used]
    released = release(a[used]) / toughness
    force = run.reactions["knife"][1:][used] / (toughness * THICKNESS)
    return {
        "kind": kind, "tension": tension, "spacing": spacing, "speed": speed, "nodes": len(body.cloud),
        "released": [released.min(), released.max()], "force": list(force[:, 0] / (1 - released) - 1),
        "across": float(np.abs(force[:, 1]).max()),
        "cost": list(np.diff(run.edge_work + run.released_energy)[used] / (toughness * area) - 1),
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def in_runs() -> list[dict[str, Any]]:
    """Run all tensions, spacings and speeds, and print each."""
    cases = [case for kind in TENSIONS for case in product([kind], TENSIONS[kind], SPACINGS, SPEEDS[kind])]
    return [printed(compared(*case)) for case in cases]


def printed(row: dict[str, Any]) -> dict[str, Any]:
    case = ", ".join(f"{name} {row[name]}" for name in ("kind", "tension", "spacing", "speed"))
    errors = ", ".join(f"{name} {min(row[name]):+.1%} to {max(row[name]):+.1%}" for name in ("force", "cost"))
    low, high = row["released"]
    print(f"{case}: G/Gamma {low:.2f} to {high:.2f}, {errors}, {row['seconds']:.0f} s", flush=True)
    return row
