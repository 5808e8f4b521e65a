"""Types of arguments and results, for annotations.

Functions return and take these objects; a program need not make one itself.
"""

from palpate.dynamics.compiled.passes import Formulation
from palpate.dynamics.contact.tools import Motion, Tool
from palpate.dynamics.loads.prepared import Load, LoadHistory, PreparedLoads
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import FrequencyTracker, StabilityReport
from palpate.dynamics.run.model import ContactState, Model, Outputs
from palpate.realtime.device import Recording
from palpate.realtime.row import Reading
from palpate.realtime.statistics import Distribution, Tally
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.realtime.model import RealtimeModel

__all__ = [
    "ContactState",
    "Distribution",
    "Formulation",
    "FrequencyTracker",
    "Load",
    "LoadHistory",
    "Model",
    "Motion",
    "NodalModel",
    "Outputs",
    "PreparedLoads",
    "Reading",
    "RealtimeModel",
    "Recording",
    "ReducedData",
    "StabilityReport",
    "Tally",
    "Tool",
]
