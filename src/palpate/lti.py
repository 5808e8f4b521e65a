"""Bodies linearised, and their linear reductions."""

from palpate.reduction.lti.export import save_matlab, save_matrix_market
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.pymor_bridge import from_pymor, to_pymor
from palpate.reduction.lti.reductors import reduce_linear
from palpate.reduction.lti.state_space import FirstOrder, SecondOrder
from palpate.reduction.lti.system import LinearSystem, linearise

__all__ = [
    "FirstOrder",
    "LinearModel",
    "LinearSystem",
    "SecondOrder",
    "from_pymor",
    "linearise",
    "reduce_linear",
    "save_matlab",
    "save_matrix_market",
    "to_pymor",
]
