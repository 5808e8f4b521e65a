"""The names of scenes with random paths, for training and for the page.

A command line reads them without an import of numerics.
"""

from __future__ import annotations

__all__ = ["SCENES", "listed_scenes"]

SCENES = {  # name: module in palpate.scenes, function that returns a TrainingScene
    "beam": ("grasp", "grasped_beam"),
    "liver": ("liver", "pressed_liver"),
    "membrane": ("push", "pushed_membrane"),
}


def listed_scenes() -> str:
    """Return the names for a sentence, such as ``beam, liver, membrane``."""
    return ", ".join(SCENES)
