"""A rigid ball and a flat punch pressed into a block: forces against finite elements and closed forms.

    python validation/contact.py [--tools ball punch] [--spacings 0.003 0.002] [--forms energy strong] [--filled]
        [--shift 0.5] [--overhead]

adds to docs/validation/contact.json and draws docs/images/contact.png. The block is 60 mm wide and 30 mm deep, clamped
below; the ball has a radius of 20 mm and goes in by up to a tenth of that, the punch 10 mm. References: FElupe's
axisymmetric elements on a cylinder of the same area (contact_elements.py), Hertz with the correction for a finite depth
by Dimitriadis et al. (Biophys. J. 82, 2002), and F = 2 E a d / (1 - nu^2) under a flat punch on a half-space.
With --filled the nodes are not a lattice but fill the block's surface, as they do an organ's; with --shift the tool
stands that many spacings aside.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter

import matplotlib.pyplot as plt
import numpy as np
import result_files
from contact_elements import Block, punch, sphere

import palpate as pt
from palpate.dynamics.contact.impulses import RIGID_TOOLS, contact_impulses
from palpate.dynamics.nodal.central_difference import step_scratch
from palpate.dynamics.nodal.model import nodal_data

HERE = Path(__file__).parent
PICTURE = HERE.parent / "docs" / "images" / "contact.png"
LAW = pt.materials.MooneyRivlin(C1=2667.0, C2=667.0, density=1000.0, poisson=0.45)
SHEAR, POISSON = LAW.shear_modulus, 0.45
YOUNG = 2 * SHEAR * (1 + POISSON)
WIDTH, DEPTH, RADIUS, PUNCH, ROUNDING = 0.06, 0.03, 0.02, 0.01, 0.0005
DEPTHS = {"ball": (4e-4, 8e-4, 1.2e-3, 1.6e-3, 2e-3), "punch": (4e-4,)}
TIME, EVERY = 0.25, 1e-3  # of the way down, and between frames [s]
SMOOTH = 9  # frames of a moving mean


def closed_form(tool: str, d: float) -> float:
    """Force [N] at a depth [m] by linear elasticity."""
    if tool == "punch":
        return 2 * YOUNG * PUNCH * d / (1 - POISSON**2)
    nu, x = POISSON, np.sqrt(RADIUS * d) / DEPTH
    a = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    pi = np.pi
    series = 1 - 2 * a / pi * x + 4 * a**2 / pi**2 * x**2 - 8 / pi**3 * (a**3 + 4 * pi**2 / 15 * b) * x**3
    series += 16 * a / pi**4 * (a**3 + 3 * pi**2 / 5 * b) * x**4
    return float(4 / 3 * YOUNG / (1 - nu**2) * np.sqrt(RADIUS) * d**1.5 * series)


def reference(tool: str, fine: float) -> list[dict]:
    """Forces by finite elements of a size [m]."""
    block, rows = Block(np.sqrt(WIDTH**2 / np.pi), DEPTH, LAW, fine, 0.011), []
    for d in DEPTHS[tool]:
        gap = sphere(DEPTH + RADIUS - d, RADIUS) if tool == "ball" else punch(DEPTH - d, PUNCH, ROUNDING)
        force = block.press(gap)
        rows.append({"tool": tool, "form": "finite elements", "spacing": fine, "depth": d, "force": force})
        print(rows[-1], f"over the closed form {force / closed_form(tool, d):.3f}", flush=True)
    return rows


def block(spacing: float, filled: bool) -> pt.Cloud:
    """Nodes of the block, a lattice or the filling of its surface, with a group "z-"."""
    cloud = pt.box((WIDTH, WIDTH, DEPTH), spacing)
    if not filled:
        return cloud
    fine = pt.box((WIDTH, WIDTH, DEPTH), 0.001)
    used, triangles = np.unique(fine.triangles, return_inverse=True)
    cloud = pt.fill(pt.Surface(fine.points[used], triangles.reshape(-1, 3)), spacing)
    return cloud.with_group("z-", cloud.points[:, 2] < 0.3 * spacing)


def pressed(tool: str, spacing: float, form: str, shift: float = 0.0, filled: bool = False) -> list[dict]:
    """Forces on a block of nodes, and their noise; `shift` is the tool's place across the lattice, in spacings."""
    stiffness_damping = None if form == "energy" else 0.018 * spacing
    model = pt.Solid(block(spacing, filled), LAW, "z-", form=form, stiffness_damping=stiffness_damping)
    shape, start = (pt.tools.Sphere(RADIUS), RADIUS) if tool == "ball" else (pt.tools.Punch(PUNCH, ROUNDING), 0.0)
    deepest = max(DEPTHS[tool])
    middle = WIDTH / 2 + shift * spacing
    way = lambda t: (middle, middle, DEPTH + start - deepest * min(t / TIME, 1.0))  # noqa: E731
    run = pt.rollout(model, [pt.tools.Contact(shape, way)], duration=TIME, every=EVERY, progress=False)
    force = -run.reactions["tool"][1:, 2]  # means over intervals
    depths = deepest * (run.times[1:] - EVERY / 2) / TIME
    smooth = np.convolve(force, np.ones(SMOOTH) / SMOOTH, "valid")
    inner = slice(SMOOTH // 2, len(force) - SMOOTH // 2)
    late = depths[inner] > deepest / 2
    noise = float(np.std((force[inner] - smooth)[late]) / smooth.max())
    balance = float(np.abs(run.balance).max() / run.external.max())
    rows = []
    for d in DEPTHS[tool]:
        power = 1.5 if tool == "ball" else 1.0  # to the depth from the nearest mean
        k = int(np.argmin(np.abs(depths[inner] - d)))
        value = float(smooth[k] * (d / depths[inner][k]) ** power)
        rows.append({
            "tool": tool, "form": form, "spacing": spacing, "filled": filled, "shift": shift, "depth": d,
            "force": value, "noise": noise, "balance": balance,
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def overhead(spacing: float = 0.0018, rounds: int = 12) -> list[dict]:
    """Time that a ball pressed into the top adds to a step, and that of the step without it, both as medians."""
    model = pt.Solid(pt.box((WIDTH, WIDTH, DEPTH), spacing), LAW, "z-", form="energy")
    prepared, free = (
        model.prepare([pt.tools.Contact(pt.tools.Sphere(RADIUS), (WIDTH / 2, WIDTH / 2, DEPTH + RADIUS))]),
        model.prepare(()),
    )
    schedule, zero, state = prepared.schedule(np.array([0.0, 1e-4])), np.zeros((len(model.cloud), 3)), model.state(free)
    u, top = zero.copy(), model.cloud.group("z+")
    u[top, 2] = 5e-4 * np.exp(-np.sum((model.cloud.points[top, :2] - WIDTH / 2) ** 2, axis=1) / 0.006**2)
    nodes, scratch = nodal_data(model), step_scratch(len(model.cloud))
    work = model.workspace()
    seconds, contact = [], []
    for _ in range(rounds):
        began = perf_counter()
        model.advance(state, free, model.stability.step, 4, work)  # five evaluations
        seconds.append((perf_counter() - began) / 5)
        for _ in range(20):
            velocity = zero.copy()
            began = perf_counter()
            contact_impulses(RIGID_TOOLS)(
                prepared.contacts, schedule, 0, 1e-4, 1e-4, u, velocity, (nodes, scratch, 0.0, (0.0, 0.0, 0.0))
            )
            contact.append(perf_counter() - began)
    step, own = np.median(seconds[1:]), np.median(contact[20:])
    row = {
        "tool": "overhead", "form": "energy", "spacing": spacing, "nodes": len(model.cloud),
        "surface": len(prepared.contacts.candidates.patch), "touching": int(np.count_nonzero(velocity.any(axis=1))),
        "step_ms": round(float(1e3 * step), 3), "contact_ms": round(float(1e3 * own), 4), "share": float(own / step),
    }  # fmt: skip
    print(row)
    return [row]


def draw(rows: list[dict]) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), constrained_layout=True)
    for axis, tool in zip(axes, ("ball", "punch"), strict=True):
        truth = {r["depth"]: r["force"] for r in rows if r["tool"] == tool and r["form"] == "finite elements"}
        for form, marker in (("energy", "o"), ("strong", "s")):
            own = [
                r for r in rows if r["tool"] == tool and r["form"] == form and r["shift"] == 0.0 and r["depth"] in truth
            ]
            for filled, spacing in sorted({(r["filled"], r["spacing"]) for r in own}):
                line = [(r["depth"] * 1e3, 100 * (r["force"] / truth[r["depth"]] - 1)) for r in own
                        if (r["filled"], r["spacing"]) == (filled, spacing)]  # fmt: skip
                label = f"{form}, {1e3 * spacing:g} mm" + (", filled" if filled else "")
                axis.plot(*zip(*sorted(line), strict=True), marker="^" if filled else marker, label=label)
        axis.axhspan(-5, 5, color="0.9")
        axis.set(xlabel="indentation [mm]", ylabel="force against finite elements [%]", title=tool)
        if axis.lines:
            axis.legend(fontsize=7)
    figure.savefig(PICTURE, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--tools", nargs="*", default=["ball", "punch"])
    parser.add_argument("--spacings", type=float, nargs="*", default=[0.003, 0.002])
    parser.add_argument("--forms", nargs="*", default=["energy", "strong"])
    parser.add_argument("--filled", action="store_true", help="a filled surface instead of a lattice")
    parser.add_argument("--shift", type=float, default=0.0)
    parser.add_argument("--fine", type=float, help="also the reference, with elements of this size [m]")
    parser.add_argument("--overhead", action="store_true")
    options = parser.parse_args()
    new = overhead() if options.overhead else []
    for tool in options.tools:
        new += reference(tool, options.fine) if options.fine else []
        for spacing in options.spacings:
            for form in options.forms:
                new += pressed(tool, spacing, form, options.shift, options.filled)
    names = ("filled", "shift", "depth")
    key = lambda r: (r["tool"], r["form"], r["spacing"], *(float(r.get(name, 0.0)) for name in names))  # noqa: E731
    stored = result_files.read("contact", [])
    rows = sorted(({key(r): r for r in stored} | {key(r): r for r in new}).values(), key=key)
    result_files.write("contact", rows)
    draw(rows)


if __name__ == "__main__":
    main()
