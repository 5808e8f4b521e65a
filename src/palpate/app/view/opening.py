"""What `palpate view` shows: a scene by its name, or a model from a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from palpate.app.console import Console
from palpate.faults import InputError
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.grasp import grasped_beam
from palpate.scenes.push import pushed_membrane
from palpate.scenes.scene import TrainingScene

__all__ = ["opened"]

# of scenes that are trained now, at a hand: how they are made, and modes
HELD: dict[str, tuple[Callable[[], TrainingScene], int]] = {
    "beam": (grasped_beam, 24),
    "membrane": (pushed_membrane, 24),
}
SCENES = ("liver", *HELD)


def opened(what: str, console: Console) -> tuple[ReducedModel, str]:
    """Return a model that takes a tool, and its title.

    Parameters
    ----------
    what : str
        ``"liver"``: the small model from the user's cache, trained at first use; ``"beam"``: the paper's, held at its
        end by a hand, and ``"membrane"``: a taut one, held at its middle, both trained now; or a file of
        `palpate train`.
    console : Console

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        No such scene or file, or a model that takes no tool.
    """
    if what == "liver":
        from palpate.app.run.liver import cached

        return cached(console), "Liver"
    if what in HELD:
        from palpate.app.run.quick import trained

        return trained(*HELD[what], console), what.capitalize()
    path = Path(what)
    if not path.suffix and not path.exists():
        raise InputError(f"SCENE = {what!r}: allowed are {', '.join(SCENES)}, or a file of `palpate train`")
    model = load(path)
    if model.data.compliance is None and len(model.data.prescribed) != 1:
        raise InputError(
            f"{path}: this model takes no tool: it was trained without one that touches it and holds "
            f"{len(model.data.prescribed)} groups; train it with a Contact, or with prescribed='GROUP'"
        )
    name = str(model.report.get("scene", {}).get("name", path.stem))
    return model, name.rpartition(":")[2].replace("_", " ").capitalize()
