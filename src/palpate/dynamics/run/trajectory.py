"""Trajectories of runs, in memory and in HDF5 files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, number_in_range
from palpate.core.files import check_ending, regular_file
from palpate.core.plotting import curve_svg, plot_curves
from palpate.core.sealed import Array, check_arrays, loading, open_sealed, write_sealed
from palpate.core.vtk import pyvista_grid, write_vtkhdf
from palpate.dynamics.run.journal import is_journal, read_record, records
from palpate.dynamics.run.series import (
    EVERY_RUN,
    FIELD_NAMES,
    GROUP_ARRAYS,
    LIST_ARRAYS,
    MAX_DISPLACEMENT,
    NUMBER_NAMES,
    OPTIONAL_NAMES,
    SERIES,
    array_name,
    joined_records,
)

FORMAT, VERSION = "palpate trajectory", 4
TRAJECTORY_REMEDY = "run the simulation again"
JOURNAL_ENDINGS = {".h5": "the trajectory"}  # of files that are written during a run
TRAJECTORY_ENDINGS = JOURNAL_ENDINGS | {".vtkhdf": "the deformed body at all times, for ParaView"}
POINTS_ARRAY = {"points": Array(("nodes", "space"), unit="m")}
MESH_ARRAYS = POINTS_ARRAY | {"triangles": Array(("surface triangles", 3), "<i8", index_of="nodes")}
HEADER_KEYS = ("model", "label", "wall_seconds", "stiffness_damping", "complete")


def _no_series() -> Floats:
    return np.zeros(0)


@dataclass(frozen=True, kw_only=True, repr=False)
class ToolContacts:
    """Contact of the tools of a run; the parameters are those of `Trajectory`."""

    moments: dict[str, Floats] = field(default_factory=dict)
    contact_forces: Floats = field(default_factory=lambda: np.zeros((0, 5)))
    bonded: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))


@dataclass(frozen=True, kw_only=True, repr=False)
class ErrorSeries:
    """Error indicator and bounds of the run of a reduced model; the parameters are those of `Trajectory`."""

    trust: Floats = field(default_factory=_no_series)
    displacement_bounds: Floats = field(default_factory=_no_series)
    force_bounds: Floats = field(default_factory=_no_series)


def check_trajectory_name(path: str | Path, what: str) -> None:
    """Refuse a name for the file of a run that ends as a file of another format."""
    check_ending(path, JOURNAL_ENDINGS, what)


@dataclass(frozen=True, kw_only=True, repr=False)
class BladeSeries:
    """Cut and energies of the run of a blade; the parameters are those of `Trajectory`."""

    cut_area: Floats = field(default_factory=_no_series)
    released_energy: Floats = field(default_factory=_no_series)
    edge_work: Floats = field(default_factory=_no_series)
    friction_work: Floats = field(default_factory=_no_series)
    release_rate: Floats = field(default_factory=_no_series)
    cuts: Floats = field(default_factory=lambda: np.zeros((0, 10)))


@dataclass(frozen=True)
class Trajectory(Described, ToolContacts, ErrorSeries, BladeSeries):
    """Snapshots, forces and energies of a run at f times.

    Parameters
    ----------
    model : str
        Name of the model.
    times : (f,) array [s]
    displacements, velocities : (f, n, 3) arrays [m], [m/s]
    reactions : mapping of group name to (f, 3) array [N]
        Force of every support and tool on the body. For a tool in contact, and in the energy form
        for a `Grasp`, it is the mean since the previous frame.
    kinetic, strain, external, dissipated : (f,) arrays [J]
        Energies; `external` is the work of loads and tools, `dissipated` the energy lost to
        damping, relaxation, friction and impact.
    steps : (f,) array
        Number of time steps since the start.
    points : (n, d) array [m]
        Reference positions.
    triangles : (t, 3) array
        Surface triangles; empty for a body without a surface.
    wall_seconds : float [s]
        Computing time of the run.
    stiffness_damping : float [s]
    complete : bool
        False for a run that stopped before its end.
    moments : mapping of tool name to (f, 3) array [N m]
        Mean moment on the body of every tool in contact since the previous frame, about the
        tool's origin.
    contact_forces : (c, 5) array
        Frame, node and mean force [N] since the previous frame, a row for every node in contact
        with tools or, in the energy form, bonded to a `Grasp`.
    bonded : (c,) bool array
        True for the rows of nodes bonded to a `Grasp`.
    label : str
        Label of the run, such as the campaign and the number in it.
    trust : (f,) array
        Error indicator of a reduced model (`palpate.ReducedModel.trust`): above 1 it was not trained on such
        states. Empty for other models.
    displacement_bounds, force_bounds : (f,) arrays [m], [N]
        Error bounds of the displacement, root mean square over the body, and of the tools' forces
        (`palpate.ReducedModel.error_bounds`); infinite where the error is unknown. Empty without them.
    cut_area, released_energy, edge_work, friction_work : (f,) arrays [m^2], [J]
        Totals of a blade since the start: the area that it has cut, the strain energy that the front has released,
        and the energies dissipated at its edge and by friction on its sides. Empty without a blade.
    release_rate : (f,) array [J/m^2]
        Energy that the front releases per area. Above the toughness, tissue would tear ahead of the blade. Empty
        without a blade.
    cuts : (c, 10) array
        Frame from which on the body is cut along a triangle, and its corners [m] in the stress-free body. Triangles
        of a later frame can overlap earlier ones. `palpate.cut` takes those up to a frame together.

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
    >>> len(full.times), full.complete
    (31, True)
    >>> bool(abs(full.balance).max() < 0.02 * full.external.max())
    True
    >>> path = Path(tempfile.mkdtemp()) / "run.h5"
    >>> full.save(path)
    >>> pt.Trajectory.load(path).reactions["x-"].shape
    (31, 3)
    """

    model: str
    times: Floats
    displacements: Floats
    velocities: Floats
    reactions: dict[str, Floats]
    kinetic: Floats
    strain: Floats
    external: Floats
    dissipated: Floats
    steps: Floats
    points: Floats
    wall_seconds: float = 0.0
    stiffness_damping: float = 0.0
    complete: bool = True
    label: str = field(default="", kw_only=True)
    triangles: Ints = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64), kw_only=True)

    def _facts(self) -> list[Fact]:
        frames, energy = len(self.times), self.kinetic + self.strain
        forces = {name: float(np.linalg.norm(each, axis=1).max(initial=0.0)) for name, each in self.reactions.items()}
        strongest = max(forces, key=forces.__getitem__, default="")
        missed = float(np.abs(self.balance).max() / energy.max()) if frames and energy.max() > 0 else None
        return [
            ("model", self.model, ""),
            ("label", self.label or None, ""),
            ("frames", frames, ""),
            ("nodes", len(self.points), ""),
            ("status", "complete" if self.complete else "stopped before its end", ""),
            ("end", float(self.times[-1]) if frames else None, "s"),
            ("largest displacement", float(self._largest().max(initial=0.0)), "m"),
            (f"largest force on {strongest!r}", forces.get(strongest), "N"),
            ("largest error indicator", float(self.trust.max()) if len(self.trust) else None, ""),
            ("energy balance missed by", None if missed is None else 100 * missed, "%"),
            ("steps", int(self.steps[-1]) if frames else None, ""),
            ("computing time", float(self.wall_seconds), "s"),
        ]

    def _largest(self) -> Floats:
        """Largest displacement [m] of a node at every time, (f,)."""
        return np.sqrt(np.array([np.einsum("nc,nc->n", u, u).max(initial=0.0) for u in self.displacements]))

    def _picture(self) -> str:
        return curve_svg(self.times, 1e3 * self._largest(), "time [s]", "largest displacement [mm]")

    def plot(self, what: str = "displacement", axes: Any = None) -> Any:
        """Plot the run over time.

        Parameters
        ----------
        what : str
            ``"displacement"``: the largest and the mean over the nodes [m]. ``"force"``: the size of the force of
            every support and tool [N]. Both with the error bound, where it is known. ``"energy"``: kinetic, strain,
            external and dissipated energy [J]. ``"trust"``: the error indicator of a reduced model.
        axes : matplotlib.axes.Axes, optional
            New ones by default.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        InputError
            Another quantity.
        ImportError
            matplotlib is not installed.
        """
        if what == "displacement":
            mean = np.array([np.linalg.norm(u, axis=1).mean() for u in self.displacements])
            curves = {"largest": self._largest(), "mean": mean} | _bound_curve(self.displacement_bounds)
            return plot_curves(self.times, curves, "displacement [m]", axes)
        if what == "force":
            forces = {name: np.linalg.norm(force, axis=1) for name, force in self.reactions.items()}
            return plot_curves(self.times, forces | _bound_curve(self.force_bounds), "force [N]", axes)
        if what == "energy":
            energies = {name: getattr(self, name) for name in NUMBER_NAMES if SERIES[name].array.unit == "J"}
            return plot_curves(self.times, energies, "energy [J]", axes)
        if what == "trust":
            if not len(self.trust):
                raise InputError("the run has no error indicator: its model is not a hyper-reduced one; plot another")
            curves = {"error indicator": self.trust, "limit of the training": np.ones_like(self.trust)}
            return plot_curves(self.times, curves, "error indicator", axes)
        raise InputError(
            f"what must be 'displacement', 'force', 'energy' or 'trust', got {what!r:.60}; choose one of them"
        )

    @property
    def balance(self) -> Floats:
        """Energy error since the start [J], (f,): kinetic + strain + dissipated - external."""
        total = self.kinetic + self.strain + self.dissipated - self.external
        return np.asarray(total - total[0])

    def concatenate(self, other: Trajectory) -> Trajectory:
        """Return this run joined with a run that continues from its last frame.

        Raises
        ------
        InputError
            The other run does not start at the end of this one, or its body, supports or tools
            differ.
        """
        one_body = self.points.shape == other.points.shape and np.allclose(self.points, other.points)
        one_body = one_body and self.reactions.keys() == other.reactions.keys()
        if not one_body or not np.isclose(self.times[-1], other.times[0], rtol=1e-9):
            raise InputError(
                f"other must start at {self.times[-1]:g} s with the same body, supports and tools, "
                f"got a run from {other.times[0]:g} s; continue the run from its last state"
            )
        joined: dict[str, Any] = {}
        for name, each in SERIES.items():
            first, second = getattr(self, name), getattr(other, name)
            if each.exists == EVERY_RUN:
                since = first[-1] - second[0] if each.is_total else 0.0
                joined[name] = np.concatenate([first, second[1:] + since])
            else:
                both = len(first) == len(self.times) and len(second) == len(other.times)
                joined[name] = np.concatenate([first, second[1:]]) if both else np.zeros(0)
        for name in GROUP_ARRAYS:
            first, second = getattr(self, name), getattr(other, name)
            joined[name] = {key: np.concatenate([values, second[key][1:]]) for key, values in first.items()}
        after = other.contact_forces[:, 0] > 0
        later = other.contact_forces[after] + np.array([len(self.times) - 1.0, 0, 0, 0, 0])
        joined["contact_forces"] = np.concatenate([self.contact_forces, later])
        joined["bonded"] = np.concatenate([self.bonded, other.bonded[after]])
        further = other.cuts[other.cuts[:, 0] > 0] + np.array([len(self.times) - 1.0, *np.zeros(9)])
        joined["cuts"] = np.concatenate([self.cuts, further])
        seconds, complete = self.wall_seconds + other.wall_seconds, self.complete and other.complete
        return replace(self, **joined, wall_seconds=seconds, complete=complete)

    def to_pyvista(self, time: float | None = None) -> Any:
        """Return the body at the frame nearest to a time as a mesh of pyvista.

        Parameters
        ----------
        time : float, optional [s]
            By default that of the last frame.

        Returns
        -------
        pyvista.UnstructuredGrid
            Nodes in their reference positions, the triangles of the surface, and a vertex for every other node. Point
            data: ``displacement`` [m] and ``velocity`` [m/s]. `palpate.typing.Model.to_pyvista` adds the stress.

        Raises
        ------
        InputError
            The trajectory has no frames, the time is not a number, or pyvista is not installed.
        """
        if not len(self.times):
            raise InputError("trajectory must have frames to be drawn, got none; run it again")
        frame = -1 if time is None else int(np.abs(self.times - number_in_range("time", time, unit="s")).argmin())
        fields = {"displacement": self.displacements[frame], "velocity": self.velocities[frame]}
        return pyvista_grid(self.points, self.triangles, fields)

    def save(self, path: str | Path) -> None:
        """Write the trajectory to a file, completely or not at all.

        Parameters
        ----------
        path : path
            ``.h5``, the file of `load`: sealed HDF5 (`palpate.core.sealed`). ``.vtkhdf``, for ParaView: displacement
            and velocity at all times.

        Raises
        ------
        InputError
            An array has values that are not finite, or the name ends in another way.
        OSError
            The file cannot be written; an existing file is unchanged.
        """
        if check_ending(path, TRAJECTORY_ENDINGS, "path of a trajectory") == ".vtkhdf":
            fields = {"displacement": self.displacements, "velocity": self.velocities}
            write_vtkhdf(path, self.points, self.triangles, self.times, fields)
            return
        arrays: dict[str, Any] = {name: getattr(self, name) for name in (*NUMBER_NAMES, *MESH_ARRAYS, *LIST_ARRAYS)}
        arrays |= {array_name(name, key): force for name in GROUP_ARRAYS for key, force in getattr(self, name).items()}
        rows = {name: getattr(self, name) for name in FIELD_NAMES}
        if not len(self.times):
            arrays, rows = arrays | rows, {}
        for name, values in (arrays | rows).items():
            if not np.isfinite(values).all():
                raise InputError(f"{name} is not finite: {path} was not written")
        arrays |= {name: getattr(self, name) for name in OPTIONAL_NAMES}
        header = {name: getattr(self, name) for name in HEADER_KEYS}
        header |= {name: float(header[name]) for name in ("wall_seconds", "stiffness_damping")}
        write_sealed(Path(path), FORMAT, VERSION, header | {name: list(getattr(self, name)) for name in GROUP_ARRAYS},
                     arrays, rows)  # fmt: skip

    @staticmethod
    def load(path: str | Path) -> Trajectory:
        """Read a trajectory.

        The file of an interrupted run yields its complete frames, with `complete` False.

        Raises
        ------
        FileNotFoundError
            The file does not exist.
        FileFormatError
            The file is truncated, damaged, or not a trajectory.
        """
        path = Path(path)
        with loading(path, TRAJECTORY_REMEDY):
            regular_file(path, "trajectory")
            if is_journal(path):
                return _from_journal(path)
            file = open_sealed(path, FORMAT, VERSION)
            data = {name: file.read(name) for name in file.arrays}
            _check(file.header, data)
            return from_arrays(file.header, data)


def _from_journal(path: Path) -> Trajectory:
    """Return the trajectory of the complete records of a journal."""
    journal_records = [record for _, _, record in records(path)]
    (about, first), frames = journal_records[0], journal_records[1:]
    names = {name: check_names(name, about.get(name)) for name in GROUP_ARRAYS}
    data = joined_records([arrays for _, arrays in frames], names, len(first["points"])) | first
    header = about | {"wall_seconds": 0.0, "complete": False}
    _check(header, data)
    return from_arrays(header, data)


def _check(header: dict[str, Any], data: dict[str, Any]) -> None:
    """Refuse a header and arrays that are not those of a trajectory; add empty arrays that the file can lack."""
    if header.keys() != {*HEADER_KEYS, *GROUP_ARRAYS}:
        raise InputError(f"header must have {sorted({*HEADER_KEYS, *GROUP_ARRAYS})}, got {sorted(header)}")
    for name in ("model", "label"):
        if not isinstance(header[name], str):
            raise InputError(f"{name} must be text, got {header[name]!r:.60}")
    if not isinstance(header["complete"], bool):
        raise InputError(f"complete must be true or false, got {header['complete']!r:.60}")
    for name in ("wall_seconds", "stiffness_damping"):
        number_in_range(name, header[name], 0.0, unit="s")
    declared = {name: SERIES[name].array for name in (*NUMBER_NAMES, *FIELD_NAMES)} | LIST_ARRAYS | MESH_ARRAYS
    for what, each in GROUP_ARRAYS.items():
        declared |= {array_name(what, key): each for key in check_names(what, header[what])}
    data.setdefault("cuts", np.zeros((0, 10)))  # of files of runs without blades
    data.setdefault("triangles", np.zeros((0, 3), dtype=np.int64))  # of earlier files
    for name in OPTIONAL_NAMES:
        values = data.setdefault(name, np.zeros(0))
        declared[name] = SERIES[name].array if len(values) else Array((0,))
    check_arrays(data, declared, {"frames": len(data.get("times", ())), "nodes": len(data.get("points", ()))})
    if not len(data["points"]) or data["points"].shape[1] not in (2, 3):
        raise InputError(f"points must be at least one (n, 2) or (n, 3), got shape {data['points'].shape}")
    _check_contact_forces(data["contact_forces"], len(data["times"]), len(data["points"]))


def from_arrays(header: dict[str, Any], data: dict[str, Any]) -> Trajectory:
    """Return the trajectory of a header and arrays."""
    arrays = {name: data[name] for name in (*SERIES, *LIST_ARRAYS, *MESH_ARRAYS)}
    groups: dict[str, Any] = {name: {key: data[array_name(name, key)] for key in header[name]} for name in GROUP_ARRAYS}
    numbers: dict[str, Any] = {name: float(header[name]) for name in ("wall_seconds", "stiffness_damping")}
    return Trajectory(**arrays, **groups, **numbers, **{name: header[name] for name in ("model", "label", "complete")})


def _bound_curve(bounds: Floats) -> dict[str, Floats]:
    """Return the curve of error bounds where any are known."""
    return {"error bound": np.where(np.isfinite(bounds), bounds, np.nan)} if np.isfinite(bounds).any() else {}


def check_names(what: str, names: Any) -> list[str]:
    """Return the names of a list in a file; raise `InputError` unless they are unique texts."""
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or len({*names}) < len(names):
        raise InputError(f"{what} must be a list of names, got {names!r:.60}")
    return names


def _check_contact_forces(contact_forces: Floats, frames: int, nodes: int) -> None:
    which = contact_forces[:, :2]
    if not np.all((which >= 0) & (which < [frames, nodes]) & (which == np.floor(which))):
        raise InputError(f"contact_forces must have frames in 0..{frames - 1} and nodes in 0..{nodes - 1}")


class StoredTrajectory(Described):
    """A trajectory in a file, whose displacements are read frame by frame on demand.

    `points` are (n, d) [m], `times` and `steps` (f,) in s and without a unit. `displacements` supports indices and
    slices like the (f, n, 3) array [m]. Every frame is verified on reading. For `contact_forces` (c, 5) and `bonded`
    (c,) see `Trajectory`.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with loading(self.path, TRAJECTORY_REMEDY):
            regular_file(self.path, "trajectory")
            if is_journal(self.path):
                self._open_journal()
            else:
                self._open_sealed()

    def _facts(self) -> list[Fact]:
        return [
            ("file", self.path.name, ""),
            ("label", self.label or None, ""),
            ("frames", len(self.times), ""),
            ("nodes", len(self.points), ""),
            ("end", float(self.times[-1]) if len(self.times) else None, "s"),
            ("computing time", self.wall_seconds, "s"),
        ]

    def _open_sealed(self) -> None:
        file = open_sealed(self.path, FORMAT, VERSION)
        self.label = str(file.header.get("label", ""))
        self.wall_seconds = number_in_range("wall_seconds", file.header.get("wall_seconds", 0.0), 0.0, unit="s")
        declared = {name: SERIES[name].array for name in ("times", "steps")} | POINTS_ARRAY
        declared |= {name: LIST_ARRAYS[name] for name in ("contact_forces", "bonded")}
        data = {name: file.read(name) for name in declared}
        check_arrays(data, declared, {})
        self.points, self.times, self.steps, self.contact_forces, self.bonded = (
            data[name] for name in ("points", "times", "steps", "contact_forces", "bonded")
        )
        entry, expected = file.arrays["displacements"], (len(self.times), len(self.points), 3)
        if entry.shape != expected or entry.type not in ("<f8", "<f4") or not len(self.points):
            raise InputError(f"displacements must have shape {expected} of <f8, got {entry.shape} of {entry.type}")
        _check_contact_forces(self.contact_forces, len(self.times), len(self.points))
        self.displacements = Frames(self.path, entry.shape, lambda k: file.row("displacements", k))

    def _open_journal(self) -> None:
        run = _from_journal(self.path)
        positions = [(position, chain) for position, chain, _ in records(self.path)][1:]
        self.label, self.wall_seconds = run.label, run.wall_seconds
        self.points, self.times, self.steps = run.points, run.times, run.steps
        self.contact_forces, self.bonded = run.contact_forces, run.bonded

        def frame(k: int) -> Floats:
            return read_record(self.path, *positions[k])[1]["displacements"]

        self.displacements = Frames(self.path, run.displacements.shape, frame)


@dataclass(frozen=True)
class Frames:
    """The displacements of a stored trajectory."""

    path: Path
    shape: tuple[int, ...]  # (f, n, 3)
    read: Callable[[int], Floats]  # returns the (n, 3) array of a frame

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, which: int | slice) -> Floats:
        with loading(self.path, TRAJECTORY_REMEDY):
            if not isinstance(which, slice):
                return self._frame(range(len(self))[which])
            chosen = range(len(self))[which]
            return np.array([self._frame(k) for k in chosen]).reshape(len(chosen), *self.shape[1:])

    def _frame(self, k: int) -> Floats:
        frame = self.read(k)
        if not np.all(np.abs(frame) <= MAX_DISPLACEMENT):
            raise InputError(f"frame {k} of the displacements must be finite, at most {MAX_DISPLACEMENT:g} m")
        return frame
