"""Types of arguments and results, for annotations.

Functions return and take these objects; a program need not make one itself.
"""

import warnings
from typing import TYPE_CHECKING, Any

from palpate.app.view.show import LivePage
from palpate.dynamics.contact.tools import Motion, Tool
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.loads.supports import Support
from palpate.dynamics.nodal.equilibrium import Equilibrium
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import StabilityReport
from palpate.dynamics.run.model import Evaluation, Model, Outputs, StepReport
from palpate.dynamics.solid.unloading import UnloadedBody
from palpate.meshfree.cut.surface import CutSurface
from palpate.realtime.bodies.model import RealtimeModel
from palpate.realtime.device import DeviceLog
from palpate.realtime.record import Reading, ToolReading
from palpate.realtime.statistics import Distribution
from palpate.reduction.hyper.body import ReducedBody
from palpate.reduction.hyper.error_indicator import ExpectedError
from palpate.reduction.lti.realtime import LinearRealtime
from palpate.scenes.scene import Scene

__all__ = [
    "CutSurface",
    "DeadLoad",
    "DeviceLog",
    "Distribution",
    "Equilibrium",
    "Evaluation",
    "ExpectedError",
    "LinearRealtime",
    "LivePage",
    "Load",
    "Model",
    "Motion",
    "NodalModel",
    "Outputs",
    "PreparedLoads",
    "Reading",
    "RealtimeModel",
    "ReducedBody",
    "Scene",
    "StabilityReport",
    "StepReport",
    "Support",
    "Tool",
    "ToolReading",
    "UnloadedBody",
]

if TYPE_CHECKING:
    OrganScene = Scene
else:  # a type checker would take every name of this module

    def __getattr__(name: str) -> Any:
        if name != "OrganScene":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        message = "palpate.typing.OrganScene is palpate.typing.Scene since version 0.2; use the new name"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return Scene
