"""Types of arguments and results, for annotations.

Functions return and take these objects; a program need not make one itself.
"""

from palpate.dynamics.compiled.passes import Formulation
from palpate.dynamics.contact.tools import Motion, Tool
from palpate.dynamics.loads.dead_load import DeadLoad, ForcePattern
from palpate.dynamics.loads.prepared import Load, LoadHistory, PreparedLoads
from palpate.dynamics.loads.supports import Clamp, Support, SupportedNodes
from palpate.dynamics.material.tissue import Tissue
from palpate.dynamics.nodal.equilibrium import Equilibrium
from palpate.dynamics.nodal.model import NodalModel, NodalWork
from palpate.dynamics.nodal.stability import StabilityReport
from palpate.dynamics.run.model import ContactState, Evaluation, Model, Outputs, StepReport
from palpate.dynamics.run.reactions import NodalFields
from palpate.dynamics.solid.unloading import UnloadedBody
from palpate.meshfree.cut.surface import CutSurface
from palpate.meshfree.mirror import Mirror, MirrorPlane
from palpate.realtime.bodies.model import RealtimeModel
from palpate.realtime.device import DeviceLog
from palpate.realtime.record import Reading
from palpate.realtime.statistics import Distribution, Histograms
from palpate.reduction.galerkin.step import GalerkinWork
from palpate.reduction.hyper.body import ReducedBody, ReducedWork
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.error_indicator import ExpectedError
from palpate.reduction.lti.realtime import LinearRealtime
from palpate.scenes.organ_scene import OrganScene

__all__ = [
    "Clamp",
    "ContactState",
    "CutSurface",
    "DeadLoad",
    "DeviceLog",
    "Distribution",
    "Equilibrium",
    "Evaluation",
    "ExpectedError",
    "ForcePattern",
    "Formulation",
    "GalerkinWork",
    "Histograms",
    "LinearRealtime",
    "Load",
    "LoadHistory",
    "Mirror",
    "MirrorPlane",
    "Model",
    "Motion",
    "NodalFields",
    "NodalModel",
    "NodalWork",
    "OrganScene",
    "Outputs",
    "PreparedLoads",
    "Reading",
    "RealtimeModel",
    "ReducedBody",
    "ReducedData",
    "ReducedWork",
    "StabilityReport",
    "StepReport",
    "Support",
    "SupportedNodes",
    "Tissue",
    "Tool",
    "UnloadedBody",
]
