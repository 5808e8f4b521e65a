"""Files of reduced models, hyper-reduced and linear."""

from __future__ import annotations

from pathlib import Path
from typing import overload

from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import check_ending
from palpate.core.sealed import kind_of_file
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.lti import storage as linear_storage
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.system import LinearSystem
from palpate.reduction.storage import model_file
from palpate.reduction.storage.model_file import load_hyper_reduced, save_hyper_reduced

REDUCED_ENDINGS, LINEAR_ENDINGS = (".rom", ".h5"), (".lti", ".h5")  # of files


def save(model: ReducedModel | LinearModel, path: str | Path) -> None:
    """Write a reduced model to one checked file, completely or not at all.

    Parameters
    ----------
    model : ReducedModel or LinearModel
    path : path
        Ends in ``.rom``, or in ``.lti`` for a linear model; ``.h5`` and a name without an ending are allowed.

    Raises
    ------
    InputError
        The model is of another kind, the name ends in another way, or its file could not be read back: a custom
        material, or numbers that are not finite.
    OSError
        The path is not writable or the disk is full. An existing file is unchanged.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4)
    >>> path = Path(tempfile.mkdtemp()) / "bar.rom"
    >>> pt.save(model, path)
    >>> pt.load(path).count == model.count
    True
    """
    if isinstance(model, ReducedModel):
        check_ending(path, REDUCED_ENDINGS, "path of a reduced model")
        save_hyper_reduced(model, path)
    elif isinstance(model, LinearModel):
        check_ending(path, LINEAR_ENDINGS, "path of a linear model")
        linear_storage.save_linear(model, path)
    else:
        raise InputError(f"model must be a ReducedModel or a LinearModel, got {type(model).__name__}; reduce it first")


@overload
def load(path: str | Path) -> ReducedModel: ...


@overload
def load(path: str | Path, system: LinearSystem) -> LinearModel: ...


def load(path: str | Path, system: LinearSystem | None = None) -> ReducedModel | LinearModel:
    """Read a reduced model from a file of `save`.

    Parameters
    ----------
    path : path
    system : LinearSystem, optional
        The linearised body. The file of a linear model stores its reduced equations only.

    Returns
    -------
    ReducedModel or LinearModel

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    FileFormatError
        The file is truncated, changed, of another kind or version, or inconsistent. A linear model
        requires its system, and a hyper-reduced one takes none.
    InputError
        The linear model was made of another system.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4)
    >>> path = Path(tempfile.mkdtemp()) / "bar.rom"
    >>> pt.save(model, path)
    >>> pt.rollout(pt.load(path), [pull], duration=0.01, every=0.005).model
    'reduced'
    """
    path = Path(path)
    kind = kind_of_file(path)
    if system is None:
        if kind == linear_storage.FORMAT:
            raise FileFormatError(
                f"system must be given for the linear model {path}; pass the LinearSystem it was made of"
            )
        return load_hyper_reduced(path)
    if kind == model_file.FORMAT:
        raise FileFormatError(f"system must not be given for the reduced model {path}; leave it out")
    return linear_storage.read_linear(path, system)
