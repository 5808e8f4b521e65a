"""The membrane against axisymmetric solutions, Bessel's frequencies, other layouts and itself turned.

    python validation/membranes.py [statics|nodes|frequencies|layouts|stability ...]

runs the named studies, or all (half an hour), prints their tables and writes them to docs/validation/membranes.json.
"""

from __future__ import annotations

import sys
from itertools import product

import numpy as np
import result_files
from axisymmetric import inflate, neo_hookean, poke
from equilibrium import relax
from scipy.special import jn_zeros

import palpate as pt
from palpate.scenes.membrane import membrane

RADIUS, THICKNESS, C1 = 0.1, 1e-5, 0.17e6
LAW = pt.materials.NeoHookean(C1=C1, density=1200.0, poisson=0.5)
SPACINGS = (0.01, 0.005, 0.0025)
LAYOUTS = (("rings", 0.0), ("hexagonal", 0.0), ("rings", 0.1))


def settled(model, loads, start):
    """Static state near `start`, and the share of the largest displacement by which it still changed in 0.05 s."""
    after = relax(model, loads, start, 0.4, 60.0)
    for _ in range(100):
        before, after = after, relax(model, loads, after, 0.05, 60.0)
        change = float(np.abs(after - before).max() / np.abs(after).max())
        if change < 1e-4:
            break
    return after, change


def poked(spacing, layout, jitter, tool_radius, prestretch=1.0):
    """Force [N], mean deflection [m] and energy [J] of the sheet pushed by 10 mm; what still changes."""
    cloud = pt.disc(RADIUS, spacing, layout, jitter, 1).within("tool", (0.0, 0.0), tool_radius)
    model = pt.Membrane(cloud, LAW, THICKNESS, "rim", prestretch=prestretch)
    tool = pt.PrescribedMotion("tool", (0.0, 0.0, 0.01))
    distance = np.linalg.norm(cloud.points, axis=1)
    start = np.zeros((len(cloud), 3))
    start[:, 2] = 0.01 * np.clip((RADIUS - distance) / (RADIUS - tool_radius), 0.0, 1.0)
    u, change = settled(model, [tool], start)
    prepared = model.prepare([tool])
    still = pt.State(u, np.zeros_like(u))
    force = model.outputs(still, prepared).reactions["tool"][2]
    mean = np.sum(cloud.volumes * u[:, 2]) / cloud.volumes.sum()
    return force, float(mean), model.strain_energy(u), change


def statics():
    """Poke with a disc, and inflation, over spacing, against the axisymmetric solution."""
    rows = []
    for prestretch, tool_radius in ((1.0, 0.02), (1.0, 0.01), (1.01, 0.01), (1.1, 0.02)):
        exact = poke(RADIUS, THICKNESS, neo_hookean(C1), 0.01, tool_radius, prestretch)
        for spacing, (layout, jitter) in product(SPACINGS, LAYOUTS):
            force, mean, energy, change = poked(spacing, layout, jitter, tool_radius, prestretch)
            rows.append({
                "case": "poke", "prestretch": prestretch, "tool_radius": tool_radius,
                "spacing": spacing, "layout": layout, "jitter": jitter, "force": force,
                "force_error": force / exact.force - 1, "mean_error": mean / exact.mean_deflection - 1,
                "energy_error": energy / exact.energy - 1, "change": change,
            })  # fmt: skip
            show(rows[-1])
    for pressure, spacing, (layout, jitter) in product((1.0, 10.0, 50.0), SPACINGS, LAYOUTS):
        exact = inflate(RADIUS, THICKNESS, neo_hookean(C1), pressure)
        cloud = pt.disc(RADIUS, spacing, layout, jitter, 1)
        model = pt.Membrane(cloud, LAW, THICKNESS, "rim")
        start = np.zeros((len(cloud), 3))
        start[:, 2] = exact.height * (1 - np.sum(cloud.points**2, axis=1) / RADIUS**2)
        u, change = settled(model, [pt.Pressure("face", -pressure)], start)
        height = float(u[cloud.group("centre")[0], 2])
        rows.append({
            "case": "inflation", "pressure": pressure, "spacing": spacing, "layout": layout, "jitter": jitter,
            "height": height, "height_error": height / exact.height - 1,
            "energy_error": model.strain_energy(u) / exact.energy - 1, "change": change,
        })  # fmt: skip
        show(rows[-1])
    return rows


def nodes():
    """Radius of the disc that needs the force of one pushed node, and the mean deflections of both."""
    rows = []
    for spacing, (layout, jitter) in product(SPACINGS, LAYOUTS[:2]):
        force, mean, _, change = poked(spacing, layout, jitter, 1e-6)
        low, high = 1e-3 * spacing, spacing
        while high / low > 1.001:
            middle = np.sqrt(low * high)
            disc = poke(RADIUS, THICKNESS, neo_hookean(C1), 0.01, middle)
            low, high = (middle, high) if disc.force < force else (low, middle)
        rows.append({
            "spacing": spacing, "layout": layout, "force": force, "radius_in_spacings": low / spacing,
            "mean_error": mean / disc.mean_deflection - 1, "change": change,
        })  # fmt: skip
        show(rows[-1])
    return rows


def frequencies():
    """First transverse frequencies of a taut sheet against the zeros of Bessel's functions."""
    rows = []
    for prestretch, spacing, (layout, jitter) in product((1.01, 1.1), SPACINGS[:2], LAYOUTS):
        cloud = pt.disc(RADIUS, spacing, layout, jitter, 1)
        model = pt.Membrane(cloud, LAW, THICKNESS, "rim", prestretch=prestretch, stiffness_damping=0.0)
        found = np.sort(np.sqrt(transverse(model).real))[:4]
        speed = prestretch * np.sqrt(2 * C1 * (1 - prestretch**-6) / LAW.density)
        exact = speed / RADIUS * np.array([jn_zeros(m, 1)[0] for m in (0, 1, 1, 2)])
        rows.append({
            "prestretch": prestretch, "spacing": spacing, "layout": layout, "jitter": jitter,
            "frequencies": found.tolist(), "exact": exact.tolist(), "errors": (found / exact - 1).tolist(),
        })  # fmt: skip
        show(rows[-1] | {"frequencies": "", "exact": ""})
    return rows


def transverse(model):
    """Eigenvalues w^2 [1/s^2] of the transverse motions, which are not coupled to those in the plane at rest."""
    free = np.flatnonzero(~model.fixed_mask)
    matrix = np.empty((len(free), len(free)))
    u, step = np.zeros((len(model.cloud), 3)), 1e-6 * model.cloud.spacing
    for column, node in enumerate(free):
        u[node, 2] = step
        matrix[:, column] = -model.force(u)[free, 2] / (step * model.material.density)
        u[node, 2] = 0.0
    return np.linalg.eigvals(matrix)


def stability():
    """The paper's run with every reading of (35), on all spacings and on jittered clouds: energies stay bounded."""
    rows = []
    clouds = [(spacing, layout, 0.0, 0) for spacing in (*SPACINGS, 0.00125) for layout in ("rings", "hexagonal")]
    clouds += [(0.005, "rings", 0.2, seed) for seed in range(5)]
    for (spacing, layout, jitter, seed), after in product(clouds, ("return", "hold", "release")):
        if spacing < SPACINGS[-1] and after != "return":
            continue  # the harshest alone at 20,000 nodes
        case = membrane(spacing, after, layout=layout, jitter=jitter, seed=seed)
        run = pt.rollout(case.model, case.loads, duration=case.duration, every=case.every, progress=False)
        total = run.kinetic + run.strain
        pushed = run.times <= 0.1 + 1e-9
        rows.append({
            "spacing": spacing, "layout": layout, "jitter": jitter, "seed": seed, "after": after,
            "nodes": len(case.model.cloud), "steps": int(run.steps[-1]), "seconds": run.wall_seconds,
            "miss_pushing": float(np.abs(run.balance[pushed]).max() / run.external[pushed].max()),
            "energy_pushed": float(total[pushed][-1]), "energy_end": float(total[-1]),
            # what is there once the tool has jumped can only fall
            "growth_after": float(total[~pushed].max() / total[~pushed][0] - 1),
            "largest_wrinkled_share": max(case.model.wrinkled_area(u) for u in run.displacements[::5])
            / float(case.model.cloud.volumes.sum()),
        })  # fmt: skip
        show(rows[-1])
    return rows


def layouts():
    """The paper's run, with its node and with a tool of 10 mm, on every layout: deflections and tool force compared."""
    rows = []
    for tool_radius, spacing, (layout, jitter) in product((0.0, 0.01), SPACINGS, (*LAYOUTS, ("hexagonal", 0.1))):
        case = membrane(spacing, "hold", tool_radius=tool_radius, layout=layout, jitter=jitter, seed=1)
        run = pt.rollout(case.model, case.loads, duration=0.1, every=case.every, progress=False)
        share = case.model.volumes / case.model.volumes.sum()
        rows.append({
            "tool_radius": tool_radius, "spacing": spacing, "layout": layout, "jitter": jitter,
            "mean_deflection": float(run.displacements[-1, :, 2] @ share),
            "tool_force": float(run.reactions["tool"][-5:, 2].mean()), "strain": float(run.strain[-1]),
        })  # fmt: skip
        show(rows[-1])
    return rows


def show(row):
    """Print one row of a table."""
    print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)


STUDIES = {"statics": statics, "nodes": nodes, "frequencies": frequencies, "layouts": layouts, "stability": stability}


def main() -> None:
    """Run the named studies, or all, and keep the others' tables."""
    results = result_files.read("membranes", {})
    for name in sys.argv[1:] or STUDIES:
        results[name] = STUDIES[name]()
        result_files.write("membranes", results)


if __name__ == "__main__":
    main()
