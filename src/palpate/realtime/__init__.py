"""Models stepped at a fixed rate against a tool."""

from palpate.realtime.contract import Realtime
from palpate.realtime.device import DummyDevice, Recording
from palpate.realtime.engine import Engine
from palpate.realtime.row import Reading
from palpate.realtime.statistics import Distribution, Statistics

__all__ = ["Distribution", "DummyDevice", "Engine", "Reading", "Realtime", "Recording", "Statistics"]
