"""Conversion to pyMOR, an optional package: the linearised body as its second-order model."""

from __future__ import annotations

from typing import Any

from palpate.core.extras import require
from palpate.core.working_folder import import_pymor
from palpate.reduction.lti.system import LinearSystem


def need_pymor(what: str) -> None:
    """Import pyMOR and reduce its log level."""
    require("pymor", what)
    import_pymor()
    from pymor.core.logger import set_log_levels

    set_log_levels({"pymor": "ERROR"})


def to_pymor(system: LinearSystem, solver: Any = None) -> Any:
    """Return a linearised body as pyMOR's `pymor.models.iosys.SecondOrderModel`.

    Its E is the damping, its D the feedthrough.

    Parameters
    ----------
    system : LinearSystem
    solver : object, optional
        A `pymor.solvers.matrix_equations.interface.LyapunovSolverLR` for its Gramians.

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
    from pymor.models.iosys import SecondOrderModel
    from pymor.solvers.matrix_equations.default import MatrixEquationSolvers

    return SecondOrderModel.from_matrices(
        system.mass, system.damping, system.stiffness, system.input.toarray(), system.output.toarray(),
        system.rate_output.toarray(), system.feedthrough,
        matrix_equation_solvers=None if solver is None else MatrixEquationSolvers(lyapunov_lr=solver),
        name="palpate",
    )  # fmt: skip
