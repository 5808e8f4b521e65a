"""Real-time engine: steps a model at a fixed rate against a moving tool."""

from palpate.realtime.contract import Realtime
from palpate.realtime.device import DeviceLog, DummyDevice
from palpate.realtime.engine import Engine
from palpate.realtime.record import Reading
from palpate.realtime.statistics import Distribution, Statistics

__all__ = ["DeviceLog", "Distribution", "DummyDevice", "Engine", "Reading", "Realtime", "Statistics"]
