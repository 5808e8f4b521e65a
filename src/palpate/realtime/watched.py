"""A model that other threads may watch, whose tool may hang on a spring and whose tissue may be stiffened, compiled.

The row that an engine publishes tells coordinates, not what tools dent beside them. A watched model publishes, after
every period, the coordinates again together with the forces on the touched nodes of that period: all of one write, so
that who reads them needs no lock and sees no mixture.

A virtual coupling is a spring and a damper between the hand's pose and the tool, whose small mass they move:

    m dv/dt = K (p - x) + B (dp/dt - v) + f,

f the body's force on the tool. The spring and the damper are taken at the end of a period and f from the one before, a
symplectic rule of Euler's, so that the coupling makes no energy as long as B > K' h / 2 and m > K' h^2 / 4 for a body
of stiffness K' and periods h. Turns are followed as they are.

Tissue whose moduli are all s times what they were, of the same density, moves as the model does in a time that goes
sqrt(s) times as fast, with s times its forces and energies: M q'' = s f(q) in t is M q'' = f(q) in sqrt(s) t. That is
exact for every law without times of its own; the viscosity follows, so that vibrations are damped as before, each in
its own period.

A jump of s makes energy of strain out of nothing, and jumps in step with a vibration make ever more of it. So s glides:
a change that is slow beside vibrations gives back what it took.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.compiled.cache import law_digest, law_njit
from palpate.faults import number_in_range
from palpate.realtime.contract import FORCES, KINETIC, STATUS, STRAIN
from palpate.realtime.exchange import Slot, publish, snapshot
from palpate.realtime.loop import _name, _sources
from palpate.reduction.realtime.model import RealtimeModel

__all__ = ["Seen", "WatchedModel", "watched"]

Floats = NDArray[np.float64]

MOST = 4096  # touched nodes that are told
HAND, PLACE, COUNT, FIRM, HEAD = 0, 3, 6, 7, 8  # where hand's force, tool's place, touched nodes, s and coordinates are
GLIDE = 5.0  # [1/s]: the most that the logarithm of s changes by in a second of the body
STIFFNESS, DAMPING, MASS = range(3)
TOOL_MASS = 0.05  # [kg] of a coupled tool


class Hung(NamedTuple):
    """What the compiled period reads and keeps beside a model's own.

    Parameters
    ----------
    inner : tuple
        The model's.
    slot : Slot
    numbers : array
        What is published.
    spring : (3,) array
        Stiffness [N/m], 0 for a tool that is held firmly; damping [N s/m]; mass [kg].
    place, speed, hand, push : (3,) arrays
        Of the tool [m], [m/s]; where the hand was [m]; force of the body on the tool [N].
    target : (l,) array
    tangent : (l, l) array
    firmness : (2,) array
        s, and what it glides to.
    """

    inner: Any
    slot: Slot
    numbers: Floats
    spring: Floats
    place: Floats
    speed: Floats
    hand: Floats
    push: Floats
    target: Floats
    tangent: Floats
    modulus_ratio: Floats


class Seen(NamedTuple):
    """What is known of one period.

    Parameters
    ----------
    coordinates, nodes, forces : arrays
        As `palpate.reduction.realtime.display_surface.Surface.displacements` takes them; the forces for the model's own moduli.
    place : (3,) array [m]
        Displacement of the tool, which is not the hand's where a spring is between them.
    hand : (3,) array [N]
        Force on the hand.
    firmness : float
        Moduli over the model's own.
    """

    coordinates: Floats
    nodes: NDArray[np.int64]
    forces: Floats
    place: Floats
    hand: Floats
    modulus_ratio: float


class WatchedModel(NamedTuple):
    """A model as the engine takes it; see `palpate.realtime.Realtime`."""

    advance: Any
    stiffness: Any
    data: Hung
    rest: Floats
    tool: Floats

    def seen(self) -> Seen:
        """Return what the last period published; from any thread."""
        numbers, count = snapshot(self.data.slot), len(self.rest)
        touched = numbers[HEAD + count :].reshape(-1, 4)[: int(numbers[COUNT])]
        return Seen(
            numbers[HEAD : HEAD + count], touched[:, 0].astype(np.int64), touched[:, 1:],
            numbers[PLACE : PLACE + 3], numbers[HAND : HAND + 3], float(numbers[FIRM]),
        )  # fmt: skip

    def put(self, coordinates: Floats, place: Floats) -> None:
        """Begin anew from coordinates, the tool at rest at a displacement (3,) [m]; while the engine does not run."""
        data = self.data
        for array in (data.speed, data.push, data.numbers):
            array[:] = 0.0
        data.place[:], data.hand[:] = place, place
        data.numbers[FIRM] = data.modulus_ratio[0]
        data.numbers[PLACE : PLACE + 3], data.numbers[HEAD : HEAD + len(self.rest)] = place, coordinates
        publish(data.slot, data.numbers)

    def stiffen(self, factor: float) -> None:
        """Let all moduli glide to a multiple of the model's, from 0.1 to 10, at its density.

        They change by no more than a factor of e in 0.2 s of the body. While the engine does not run.

        Raises
        ------
        InputError
            The factor is out of range.
        """
        self.data.modulus_ratio[1] = number_in_range("factor", factor, 0.1, 10.0)

    def couple(self, stiffness: float | None) -> None:
        """Hang the tool on a spring [N/m], critically damped; None holds it firmly. While the engine does not run.

        Raises
        ------
        InputError
            The stiffness is not from 1 to 10,000 N/m.
        """
        if stiffness is None:
            self.data.spring[:] = 0.0
            return
        stiffness = number_in_range("stiffness", stiffness, 1.0, 1e4, unit="N/m")
        self.data.spring[:] = stiffness, 2.0 * np.sqrt(stiffness * TOOL_MASS), TOOL_MASS


def watched(model: RealtimeModel) -> WatchedModel:
    """Return a model that tells what a period did to its surface; it shares the given one's data."""
    advance, stiffness = _functions(model.advance, model.stiffness)
    numbers = np.zeros(HEAD + len(model.rest) + 4 * min(MOST, len(model.data.contact_state.node)))
    spring, place, speed, hand, push = np.zeros((5, 3))
    tools = len(model.tool)
    data = Hung(
        model.data, Slot.of(len(numbers)), numbers, spring, place, speed, hand, push, np.zeros(tools),
        np.zeros((tools, tools)), np.ones(2),
    )  # fmt: skip
    own = WatchedModel(advance, stiffness, data, model.rest, model.tool)
    own.put(model.rest, np.zeros(3))
    return own


@cache
def _functions(inner_advance: Any, inner_stiffness: Any) -> tuple[Any, Any]:
    """Compile the period and the stiffness of a watched model."""
    digest = law_digest("watched", _name(inner_advance), _name(inner_stiffness), *_sources())

    @law_njit(digest)
    def hang(data, period):  # type: ignore[no-untyped-def]
        """Move the tool on its spring towards the hand for a period; tell the force on the hand."""
        stiffness, damping, mass = data.spring[STIFFNESS], data.spring[DAMPING], data.spring[MASS]
        whole = mass + period * damping + period * period * stiffness
        for i in range(3):
            wanted = data.target[i]
            hand = (wanted - data.hand[i]) / period
            pull = stiffness * (wanted - data.place[i]) + damping * hand + data.push[i]
            data.speed[i] = (mass * data.speed[i] + period * pull) / whole
            data.place[i] += period * data.speed[i]
            spring = stiffness * (wanted - data.place[i]) + damping * (hand - data.speed[i])
            data.numbers[HAND + i] = -spring
            data.hand[i] = wanted
            data.target[i] = data.place[i]

    @law_njit(digest)
    def advance(data, q, v, target, period, report):  # type: ignore[no-untyped-def]
        for k in range(target.shape[0]):
            data.target[k] = target[k]
        hung = data.spring[STIFFNESS] > 0.0
        if hung:
            hang(data, period)
        before, most = data.modulus_ratio[0], np.exp(GLIDE * period)
        firm = min(max(data.modulus_ratio[1], before / most), before * most)
        if firm != before:
            for m in range(v.shape[0]):
                v[m] *= np.sqrt(before / firm)
            data.modulus_ratio[0] = firm
        inner_advance(data.inner, q, v, data.target, period * np.sqrt(firm), report)
        if report[STATUS] != 0.0:
            return
        report[KINETIC] *= firm
        report[STRAIN] *= firm
        for k in range(FORCES, report.shape[0]):
            report[k] *= firm
        numbers, contact_state = data.numbers, data.inner.contact_state
        for i in range(3):
            data.push[i] = -report[FORCES + i]
            numbers[PLACE + i] = data.target[i]
            if not hung:
                numbers[HAND + i] = data.push[i]
        for m in range(q.shape[0]):
            numbers[HEAD + m] = q[m]
        at = HEAD + q.shape[0]
        count = min(contact_state.numbers[0], (numbers.shape[0] - at) // 4)
        numbers[COUNT], numbers[FIRM] = count, firm
        for e in range(count):
            numbers[at] = contact_state.node[e]
            for i in range(3):
                numbers[at + 1 + i] = contact_state.push[e, i]  # as of the model's own moduli
            at += 4
        publish(data.slot, numbers[:at])

    @law_njit(digest)
    def stiffness(data, q, out):  # type: ignore[no-untyped-def]
        inner_stiffness(data.inner, q, data.tangent)
        for i in range(out.shape[0]):
            for j in range(out.shape[1]):
                out[i, j] = data.modulus_ratio[0] * data.tangent[i, j]

    return advance, stiffness
