"""Linear reductions of one body by all methods, with shared expensive parts: modes, Gramians and runs.

Balanced truncation of first and second order and the iterative rational Krylov method are those of
pyMOR (R. Milk, S. Rave, F. Schindler, SIAM J. Sci. Comput. 38, 2016). pyMOR does not provide
Hankel-norm approximation and modal truncation of second order; these are implemented here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, integer_in_range
from palpate.dynamics.loads.prepared import Load
from palpate.reduction.lti.budget import Budget, dense_lyapunov
from palpate.reduction.lti.hankel import Realisation, balance, hankel_norm, nearest_fields
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.projection_methods import condense, modal, moments, project, proper
from palpate.reduction.lti.pymor_bridge import need_pymor
from palpate.reduction.lti.simulate import linear_run
from palpate.reduction.lti.state_space import FirstOrder, Reduced, SecondOrder
from palpate.reduction.lti.system import LinearSystem

SECOND_ORDER_BALANCING = {
    "sobt": "SOBTReductor", "sobt-p": "SOBTpReductor", "sobt-v": "SOBTvReductor", "sobt-pv": "SOBTpvReductor",
    "sobt-vp": "SOBTvpReductor", "sobt-fv": "SOBTfvReductor",
}  # fmt: skip
TITLE_BY_METHOD = {
    "modal": "modal truncation",
    "moments": "Krylov, moments matched",
    "irka": "Krylov, second-order IRKA",
    "balanced": "balanced truncation, first order",
    "hankel": "Hankel-norm approximation, first order",
    "pod": "POD of the linearised run",
    "sobt": "second-order balanced truncation",
    "sobt-p": "the same, position",
    "sobt-v": "the same, velocity",
    "sobt-pv": "the same, position-velocity",
    "sobt-vp": "the same, velocity-position",
    "sobt-fv": "the same, free velocity",
}
PYMOR_METHODS = {"irka", "balanced", *SECOND_ORDER_BALANCING}
CONDENSED_MODES = 240  # modes of the condensed body that replaces a large one in balancing
IRKA_OPTIONS: dict[str, Any] = {"tol": 1e-3, "maxit": 20, "irka_options": {"tol": 1e-3, "maxit": 20}}
Run = tuple[Sequence[Load], float, float]


class Reduction:
    """Linear reductions of one linearised body.

    Parameters
    ----------
    system : LinearSystem
        Linearised at rest.
    condense : int, optional
        Number of slowest modes of the condensed body for balancing and rational Krylov methods
        (`palpate.reduction.lti.projection_methods.condense`); by default 240. 0, or the number of
        unknowns, uses the body itself, if the budget allows it.
    budget : Budget
        Limits of time and memory.
    training : (loads, duration, every), optional
        A run of the linearised body, for POD.
    emphasis : (p,) array, optional
        Weight of each input in balancing; by default equal.
    """

    def __init__(
        self,
        system: LinearSystem,
        *,
        condense: int | None = None,
        budget: Budget | None = None,
        training: Run | None = None,
        emphasis: Sequence[float] | Floats | None = None,
    ) -> None:
        if system.at.any():
            raise InputError("system must be linearised at rest, got another state; linearise without state")
        self.system, self.budget, self.training = system, budget or Budget(), training
        self.condense = (
            min(CONDENSED_MODES, system.order) if condense is None else integer_in_range("condense", condense, 0)
        )
        count = len(system.inputs)
        self.emphasis = np.ones(count) if emphasis is None else np.array(emphasis, dtype=float)
        if self.emphasis.shape != (count,) or not np.all(np.isfinite(self.emphasis) & (self.emphasis > 0)):
            raise InputError(f"emphasis must be {count} positive numbers, one per input, got {emphasis!r}")
        self.seconds: dict[str, float] = {}

    def model(self, method: str, modes: int, **options: Any) -> LinearModel:
        """Return a linear model.

        Parameters
        ----------
        method : str
            One of `TITLE_BY_METHOD`.
        modes : int
            Number of displacement coordinates; methods of first order have twice as many states.
        options
            Of `moments`: points, complex frequencies [1/s].
        """
        if method not in TITLE_BY_METHOD:
            raise InputError(f"method must be one of {', '.join(map(repr, TITLE_BY_METHOD))}, got {method!r}")
        if options and method != "moments":
            raise InputError(f"options must be empty for method {method!r}, got {', '.join(options)}")
        integer_in_range("modes", modes, 1, self.system.order - 1)
        if method in PYMOR_METHODS:
            need_pymor(f"method {method!r}")
        before, start = sum(self.seconds.values()), perf_counter()
        reduced = self._reduced(method, modes, options)
        shared = sum(self.seconds.values()) - before  # time of parts that other methods use, too
        report = {
            "method": method, "modes": len(reduced.fields), "states": reduced.states,
            "seconds": perf_counter() - start - shared, "shared_seconds": self._shared(method),
            "unknowns": self.system.order,
        }  # fmt: skip
        return LinearModel(self.system, reduced, report)

    def _reduced(self, method: str, modes: int, options: dict[str, Any]) -> Reduced:
        system = self.system
        if method == "modal":
            return modal(system, modes)
        if method == "moments":
            return moments(system, modes, **options)
        if method == "pod":
            return proper(system, self.snapshots, modes)
        if method == "hankel":
            return self._hankel(modes)
        if method == "balanced":
            return self._balanced(modes)
        return self._second_order(method, modes)

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
    def snapshots(self) -> Floats:
        """Displacements (t, n, 3) [m] of the training run, without the static fields of the tools."""
        if self.training is None:
            raise InputError("training must be a run for POD, got None; give training=(loads, duration, every)")
        loads, duration, every = self.training
        return np.asarray(self._timed("run", lambda: linear_run(self.system, loads, duration=duration, every=every)[1]))

    @cached_property
    def source(self) -> SecondOrder:
        """Dense system for balancing: the condensed body, or the whole one."""
        system = self.system
        if self.condense and self.condense < system.order - 2:
            return self._timed("condensed", lambda: condense(system, self.condense)[0])
        estimate = dense_lyapunov(2 * system.order)
        self.budget.check(
            estimate, f"dense Lyapunov equations of order {2 * system.order}",
            f"give condense={CONDENSED_MODES} to balance that many of the slowest modes instead, or a coarser cloud",
        )  # fmt: skip
        roots = 1.0 / np.sqrt(system.mass.diagonal())
        return self._timed("condensed", lambda: project(system, np.diag(roots)))

    @cached_property
    def scales(self) -> tuple[Floats, Floats]:
        """Factors (q,) of the outputs and (p,) of the inputs that make different units comparable in balancing.

        Displacements and forces are each divided by their largest static response to the weighted
        inputs, and a tool's rotations by its radius.
        """
        static = np.abs(self.system.transfer(0.0)[0].real) * self.emphasis
        kinds = np.array([name.split()[0] for name in self.system.outputs])
        outputs = np.ones(len(kinds))
        for kind in np.unique(kinds):
            outputs[kinds == kind] = 1.0 / max(static[kinds == kind].max(), 1e-300)
        inputs = np.ones(len(self.system.inputs))
        if len(self.system.lifting):
            inputs[self.system.forces :] = 1.0 / np.abs(self.system.lifting).max(axis=(1, 2))
        return outputs, inputs * self.emphasis

    @cached_property
    def scaled(self) -> SecondOrder:
        """System `source` with scaled inputs and outputs."""
        system, (outputs, inputs) = self.source, self.scales
        return SecondOrder(
            system.mass, system.damping, system.stiffness, system.input * inputs, outputs[:, None] * system.output,
            outputs[:, None] * system.rate_output, outputs[:, None] * system.feedthrough * inputs, system.fields,
        )  # fmt: skip

    @cached_property
    def pymor(self) -> Any:
        """The scaled system as pyMOR's second-order model, which stores its Gramians."""
        need_pymor("balancing")
        from pymor.bindings.scipy import ScipyLyapunovSolverLR
        from pymor.models.iosys import SecondOrderModel
        from pymor.solvers.matrix_equations.default import MatrixEquationSolvers

        scaled = self.scaled
        return SecondOrderModel.from_matrices(
            scaled.mass, scaled.damping, scaled.stiffness, scaled.input, scaled.output, scaled.rate_output,
            scaled.feedthrough, name="palpate",
            matrix_equation_solvers=MatrixEquationSolvers(lyapunov_lr=ScipyLyapunovSolverLR()),
        )  # fmt: skip

    def _gramians(self) -> None:
        """Compute the Gramians by pyMOR, once."""
        if "gramians" not in self.seconds:
            self._timed("gramians", lambda: [self.pymor.gramian(kind) for kind in ("pc_lr", "po_lr")])

    @cached_property
    def realisation(self) -> tuple[Realisation, Floats, Floats]:
        """Balanced realisation of the scaled body, its Hankel singular values, and T (2 m, n): x = T z."""
        return self._timed("hankel", lambda: balance(Realisation(*self.scaled.state_space())))

    @property
    def hankel_singular_values(self) -> Floats:
        """Hankel singular values of the scaled body, descending."""
        return self.realisation[1]

    def bound(self, states: int) -> float:
        """Return the error bound of the scaled transfer function: twice the sum of the discarded values."""
        return float(2 * self.hankel_singular_values[states:].sum())

    def scaled_error(self, reduced: Reduced, frequencies: Any, *, whole: bool = False) -> Floats:
        """Return the largest singular value of the scaled transfer function's error, (t,), at frequencies [rad/s].

        The reference is the system `source`, or with `whole` the whole body.
        """
        s = 1j * np.atleast_1d(np.asarray(frequencies, dtype=float))
        outputs, inputs = self.scales
        exact = self.system.transfer(s) if whole else self.source.transfer(s)
        return np.linalg.norm(outputs[:, None] * (exact - reduced.transfer(s)) * inputs, 2, axis=(1, 2))

    # methods of pyMOR, and the Hankel norm

    def _second_order(self, method: str, modes: int) -> SecondOrder:
        if modes >= len(self.source.mass):
            raise InputError(f"modes must be below {len(self.source.mass)}, got {modes}; increase condense")
        fom, system = self.pymor, self.scaled
        if method == "irka":
            from pymor.reductors.bt import BTReductor
            from pymor.reductors.sor_irka import SORIRKAReductor

            self._gramians()
            start = BTReductor(fom.to_lti()).reduce(modes)  # one pole for each initial interpolation point
            reductor = SORIRKAReductor(fom)
            rom = reductor.reduce(start, **IRKA_OPTIONS)
            fields = _columns(reductor.V)
        else:
            from pymor.reductors import sobt

            self._gramians()
            reductor = getattr(sobt, SECOND_ORDER_BALANCING[method])(fom)
            rom = reductor.reduce(modes)
            if method == "sobt":
                v1, w1, v2 = (_columns(block) for block in (reductor.V1, reductor.W1, reductor.V2))
                fields = v1 @ np.linalg.solve(w1.T @ v1, w1.T @ v2)
            else:
                fields = _columns(reductor.V)
        m, e, k, b, cp, cv, _ = rom.to_matrices()
        outputs, inputs = self.scales
        cv = np.zeros_like(cp) if cv is None else cv
        return SecondOrder(
            m, e, k, b / inputs, cp / outputs[:, None], cv / outputs[:, None],
            system.feedthrough / outputs[:, None] / inputs, np.tensordot(fields.T, system.fields, 1),
        )  # fmt: skip

    def _balanced(self, modes: int) -> FirstOrder:
        from pymor.reductors.bt import BTReductor

        if 2 * modes >= self.source.states:
            raise InputError(f"modes must be below {len(self.source.mass)}, got {modes}; increase condense")
        self._gramians()
        reductor = BTReductor(self.pymor.to_lti())
        a, b, c, _, e = reductor.reduce(2 * modes).to_matrices()
        if e is not None:
            a, b = np.linalg.solve(e, a), np.linalg.solve(e, b)
        position = _columns(reductor.V.blocks[0])
        return self._unscaled(
            Realisation(a, b, c, self.scaled.feedthrough), np.tensordot(position.T, self.scaled.fields, 1)
        )

    def _hankel(self, modes: int) -> FirstOrder:
        balanced, values, into = self.realisation
        if 2 * modes >= len(values):
            raise InputError(
                f"modes must be below half of the {len(values)} Hankel singular values above rounding, got {modes}"
            )
        reduced = hankel_norm(balanced, values, 2 * modes)
        fields = np.tensordot(into[: len(self.scaled.fields)].T, self.scaled.fields, 1)
        return self._unscaled(reduced, nearest_fields(balanced, fields, reduced))

    def _unscaled(self, system: Realisation, fields: Floats) -> FirstOrder:
        outputs, inputs = self.scales
        return FirstOrder(
            system.A, system.B / inputs, system.C / outputs[:, None], system.D / outputs[:, None] / inputs, fields
        )  # fmt: skip


def _columns(vectors: Any) -> Floats:
    """Return the columns (d, k) of a pyMOR array of vectors."""
    return np.asarray(vectors.to_numpy())


def reduce_linear(system: LinearSystem, method: str, modes: int, **options: Any) -> LinearModel:
    """Reduce a linearised body by one method; `Reduction` shares computations between several methods.

    Parameters
    ----------
    system : LinearSystem
    method : str
        ``"modal"``, ``"moments"``, ``"pod"``, ``"hankel"``, and by pyMOR ``"irka"``,
        ``"balanced"``, ``"sobt"``, ``"sobt-p"``, ``"sobt-v"``, ``"sobt-pv"``, ``"sobt-vp"``,
        ``"sobt-fv"``: see docs/linear.md.
    modes : int
        Number of displacement coordinates; methods of first order have twice as many states.
    options
        `condense`, `budget`, `training` and `emphasis` of `Reduction`; `points` of the moments.

    Returns
    -------
    LinearModel

    Raises
    ------
    InputError
        As `Reduction.model`.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> model = pt.lti.reduce_linear(system, "modal", 6)
    >>> model.count, model.stable
    (6, True)
    """
    shared = {name: options.pop(name) for name in ("condense", "budget", "training", "emphasis") if name in options}
    return Reduction(system, **shared).model(method, modes, **options)
