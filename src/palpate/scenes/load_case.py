"""Bodies with what happens to them: the loads of a single run, or those of paths by seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.model import Solid

CAMPAIGN_SEEDS = 1_000_000  # seeds of a campaign of `palpate train`
TRAINING_SEEDS = 500_000  # the first of these, for training; the others are for held-out runs


@dataclass(frozen=True)
class LoadCase:
    """Body with loads for `palpate.rollout`."""

    model: NodalModel
    loads: tuple[Load, ...]
    # duration, every: float [s]: length of the run, and time between snapshots
    duration: float
    every: float
    title: str
    parameters: Mapping[str, float | str]  # with which it was made, in SI units
    displacement: Floats | None = None  # (n, 3) array, optional [m]: displacements at the start; zero by default


@dataclass(frozen=True)
class TrainingScene(Described):
    """Body with random tool paths for a training campaign.

    Equal parameters give equal bodies, and equal seeds equal paths, in every process.

    Parameters
    ----------
    model : Solid or Membrane
    path : function
        Function of a seed, an integer from 0, that returns the loads of a run and its duration [s].
        Of the seeds of a campaign, `CAMPAIGN_SEEDS`, the first `TRAINING_SEEDS` are for training.
    every : float [s]
        Time between snapshots.
    title : str
    parameters : mapping of str to number or text
        Parameters of the scene, in SI units.
    tools : tuple of str
        Groups that rigid tools hold and move (`palpate.PrescribedMotion`), as `prescribed` of
        `palpate.hyper_reduce`.
    coarse : function, optional
        Returns a coarser model of the same body, as `coarse` of `palpate.hyper_reduce`, for tools that
        may touch a large body anywhere. By default its surface is filled again.
    cubature : float, optional
        Largest relative error of the sampled forces, as for `palpate.hyper_reduce`.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> scene = pt.TrainingScene(
    ...     bar, path=lambda seed: ((pull,), 0.03), every=0.001, title="Bar", parameters={"spacing": 0.005}
    ... )
    >>> loads, duration = scene.path(0)
    >>> duration
    0.03
    """

    model: Solid | Membrane
    path: Callable[[int], tuple[tuple[Load, ...], float]]
    every: float
    title: str
    parameters: Mapping[str, float | int | str]
    tools: tuple[str, ...] = ()
    coarse: Callable[[], Solid] | None = None
    cubature: float | None = None

    def _facts(self) -> list[Fact]:
        return [
            ("title", self.title, ""),
            ("nodes", len(self.model.cloud), ""),
            ("tools", list(self.tools), ""),
            ("every", self.every, "s"),
            ("cubature", self.cubature, ""),
            ("parameters", self.parameters, ""),
        ]
