"""Linear reductions of one body by palpate, by pyMOR and in the Hankel norm, with shared modes, Gramians and runs.

Modal truncation and moments are those of `palpate.lti.reduce_linear`. Balanced truncation of first and second order
and the iterative rational Krylov method are those of pyMOR (R. Milk, S. Rave, F. Schindler, SIAM J. Sci. Comput. 38,
2016); `to_pymor` and `from_pymor` convert the condensed body and its reduced models.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np
from hankel_norm import Realisation, balance, hankel_norm
from linear_runs import linear_run

import palpate as pt
from palpate.core.faults import InputError
from palpate.reduction.lti.pymor_bridge import need_pymor

SECOND_ORDER_BALANCING = {
    "sobt": "SOBTReductor", "sobt-p": "SOBTpReductor", "sobt-v": "SOBTvReductor", "sobt-pv": "SOBTpvReductor",
    "sobt-vp": "SOBTvpReductor", "sobt-fv": "SOBTfvReductor",
}  # fmt: skip
METHODS = ("modal", "moments", "irka", "balanced", "hankel", "pod", *SECOND_ORDER_BALANCING)
CONDENSED_MODES = 240  # modes of the condensed body that replaces a large one in balancing
IRKA_OPTIONS: dict[str, Any] = {"tol": 1e-3, "maxit": 20, "irka_options": {"tol": 1e-3, "maxit": 20}}
Run = tuple[Sequence[Any], float, float]


class Reductions:
    """Linear models of one linearised body by any of `METHODS`.

    Parameters
    ----------
    system : LinearSystem
        Linearised at rest.
    condense : int
        Number of slowest modes of the condensed body for balancing, the Hankel norm and rational Krylov methods.
    training : (loads, duration, every), optional
        A run of the linearised body, for POD.
    emphasis : (p,) array, optional
        Weight of each input in balancing; by default equal.
    """

    def __init__(
        self, system: Any, condense: int = CONDENSED_MODES, training: Run | None = None, emphasis: Any = None
    ) -> None:
        self.system, self.condense, self.training = system, condense, training
        self.scales = system.scales(emphasis)
        self.seconds: dict[str, float] = {}

    def model(self, method: str, modes: int) -> Any:
        """Return a linear model, with the time of its making and of the parts that it shares in its report."""
        before, start = sum(self.seconds.values()), perf_counter()
        if method in ("modal", "moments"):
            model = pt.lti.reduce_linear(self.system, method, modes)
        elif method == "pod":
            model = self._proper(modes)
        elif method == "hankel":
            model = self._hankel(modes)
        else:
            model = self._balanced(method, modes)
        shared = sum(self.seconds.values()) - before
        model.report.update(seconds=perf_counter() - start - shared, shared_seconds=self._shared(method))
        return model

    def _shared(self, method: str) -> float:
        """Return the time [s] of the parts that a method shares with others."""
        parts = {"modal": (), "moments": (), "pod": ("run",)}
        shared_parts = parts.get(method, ("condensed", "hankel" if method == "hankel" else "gramians"))
        return float(sum(self.seconds.get(part, 0.0) for part in shared_parts))

    def _timed(self, part: str, make: Callable[[], Any]) -> Any:
        start = perf_counter()
        made = make()
        self.seconds[part] = perf_counter() - start
        return made

    # shared parts

    @cached_property
    def snapshots(self) -> Any:
        """Displacements (t, n, 3) [m] of the training run, without the static fields of the tools."""
        if self.training is None:
            raise InputError("training must be a run for POD, got None; give training=(loads, duration, every)")
        loads, duration, every = self.training
        return self._timed("run", lambda: linear_run(self.system, loads, duration=duration, every=every)[1])

    @cached_property
    def condensed(self) -> Any:
        """Dense linear model for balancing: the condensed body."""
        return self._timed("condensed", lambda: pt.lti.reduce_linear(self.system, "condensed", self.condense))

    @cached_property
    def pymor(self) -> Any:
        """The condensed body as pyMOR's second-order model, scaled, which stores its Gramians."""
        fom = pt.lti.to_pymor(self.condensed, scales=self.scales)
        self._timed("gramians", lambda: [fom.gramian(kind) for kind in ("pc_lr", "po_lr")])
        return fom

    @cached_property
    def realisation(self) -> tuple[Realisation, Any]:
        """Balanced realisation of the condensed body, scaled, and its Hankel singular values."""
        (outputs, inputs), body = self.scales, self.condensed.reduced
        scaled = replace(
            body, input=body.input * inputs, output=outputs[:, None] * body.output,
            rate_output=outputs[:, None] * body.rate_output, feedthrough=outputs[:, None] * body.feedthrough * inputs,
        )  # fmt: skip
        return self._timed("hankel", lambda: balance(Realisation(*scaled.state_space())))

    @property
    def hankel_singular_values(self) -> Any:
        """Hankel singular values of the scaled body, descending."""
        return self.realisation[1]

    def bound(self, states: int) -> float:
        """Return the error bound of the scaled transfer function: twice the sum of the discarded values."""
        return float(2 * self.hankel_singular_values[states:].sum())

    def sizes(self, response: Any) -> Any:
        """Return the largest singular values (t,) of a response (t, q, p), inputs and outputs scaled."""
        outputs, inputs = self.scales
        return np.linalg.norm(outputs[:, None] * response * inputs, 2, axis=(1, 2))

    # methods

    def _balanced(self, method: str, modes: int) -> Any:
        """Return a model by a reductor of pyMOR."""
        need_pymor(f"method {method!r}")
        from pymor.reductors import sobt
        from pymor.reductors.bt import BTReductor
        from pymor.reductors.sor_irka import SORIRKAReductor

        if modes >= self.condensed.count:
            raise InputError(f"modes must be below {self.condensed.count}, got {modes}; increase condense")
        fom = self.pymor
        if method == "balanced":
            reductor = BTReductor(fom.to_lti())
            rom = reductor.reduce(2 * modes)
        elif method == "irka":
            start = BTReductor(fom.to_lti()).reduce(modes)  # one pole for each initial interpolation point
            reductor = SORIRKAReductor(fom)
            rom = reductor.reduce(start, **IRKA_OPTIONS)
        else:
            reductor = getattr(sobt, SECOND_ORDER_BALANCING[method])(fom)
            rom = reductor.reduce(modes)
        return pt.lti.from_pymor(rom, self.condensed, reductor, scales=self.scales, allow_unstable=True)

    def _proper(self, modes: int) -> Any:
        """Return the system projected on POD modes of the training run."""
        fom = pt.lti.to_pymor(self.system)
        from pymor.reductors.basic import SOLTIPGReductor

        basis = pt.pod(self.snapshots, self.system.model.weights, modes=modes)
        columns = (basis.modes.reshape(len(basis), -1) @ self.system.directions).T
        vectors = fom.solution_space.from_numpy(np.ascontiguousarray(columns))
        reductor = SOLTIPGReductor(fom, vectors, vectors)
        return pt.lti.from_pymor(reductor.reduce(), self.system, reductor, allow_unstable=True)

    def _hankel(self, modes: int) -> Any:
        """Return the optimal Hankel-norm approximation."""
        need_pymor("method 'hankel'")
        from pymor.models.iosys import LTIModel

        balanced, values = self.realisation
        if 2 * modes >= len(values):
            raise InputError(
                f"modes must be below half of the {len(values)} Hankel singular values above rounding, got {modes}"
            )
        rom = LTIModel.from_matrices(*hankel_norm(balanced, values, 2 * modes))
        return pt.lti.from_pymor(rom, self.condensed, scales=self.scales)
