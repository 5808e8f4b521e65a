"""A mass held by a spring, and by another one to a tool: the smallest body that keeps the engine's contract.

Coordinates are the mass's position x (3,) and the tool's coordinates: its position c (3,) and R_10, the sine of a turn
about z, against which there is a spring as well.
"""

from __future__ import annotations

import time

import numpy as np
from numba import njit

from palpate.realtime.contract import Realtime

MASS, DAMPING, GROUND, CONTACT, TURN, FAULT, LABOUR, TRUSTED = range(8)
STEPS = 8
LEVER = 0.05  # [m]
FAILS, NOT_FINITE, RAISES = 1, 2, 3


@njit(cache=True)
def advance(data, q, v, target, period, report):
    report[0] = 1.0 if data[FAULT] == FAILS else 0.0
    if data[FAULT] == FAILS:
        return
    if data[FAULT] == RAISES:
        raise ZeroDivisionError("on purpose")
    h, strain, kinetic = period / STEPS, 0.0, 0.0
    for i in range(4):
        v[3 + i] = (target[i] - q[3 + i]) / period
    for i in range(3):  # velocity Verlet
        for _ in range(STEPS):
            pull = data[CONTACT] * (q[3 + i] - q[i]) - data[GROUND] * q[i] - data[DAMPING] * v[i]
            v[i] += 0.5 * h * pull / data[MASS]
            q[i] += h * v[i]
            q[3 + i] += h * v[3 + i]
            pull = data[CONTACT] * (q[3 + i] - q[i]) - data[GROUND] * q[i] - data[DAMPING] * v[i]
            v[i] += 0.5 * h * pull / data[MASS]
        q[3 + i] = target[i]
        kinetic += 0.5 * data[MASS] * v[i] ** 2
        strain += 0.5 * data[GROUND] * q[i] ** 2 + 0.5 * data[CONTACT] * (target[i] - q[i]) ** 2
        report[8 + i] = data[CONTACT] * (target[i] - q[i])
    q[6] = target[3]
    report[11] = data[TURN] * target[3]
    report[1] = np.sqrt(target[0] ** 2 + target[1] ** 2 + target[2] ** 2) / data[TRUSTED]
    report[2], report[3], report[4] = STEPS, kinetic, strain + 0.5 * data[TURN] * target[3] ** 2
    labour = 0.0
    for k in range(int(data[LABOUR])):
        labour += np.sin(labour + k)
    report[5] = labour
    if data[FAULT] == NOT_FINITE:
        q[0] = np.nan


@njit(cache=True)
def advance_late(data, q, v, target, period, report):
    """The same body, whose trust is lost by the mass, which lags behind the tool and swings, and by turns."""
    advance(data, q, v, target, period, report)
    way = q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + (LEVER * q[6]) ** 2
    report[1] = np.sqrt(way) / data[TRUSTED]


@njit(cache=True)
def stiffness(data, q, out):
    out[:] = 0.0
    for i in range(3):
        out[i, i] = data[CONTACT]
    out[3, 3] = data[TURN]


def mass_spring(mass=0.1, damping=0.0, ground=100.0, contact=300.0, turn=2.0, labour=0, trusted=np.inf) -> Realtime:
    """Make the body; its `data` may be changed while it is stepped."""
    tool = np.zeros((4, 12))
    tool[:3, :3] = np.eye(3)
    tool[3, 3 + 3] = 1.0  # R_10
    data = np.array([mass, damping, ground, contact, turn, 0.0, labour, trusted])
    return Realtime(advance, stiffness, data, np.zeros(7), tool)


def labour_of(seconds: float) -> int:
    """Rounds of work that take about so many seconds."""
    body, report = mass_spring(labour=1_000_000), np.zeros(12)
    arguments = body.data, np.zeros(7), np.zeros(7), np.zeros(4), 1e-3, report
    advance(*arguments)
    start = time.thread_time()
    advance(*arguments)
    return int(1_000_000 * seconds / (time.thread_time() - start))
