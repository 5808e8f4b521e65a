"""A bar whose end forceps pull, and a training of its reduced models in this process."""

from __future__ import annotations

from palpate.app.common.console import Console
from palpate.app.models.trained import train_compared

END = 0.06  # [m]: the end of the bar
BAR = """
title = "Bar"
[surface]
generated = "box"
size = [0.06, 0.02, 0.02]
[body]
spacing = "6.6666666666666667 mm"
[tissue]
law = "MooneyRivlin"
parameters = { C1 = 4e3, C2 = 4e3 }
[[support]]
place = { group = "x-" }
[tool]
holds = "x+"
[training]
paths = 2
held_out = 1
modes = 6
every = 0.005
duration = 0.05
low = [-0.001, -0.001, -0.001]
high = [0.004, 0.001, 0.001]
low_turn = [-0.01, -0.01, -0.01]
high_turn = [0.01, 0.01, 0.01]
"""


class Trainer:
    """A training in this process, which reports that it began."""

    def __init__(self, scene):
        self.scene = scene

    def events(self):
        yield {"phase": "1 of 2 runs", "left": 8.0}
        train_compared(self.scene, Console(), 1)

    def stop(self):
        """Do nothing: it ends by itself."""
