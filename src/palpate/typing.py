"""Types of arguments and results, for annotations.

Functions return and take these objects; a program need not make one itself.
"""

from palpate.dynamics.compiled.passes import Formulation
from palpate.dynamics.contact.tools import Motion, Tool
from palpate.dynamics.loads.dead_load import DeadLoad, ForcePattern
from palpate.dynamics.loads.prepared import Load, LoadHistory, PreparedLoads
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import FrequencyTracker, StabilityReport
from palpate.dynamics.run.model import ContactState, Model, Outputs
from palpate.realtime.device import DeviceLog
from palpate.realtime.record import Reading
from palpate.realtime.statistics import Distribution, Histograms
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.lti.realtime import LinearRealtime
from palpate.reduction.realtime.model import RealtimeModel

__all__ = [
    "ContactState",
    "DeadLoad",
    "DeviceLog",
    "Distribution",
    "ForcePattern",
    "Formulation",
    "FrequencyTracker",
    "Histograms",
    "LinearRealtime",
    "Load",
    "LoadHistory",
    "Model",
    "Motion",
    "NodalModel",
    "Outputs",
    "PreparedLoads",
    "Reading",
    "RealtimeModel",
    "ReducedData",
    "StabilityReport",
    "Tool",
]
