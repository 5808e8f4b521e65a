"""Trajectories: the states of a run at chosen times, in memory and in HDF5 files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.dynamics.run.journal import is_journal, read_record, records
from palpate.faults import InputError, number_in_range
from palpate.files import regular_file
from palpate.plotting import curve_svg, plot_curves
from palpate.sealed import loading, open_sealed, write_sealed

__all__ = ["NAMED", "ROWS", "SERIES", "StoredTrajectory", "Trajectory", "stack"]


FORMAT, VERSION = "palpate trajectory", 3
REMEDY = "run the simulation again"
FARTHEST = 1e30  # [m] of a displacement, so that sums of squares are finite
SERIES = ("times", "kinetic", "strain", "external", "dissipated", "steps")
ROWS = ("displacements", "velocities")  # stored frame by frame
NAMED = ("reactions", "moments")  # (f, 3) arrays by name
HEADER = ("model", "label", "wall_seconds", "stiffness_damping", "complete")


@dataclass(frozen=True)
class Trajectory(Described):
    """What a run leaves: the snapshots, forces and energies at f times.

    Parameters
    ----------
    model : str
        Name of the model.
    times : (f,) array [s]
    displacements, velocities : (f, n, 3) arrays [m], [m/s]
    reactions : mapping of group name to (f, 3) array [N]
        Force of every support and tool on the body; of a tool that touches it, and in the energy form of a `Grasp`,
        the mean since the frame before.
    kinetic, strain, external, dissipated : (f,) arrays [J]
        Energies; `external` is the work of loads and tools, `dissipated` what viscosity took.
    steps : (f,) array
        Time steps taken until then.
    points : (n, d) array [m]
        Reference positions.
    wall_seconds : float [s]
        Computing time of the run.
    stiffness_damping : float [s]
    complete : bool
        False if the run stopped before its end.
    moments : mapping of tool name to (f, 3) array [N m]
        Moment about its origin, on the body, of every tool that touches it, the mean since the frame before.
    contact_forces : (c, 5) array
        A row for every node that tools touched, or in the energy form a `Grasp` held: frame, node, and the mean force
        [N] of all of these on it since the frame before.
    bonded : (c,) bool array
        Which rows are of nodes that a `Grasp` held.
    label : str
        What distinguishes the run from others, such as the campaign and the number in it.
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
    moments: dict[str, Floats] = field(default_factory=dict)
    contact_forces: Floats = field(default_factory=lambda: np.zeros((0, 5)))
    bonded: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    label: str = ""

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
            ("verdict", "complete" if self.complete else "stopped before its end", ""),
            ("end", float(self.times[-1]) if frames else None, "s"),
            ("largest displacement", float(self._largest().max(initial=0.0)), "m"),
            (f"largest force on {strongest!r}", forces.get(strongest), "N"),
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
            every support and tool [N]. ``"energy"``: kinetic, strain, external and dissipated energy [J].
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
            return plot_curves(self.times, {"largest": self._largest(), "mean": mean}, "displacement [m]", axes)
        if what == "force":
            forces = {name: np.linalg.norm(force, axis=1) for name, force in self.reactions.items()}
            return plot_curves(self.times, forces, "force [N]", axes)
        if what == "energy":
            energies = {name: getattr(self, name) for name in ("kinetic", "strain", "external", "dissipated")}
            return plot_curves(self.times, energies, "energy [J]", axes)
        raise InputError(f"what must be 'displacement', 'force' or 'energy', got {what!r:.60}; choose one of them")

    @property
    def balance(self) -> Floats:
        """Kinetic + strain + dissipated - external energy since the start [J], (f,): what the balance misses."""
        total = self.kinetic + self.strain + self.dissipated - self.external
        return np.asarray(total - total[0])

    def then(self, other: Trajectory) -> Trajectory:
        """Return this run with another one that went on from its last frame.

        Raises
        ------
        InputError
            The other run does not start at this one's end, or has another body or other supports and tools.
        """
        one_body = self.points.shape == other.points.shape and np.allclose(self.points, other.points)
        one_body = one_body and self.reactions.keys() == other.reactions.keys()
        if not one_body or not np.isclose(self.times[-1], other.times[0], rtol=1e-9):
            raise InputError(
                f"a run that ends at {self.times[-1]:g} s cannot be followed by one that starts at "
                f"{other.times[0]:g} s, nor by one of another body or with other supports and tools"
            )
        joined: dict[str, Any] = {}
        for name in (*SERIES, "displacements", "velocities"):
            first, second = getattr(self, name), getattr(other, name)
            since = first[-1] - second[0] if name in ("external", "dissipated", "steps") else 0.0
            joined[name] = np.concatenate([first, second[1:] + since])
        for name in ("reactions", "moments"):
            first, second = getattr(self, name), getattr(other, name)
            joined[name] = {of: np.concatenate([values, second[of][1:]]) for of, values in first.items()}
        after = other.contact_forces[:, 0] > 0
        later = other.contact_forces[after] + np.array([len(self.times) - 1.0, 0, 0, 0, 0])
        joined["contact_forces"] = np.concatenate([self.contact_forces, later])
        joined["bonded"] = np.concatenate([self.bonded, other.bonded[after]])
        seconds, complete = self.wall_seconds + other.wall_seconds, self.complete and other.complete
        return replace(self, **joined, wall_seconds=seconds, complete=complete)

    def save(self, path: str | Path) -> None:
        """Write to a sealed HDF5 file (`palpate.sealed`), whole or not at all.

        Raises
        ------
        InputError
            Values that are not finite.
        OSError
            The file cannot be written; a file that was there is unchanged.
        """
        arrays: dict[str, Any] = {name: getattr(self, name) for name in (*SERIES, "points", "contact_forces", "bonded")}
        arrays |= {_key(name, of): force for name in NAMED for of, force in getattr(self, name).items()}
        rows = {name: getattr(self, name) for name in ROWS}
        if not len(self.times):
            arrays, rows = arrays | rows, {}
        for name, values in (arrays | rows).items():
            if not np.isfinite(values).all():
                raise InputError(f"{name} is not finite: {path} was not written")
        header = {name: getattr(self, name) for name in HEADER}
        header |= {name: float(header[name]) for name in ("wall_seconds", "stiffness_damping")}
        write_sealed(Path(path), FORMAT, VERSION, header | {name: list(getattr(self, name)) for name in NAMED},
                     arrays, rows)  # fmt: skip

    @staticmethod
    def load(path: str | Path) -> Trajectory:
        """Read a trajectory.

        The file of a run that was cut off gives the frames that are whole, with `complete` False: the last of `times`
        is the time up to which the file is whole.

        Raises
        ------
        FileNotFoundError
            There is no such file.
        FileFormatError
            The file is truncated, damaged, or not a trajectory.
        """
        path = Path(path)
        with loading(path, REMEDY):
            regular_file(path, "trajectory")
            if is_journal(path):
                return _from_journal(path)
            file = open_sealed(path, FORMAT, VERSION)
            return _checked(file.header, {name: file.read(name) for name in file.arrays})


def _from_journal(path: Path) -> Trajectory:
    found = [record for _, _, record in records(path)]
    (about, first), frames = found[0], found[1:]
    points, names = first["points"], {name: check_names(name, about.get(name)) for name in NAMED}
    numbers = stack([arrays["numbers"] for _, arrays in frames], (len(SERIES),))
    data = {name: numbers[:, k] for k, name in enumerate(SERIES)} | {"points": points}
    data |= {name: stack([arrays[name] for _, arrays in frames], (*points.shape[:1], 3)) for name in ROWS}
    for name, each in names.items():
        forces = stack([arrays[name] for _, arrays in frames], (len(each), 3))
        data |= {_key(name, of): forces[:, k] for k, of in enumerate(each)}
    numbered = [np.insert(arrays["contact_forces"], 0, k, axis=1) for k, (_, arrays) in enumerate(frames)]
    data["contact_forces"] = np.concatenate([np.zeros((0, 5)), *numbered])
    data["bonded"] = np.concatenate([np.zeros(0, dtype=np.bool_), *(arrays["bonded"] for _, arrays in frames)])
    return _checked(about | names | {"wall_seconds": 0.0, "complete": False}, data)


def stack(values: list[Any], shape: tuple[int, ...]) -> Floats:
    """Return equal arrays as one; of no frames, too."""
    return np.stack(values) if values else np.zeros((0, *shape))


def _checked(header: dict[str, Any], data: dict[str, Any]) -> Trajectory:
    """Return a trajectory of what a file holds; refuse what no run leaves.

    Raises
    ------
    InputError
        A value is missing, not finite, or of another type, shape or range.
    """
    if header.keys() != {*HEADER, *NAMED}:
        raise InputError(f"the header has {sorted(header)}, expected {sorted({*HEADER, *NAMED})}")
    for name in ("model", "label"):
        if not isinstance(header[name], str):
            raise InputError(f"{name} must be text, got {header[name]!r:.60}")
    if not isinstance(header["complete"], bool):
        raise InputError(f"complete must be true or false, got {header['complete']!r:.60}")
    numbers: dict[str, Any] = {
        name: number_in_range(name, header[name], 0.0, unit="s") for name in ("wall_seconds", "stiffness_damping")
    }
    names = {name: check_names(name, header[name]) for name in NAMED}
    frames, n = len(data["times"]), len(data["points"])
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(ROWS, (frames, n, 3)) | dict.fromkeys(SERIES, (frames,))
    shapes |= {_key(name, of): (frames, 3) for name, each in names.items() for of in each}
    contact_forces = len(data.get("contact_forces", ()))
    shapes |= {
        "contact_forces": (contact_forces, 5),
        "bonded": (contact_forces,),
        "points": (n, 2 if data["points"].shape[-1:] == (2,) else 3),
    }
    if data.keys() != shapes.keys():
        raise InputError(f"the arrays are {', '.join(sorted(data))}; expected {', '.join(sorted(shapes))}")
    for name, shape in shapes.items():
        wanted = np.bool_ if name == "bonded" else np.float64
        if data[name].shape != shape or data[name].dtype != wanted or not np.isfinite(data[name]).all():
            raise InputError(f"{name} is not finite, or has shape {data[name].shape}, expected {shape}")
    if np.abs(data["displacements"]).max(initial=0.0) > FARTHEST:
        raise InputError(f"displacements go beyond {FARTHEST:g} m, which no run does")
    if not n or np.any(np.diff(data["times"]) < 0) or np.any(np.diff(data["steps"]) < 0):
        raise InputError("times and steps must not decrease, and there must be points")
    _check_contact_forces(data["contact_forces"], frames, n)
    forces: dict[str, Any] = {name: {of: data[_key(name, of)] for of in each} for name, each in names.items()}
    arrays = {name: data[name] for name in (*SERIES, *ROWS, "points", "contact_forces", "bonded")}
    return Trajectory(**arrays, **forces, **numbers, **{name: header[name] for name in ("model", "label", "complete")})


def check_names(what: str, names: Any) -> list[str]:
    """Return names that a file lists, each once."""
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or len({*names}) < len(names):
        raise InputError(f"{what} must be a list of names, got {names!r:.60}")
    return names


def _key(what: str, of: str) -> str:
    """Return the name of an array of a group or tool, in which HDF5 finds neither a path nor an end."""
    if of in ("", ".", ".."):
        return f"{what}/%{of}"
    return f"{what}/{of.replace('%', '%25').replace('/', '%2F').replace(chr(0), '%00')}"


def _check_contact_forces(contact_forces: Floats, frames: int, nodes: int) -> None:
    which = contact_forces[:, :2]
    if not np.all((which >= 0) & (which < [frames, nodes]) & (which == np.floor(which))):
        raise InputError(f"contact_forces names a frame outside 0..{frames - 1} or a node outside 0..{nodes - 1}")


class StoredTrajectory(Described):
    """A trajectory that stays in its file: frames of its displacements are read when they are asked for.

    Parameters
    ----------
    path : path

    Attributes
    ----------
    path : path
    label : str
    wall_seconds : float [s]
    points : (n, d) array [m]
    times, steps : (f,) arrays [s], [-]
    displacements : Frames
        Takes a number or a slice, as the (f, n, 3) array [m] would. Every frame is verified when it is read.
    contact_forces, bonded : (c, 5) and (c,) arrays
        As of `Trajectory`.

    Raises
    ------
    FileNotFoundError, FileFormatError
        As `Trajectory.load`; of a frame that cannot be read, when it is asked for.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with loading(self.path, REMEDY):
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
        self.points, self.times, self.steps = map(file.read, ("points", "times", "steps"))
        self.contact_forces, self.bonded = map(file.read, ("contact_forces", "bonded"))
        shape, wanted = file.arrays["displacements"].shape, (len(self.times), len(self.points), 3)
        if shape != wanted or not len(self.points) or self.contact_forces.shape != (len(self.bonded), 5):
            raise InputError(f"displacements have shape {shape}, expected {wanted}; or contact_forces do not fit")
        if self.points.ndim != 2 or self.times.ndim != 1 or self.steps.shape != self.times.shape:
            raise InputError("points, times and steps do not fit together")
        if file.arrays["displacements"].type not in ("<f8", "<f4") or np.any(np.diff(self.times) < 0):
            raise InputError("displacements must be of type <f8 or <f4, and times must not decrease")
        if not all(np.isfinite(each).all() for each in (self.points, self.times, self.steps, self.contact_forces)):
            raise InputError("points, times, steps or contact_forces are not finite")
        _check_contact_forces(self.contact_forces, len(self.times), len(self.points))
        self.displacements = Frames(self.path, shape, lambda k: file.row("displacements", k))

    def _open_journal(self) -> None:
        run = _from_journal(self.path)
        places = [(place, chain) for place, chain, _ in records(self.path)][1:]
        self.label, self.wall_seconds = run.label, run.wall_seconds
        self.points, self.times, self.steps = run.points, run.times, run.steps
        self.contact_forces, self.bonded = run.contact_forces, run.bonded

        def frame(k: int) -> Floats:
            return read_record(self.path, *places[k])[1]["displacements"]

        self.displacements = Frames(self.path, run.displacements.shape, frame)


@dataclass(frozen=True)
class Frames:
    """The displacements of a stored trajectory.

    Parameters
    ----------
    path : path
    shape : tuple
        (f, n, 3).
    read : function
        Returns the (n, 3) array of a frame.
    """

    path: Path
    shape: tuple[int, ...]
    read: Callable[[int], Floats]

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, which: int | slice) -> Floats:
        with loading(self.path, REMEDY):
            if not isinstance(which, slice):
                return self._frame(range(len(self))[which])
            chosen = range(len(self))[which]
            return np.array([self._frame(k) for k in chosen]).reshape(len(chosen), *self.shape[1:])

    def _frame(self, k: int) -> Floats:
        frame = self.read(k)
        if not np.all(np.abs(frame) <= FARTHEST):
            raise InputError(f"frame {k} of the displacements is not finite, or goes beyond {FARTHEST:g} m")
        return frame
