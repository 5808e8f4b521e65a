"""Passivity of the virtual coupling: the device never receives more energy than it supplied.

    python validation/virtual_coupling.py model.rom 300
    python validation/virtual_coupling.py model.rom 300 0.5

The second number limits the spring's force [N].

The model must have tool contact, such as one of `palpate train liver`. A ball presses the body repeatedly, faster each
time, at 1 kHz of model time. After every period the script balances the energies.
"""

from __future__ import annotations

import sys

import numpy as np

import palpate as pt
from palpate.compiled.reference import StoredRecord
from palpate.realtime.contract import KINETIC, STATUS, STRAIN
from palpate.realtime.instrumented import DAMPING, MASS, TOOLS, make_instrumented

PERIOD, DURATION, RADIUS, DEPTH, GAP = 1e-3, 4.0, 0.02, 0.008, 0.002  # [s], [s], [m], [m], [m]


def balance(
    model: pt.ReducedModel, stiffness: float, radius: float = RADIUS, depth: float = DEPTH, limit: float = np.inf
) -> dict:
    """Press a body through a coupling [N/m] with a force limit [N]; return work, energies [J] and forces by period."""
    cloud = model.cloud
    fixed = np.concatenate([cloud.group(name) for name in model.fixed])
    free = np.setdiff1d(pt.tools.surface_nodes(cloud), fixed)
    along = cloud.points - cloud.points[fixed].mean(axis=0)
    first = free[np.argmax(np.linalg.norm(along[free], axis=1))]  # farthest from the support
    normal = cloud.face_normals[cloud.face_nodes == first].sum(axis=0)
    normal /= np.linalg.norm(normal)
    home = cloud.points[first] + (radius + GAP) * normal
    body = make_instrumented(
        pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(radius), home, friction=0.2))
    )
    body.set_coupling(stiffness, limit)
    data, coupling, q, v = body.data, body.data.coupling, body.rest.copy(), np.zeros_like(body.rest)
    address = StoredRecord(data)  # by which the engine hands the data on
    report, device, work = np.zeros(20), np.zeros(3), 0.0
    energies = {"work": [], "body": [], "coupling": [], "force": []}
    for k in range(round(DURATION / PERIOD)):
        time = (k + 1) * PERIOD
        wanted = -(depth + GAP) * np.sin(np.pi * (time + time**2)) ** 2 * normal
        body.advance(address, q, v, np.concatenate([wanted, np.zeros(9)]), PERIOD, report)
        if report[STATUS] != 0.0:
            raise SystemExit("the state diverged")
        work -= data.values[TOOLS : TOOLS + 3] @ (wanted - device)  # of the device on the coupling
        device = wanted
        length = np.linalg.norm(device - coupling.position[0])
        slack = max(length - limit / stiffness, 0.0)  # beyond which the spring has a constant force
        spring = 0.5 * stiffness * (length - slack) ** 2 + (limit * slack if slack else 0.0)
        kinetic = 0.5 * coupling.parameters[0, MASS] * np.sum(coupling.velocity**2)
        stored = report[KINETIC] + report[STRAIN]
        force = np.linalg.norm(data.values[TOOLS : TOOLS + 3])
        for name, value in (("work", work), ("body", stored), ("coupling", spring + kinetic), ("force", force)):
            energies[name].append(value)
    return {name: np.array(values) for name, values in energies.items()} | {"damping": coupling.parameters[0, DAMPING]}


if __name__ == "__main__":
    numbers = [float(text) for text in sys.argv[2:4]]
    energies = balance(pt.load(sys.argv[1]), *numbers[:1] or [300.0], limit=numbers[1] if len(numbers) > 1 else np.inf)
    dissipated = energies["work"] - energies["body"] - energies["coupling"]
    print(f"damping of the coupling {energies['damping']:.3g} N s/m")
    print(f"largest energy in the body {1e3 * energies['body'].max():.3g} mJ")
    print(
        f"final work of the device {1e3 * energies['work'][-1]:.3g} mJ, at least {1e3 * energies['work'].min():.3g} mJ"
    )
    print(f"dissipated energy: at least {1e3 * dissipated.min():.3g} mJ, finally {1e3 * dissipated[-1]:.3g} mJ")
    print("passive" if energies["work"].min() > -1e-3 * energies["body"].max() else "NOT passive")
