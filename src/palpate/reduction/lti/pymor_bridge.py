"""Bridge to pyMOR, an optional package: a linear body as its model, and a reduced model of it as a linear model.

A reductor of pyMOR projects on basis vectors V. The fields of the reduced coordinates are then those
of V. A reduced model without V, such as a Hankel-norm approximation, gets the fields that are nearest
in the mean square over white inputs: Phi X P^-1, with the joint Gramian X of the states of both models,
and the Gramian P of the reduced states.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse

from palpate.core.arrays import Floats
from palpate.core.extras import require
from palpate.core.faults import InputError
from palpate.core.working_folder import import_pymor
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.state_space import FirstOrder, Reduced, SecondOrder
from palpate.reduction.lti.system import LinearSystem

Scales = tuple[Floats, Floats]

SECOND_ORDER_NAMES = ("mass", "damping", "stiffness", "input", "output", "rate_output", "feedthrough")  # M, E, K, ...
FIRST_ORDER_NAMES = ("state", "input", "output", "feedthrough", "mass")  # A, B, C, D, E
GRAMIAN_TOLERANCE = 1e-12  # relative singular value of a Gramian that counts as zero


def need_pymor(what: str) -> None:
    """Import pyMOR and reduce its log level."""
    require("pymor", what)
    import_pymor()
    from pymor.core.logger import set_log_levels

    set_log_levels({"pymor": "ERROR"})


def to_pymor(source: LinearSystem | LinearModel, solver: Any = None, scales: Scales | None = None) -> Any:
    """Return a linear body as a model of pyMOR.

    It is a `pymor.models.iosys.SecondOrderModel`, whose E is the damping and whose D is the
    feedthrough. A linear model of first order is a `pymor.models.iosys.LTIModel`.

    Parameters
    ----------
    source : LinearSystem or LinearModel
        A condensed model (`reduce_linear`) for methods that solve dense equations, such as balancing.
    solver : object, optional
        A `pymor.solvers.matrix_equations.interface.LyapunovSolverLR` for its Gramians; by default a
        dense one for a model, and that of pyMOR for a system.
    scales : (outputs, inputs), optional
        Factors that multiply outputs and inputs, as of `LinearSystem.scales`, so that balancing
        compares different units.

    Returns
    -------
    SecondOrderModel or LTIModel
        Of pyMOR.

    Raises
    ------
    InputError
        pyMOR is not installed, or the scales do not fit.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> pt.lti.to_pymor(system).order == system.order
    True
    """
    need_pymor("conversion of a linear system")
    from pymor.bindings.scipy import ScipyLyapunovSolverLR
    from pymor.models.iosys import LTIModel, SecondOrderModel
    from pymor.solvers.matrix_equations.default import MatrixEquationSolvers

    system = source if isinstance(source, LinearSystem) else source.system
    form = source if isinstance(source, LinearSystem) else source.reduced
    if solver is None and isinstance(source, LinearModel):
        solver = ScipyLyapunovSolverLR()
    about = {"matrix_equation_solvers": solver and MatrixEquationSolvers(lyapunov_lr=solver), "name": "palpate"}
    outputs, inputs = _factors(system, scales)
    b, c = _dense(form.input) * inputs, outputs * _dense(form.output)
    through = outputs * form.feedthrough * inputs
    if isinstance(form, FirstOrder):
        return LTIModel.from_matrices(form.state, b, c, through, **about)
    rates = outputs * _dense(form.rate_output)
    return SecondOrderModel.from_matrices(form.mass, form.damping, form.stiffness, b, c, rates, through, **about)


def from_pymor(
    rom: Any,
    source: LinearSystem | LinearModel,
    reductor: Any = None,
    *,
    scales: Scales | None = None,
    allow_unstable: bool = False,
) -> LinearModel:
    """Return a reduced model of pyMOR as a linear model, which runs, engines and files take.

    Parameters
    ----------
    rom : LTIModel or SecondOrderModel
        Of pyMOR, with the inputs and outputs of `to_pymor`.
    source : LinearSystem or LinearModel
        The one that `to_pymor` converted.
    reductor : object, optional
        The reductor of pyMOR whose last result is `rom`: its basis has the displacements of the
        reduced coordinates. Without it the model has the fields that are nearest in the mean square
        over white inputs, none for a coordinate that no input moves; `source` must then be a linear
        model, and both must be stable.
    scales : (outputs, inputs), optional
        Those of `to_pymor`.
    allow_unstable : bool
        Whether a model with a pole that is not in the left half-plane is returned.

    Returns
    -------
    LinearModel
        `report["bound"]` is the bound of the error of the (scaled) transfer function against `source`,
        if the reductor has one.

    Raises
    ------
    InputError
        A model of another kind, in discrete time or with parameters; other numbers of inputs or
        outputs; numbers that are not real and finite; a singular mass; a reductor of another model; an
        unstable model.

    Examples
    --------
    >>> import palpate as pt
    >>> from pymor.reductors.bt import BTReductor
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> condensed = pt.lti.reduce_linear(system, "condensed", 40)
    >>> reductor = BTReductor(pt.lti.to_pymor(condensed).to_lti())
    >>> model = pt.lti.from_pymor(reductor.reduce(12), condensed, reductor)
    >>> model.count, model.stable
    (12, True)
    """
    need_pymor("conversion of a reduced model")
    system = source if isinstance(source, LinearSystem) else source.system
    outputs, inputs = _factors(system, scales)
    scaled = _reduced(rom, system)
    fields = _nearest_fields(scaled, source, inputs) if reductor is None else _basis_fields(rom, source, reductor)
    reduced = replace(
        scaled, input=scaled.input / inputs, output=scaled.output / outputs,
        feedthrough=scaled.feedthrough / outputs / inputs, fields=fields,
    )  # fmt: skip
    if isinstance(reduced, SecondOrder):
        reduced = replace(reduced, rate_output=reduced.rate_output / outputs)
    report: dict[str, Any] = {
        "method": "pyMOR" if reductor is None else type(reductor).__name__, "modes": len(fields),
        "states": reduced.states, "unknowns": system.order,
    }  # fmt: skip
    if report["method"] == "BTReductor":  # bounds of the others are of other norms or systems
        report["bound"] = float(reductor.error_bounds()[len(fields) - 1])
    model = LinearModel(system, reduced, report)
    if not model.stable and not allow_unstable:
        raise InputError(
            "rom must be stable, got a pole with a real part of "
            f"{model.poles.real.max():.3g} 1/s; take another order or method, or allow_unstable=True"
        )
    return model


def _factors(system: LinearSystem, scales: Scales | None) -> Scales:
    """Return factors (q, 1) of the outputs and (p,) of the inputs."""
    sizes = len(system.outputs), len(system.inputs)
    outputs, inputs = (np.asarray(each, float) for each in scales or (np.ones(sizes[0]), np.ones(sizes[1])))
    if (outputs.shape, inputs.shape) != ((sizes[0],), (sizes[1],)) or not _positive(outputs) or not _positive(inputs):
        raise InputError(
            f"scales must be {sizes[0]} positive factors of outputs and {sizes[1]} of inputs, got shapes "
            f"{outputs.shape} and {inputs.shape}; take those of LinearSystem.scales"
        )
    return outputs[:, None], inputs


def _positive(values: Floats) -> bool:
    return bool(np.all(np.isfinite(values) & (values > 0)))


def _dense(matrix: Any) -> Floats:
    return np.asarray(matrix.toarray() if sparse.issparse(matrix) else matrix)


def _reduced(rom: Any, system: LinearSystem) -> Reduced:
    """Return the equations of a model of pyMOR, without fields."""
    from pymor.models.iosys import LTIModel, SecondOrderModel

    if type(rom) not in (LTIModel, SecondOrderModel):
        raise InputError(f"rom must be an LTIModel or a SecondOrderModel of pyMOR, got a {type(rom).__name__}")
    if rom.sampling_time or rom.parametric:
        raise InputError("rom must be in continuous time and without parameters, got another; convert it in pyMOR")
    sizes = len(system.outputs), len(system.inputs)
    if (rom.dim_output, rom.dim_input) != sizes:
        raise InputError(
            f"rom must have the {sizes[1]} inputs and {sizes[0]} outputs of the system, got {rom.dim_input} "
            f"and {rom.dim_output}; reduce the model of to_pymor"
        )
    second, given = isinstance(rom, SecondOrderModel), {}
    for name, matrix in zip(SECOND_ORDER_NAMES if second else FIRST_ORDER_NAMES, rom.to_matrices(), strict=True):
        if matrix is None:
            continue
        given[name] = _dense(matrix)
        if np.iscomplexobj(given[name]) or not np.isfinite(given[name]).all():
            raise InputError("matrices of rom must be real and finite, got others; reduce again with other options")
    mass = given.get("mass", np.eye(rom.order))
    if np.linalg.cond(mass) > 1 / np.finfo(float).eps:
        raise InputError("mass (E of an LTIModel) of rom must not be singular; project algebraic equations out")
    given.setdefault("feedthrough", np.zeros(sizes))
    none = np.zeros((0, 0, 3))
    if second:
        given.setdefault("rate_output", np.zeros_like(given["output"]))
        return SecondOrder(**given, fields=none)
    if given.pop("mass", None) is not None:
        given |= {name: np.asarray(np.linalg.solve(mass, given[name]), float) for name in ("state", "input")}
    return FirstOrder(**given, fields=none)


def _basis_fields(rom: Any, source: LinearSystem | LinearModel, reductor: Any) -> Floats:
    """Return the fields (k, n, 3) of the basis vectors of a reductor."""
    try:
        if hasattr(reductor, "V1"):  # SOBTReductor: bases of positions and velocities
            crossed = np.linalg.solve(reductor.W1.inner(reductor.V1), reductor.W1.inner(reductor.V2))
            vectors = reductor.V1.lincomb(crossed)
        else:
            vectors = reductor.reconstruct(rom.solution_space.from_numpy(np.eye(rom.order)))
    except (AssertionError, AttributeError, TypeError, ValueError) as error:
        raise InputError(
            f"reductor must have a basis of the {rom.order} coordinates of rom, got a {type(reductor).__name__}; "
            "give the reductor that made it, or None"
        ) from error
    columns = np.asarray((vectors.blocks[0] if hasattr(vectors, "blocks") else vectors).to_numpy())
    size = source.order if isinstance(source, LinearSystem) else source.count
    if columns.shape != (size, rom.order):
        raise InputError(
            f"reductor must have a basis of shape {(size, rom.order)}, got {columns.shape}; give the one that reduced "
            "to_pymor(source), right after its reduction"
        )
    if isinstance(source, LinearSystem):
        return source.fields(columns)
    return np.asarray(np.tensordot(columns.T, source.reduced.fields, 1))


def _nearest_fields(scaled: Reduced, source: LinearSystem | LinearModel, inputs: Floats) -> Floats:
    """Return the fields (k, n, 3) nearest to the motion of a source in the mean square over white inputs."""
    if isinstance(source, LinearSystem):
        raise InputError(
            "reductor must be given for a rom of a LinearSystem, got None; or reduce a condensed model of it"
        )
    a, b = scaled.state_space()[:2]
    if not source.stable or np.linalg.eigvals(a).real.max() >= 0:
        raise InputError("rom and source must be stable without a reductor, got a pole that is not; give the reductor")
    k = len(a) // 2 if isinstance(scaled, SecondOrder) else len(a)
    joint = scipy.linalg.solve_sylvester(source.A, a.T, -source.B @ (inputs[:, None] * b.T))
    gramian = scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T)
    gramian = ((gramian + gramian.T) / 2)[:k, :k]
    weights = np.linalg.lstsq(gramian, joint[: source.count, :k].T, rcond=GRAMIAN_TOLERANCE)[0]
    return np.asarray(np.tensordot(weights, source.reduced.fields, 1))
