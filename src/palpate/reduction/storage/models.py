"""Files of models, runs and equilibria, by the ending of their name."""

from __future__ import annotations

from pathlib import Path
from typing import cast, overload

from palpate.core.faults import FileFormatError, InputError, brief
from palpate.core.files import check_ending
from palpate.core.sealed import kind_of_file
from palpate.dynamics.nodal.equilibrium import Equilibrium
from palpate.dynamics.run.model import BODY_ENDINGS, Model
from palpate.dynamics.run.trajectory import FORMAT as TRAJECTORY_FORMAT
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.lti import storage as linear_storage
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.system import LinearSystem
from palpate.reduction.storage import model_file
from palpate.reduction.storage.model_file import load_hyper_reduced, save_hyper_reduced

MODEL_FILE = "the model, for palpate.load"
REDUCED_ENDINGS = {".rom": MODEL_FILE, ".h5": MODEL_FILE} | BODY_ENDINGS
LINEAR_ENDINGS = {".lti": MODEL_FILE, ".h5": MODEL_FILE} | BODY_ENDINGS
MODEL_ENDINGS = {".rom": "a reduced model", ".lti": "a linear one", ".h5": "either"}
Saved = Model | Trajectory | Equilibrium


def save(model: Saved, path: str | Path) -> None:
    """Write a model, a run or an equilibrium to one file, completely or not at all; the ending names the format.

    Parameters
    ----------
    model : Model, Trajectory or Equilibrium
        What is written.
    path : path
        ``.rom``: a reduced model; ``.lti``: a linear model; ``.h5``: one of these, or a trajectory. They are read by
        `load` and `Trajectory.load`. ``.vtkhdf``, for ParaView: the nodes and the surface of all of these, and of a
        body or an equilibrium; with displacement, velocity of a trajectory, stress and pressure of the others. A name
        without an ending is allowed for reduced models and trajectories.

    Raises
    ------
    InputError
        The object is of another kind, the name ends in another way, or its file could not be read back: a custom
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
    if isinstance(model, Trajectory | Equilibrium):
        model.save(path)
    elif not isinstance(cast(object, model), Model):
        raise InputError(
            f"model must be a body, a reduced model, a Trajectory or an Equilibrium, got {brief(model)}; save those"
        )
    elif isinstance(model, ReducedModel | LinearModel):
        _save_model(model, path)
    else:
        check_ending(path, BODY_ENDINGS, "path of a body", required=True)
        model.write_surface(Path(path))


def _save_model(model: ReducedModel | LinearModel, path: str | Path) -> None:
    if isinstance(model, ReducedModel):
        ending = check_ending(path, REDUCED_ENDINGS, "path of a reduced model")
    else:
        ending = check_ending(path, LINEAR_ENDINGS, "path of a linear model")
    if ending in BODY_ENDINGS:
        model.write_surface(Path(path))
    elif isinstance(model, ReducedModel):
        save_hyper_reduced(model, path)
    else:
        linear_storage.save_linear(model, path)


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
    check_ending(path, MODEL_ENDINGS, "path of a reduced model")
    path = Path(path)
    kind = kind_of_file(path)
    if kind == TRAJECTORY_FORMAT:
        raise FileFormatError(f"path must be of a reduced model, got {path}, a trajectory; use Trajectory.load")
    if system is None:
        if kind == linear_storage.FORMAT:
            raise FileFormatError(
                f"system must be given for the linear model {path}; pass the LinearSystem it was made of"
            )
        return load_hyper_reduced(path)
    if kind == model_file.FORMAT:
        raise FileFormatError(f"system must not be given for the reduced model {path}; leave it out")
    return linear_storage.read_linear(path, system)
