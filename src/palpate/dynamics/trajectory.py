"""Trajectories: the states of a run at chosen times, in memory and in HDF5 files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.model import Outputs
from palpate.faults import FileFormatError, InputError

__all__ = ["Recorder", "StoredTrajectory", "Trajectory"]

Floats = NDArray[np.float64]

SPARE = 1 << 18  # bytes kept free for HDF5's own tables
FORMAT, VERSION = "palpate trajectory", 1
SERIES = ("times", "kinetic", "strain", "external", "dissipated", "steps")


@dataclass(frozen=True)
class Trajectory:
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
    viscosity : float [s]
    complete : bool
        False if the run stopped before its end.
    moments : mapping of tool name to (f, 3) array [N m]
        Moment about its origin, on the body, of every tool that touches it, the mean since the frame before.
    touches : (c, 5) array
        A row for every node that tools touched, or in the energy form a `Grasp` held: frame, node, and the mean force
        [N] of all of these on it since the frame before.
    held : (c,) bool array
        Which rows are of nodes that a `Grasp` held.
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
    viscosity: float = 0.0
    complete: bool = True
    moments: dict[str, Floats] = field(default_factory=dict)
    touches: Floats = field(default_factory=lambda: np.zeros((0, 5)))
    held: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

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
        after = other.touches[:, 0] > 0
        later = other.touches[after] + np.array([len(self.times) - 1.0, 0, 0, 0, 0])
        joined["touches"] = np.concatenate([self.touches, later])
        joined["held"] = np.concatenate([self.held, other.held[after]])
        seconds, complete = self.wall_seconds + other.wall_seconds, self.complete and other.complete
        return replace(self, **joined, wall_seconds=seconds, complete=complete)

    def save(self, path: str | Path) -> None:
        """Write to an HDF5 file, whole or not at all."""
        path = Path(path)
        partial = path.with_name(path.name + ".partial")
        recorder = Recorder(partial, self.model, self.points, self.viscosity)
        try:
            for k in range(len(self.times)):
                recorder.add(float(self.times[k]), int(self.steps[k]), self._outputs(k))
            recorder.close(self.wall_seconds, self.complete)
            os.replace(partial, path)
        except BaseException:
            recorder.discard()
            raise

    def _outputs(self, k: int) -> Outputs:
        energies = {name: float(getattr(self, name)[k]) for name in ("kinetic", "strain", "external", "dissipated")}
        forces = {name: force[k] for name, force in self.reactions.items()}
        moments = {name: moment[k] for name, moment in self.moments.items()}
        own = self.touches[:, 0] == k
        return Outputs(
            self.displacements[k], self.velocities[k], forces, **energies, moments=moments,
            touches=self.touches[own, 1:], held=self.held[own],
        )  # fmt: skip

    @staticmethod
    def load(path: str | Path) -> Trajectory:
        """Read a trajectory, complete or interrupted.

        Raises
        ------
        FileNotFoundError
            There is no such file.
        FileFormatError
            The file is truncated, corrupt, or not a trajectory.
        """
        with _opened(Path(path)) as file:
            frames = int(file.attrs["frames"])
            data: dict[str, Any] = {n: file[n][:frames] for n in (*SERIES, "displacements", "velocities")}
            data["reactions"] = {n: d[:frames] for n, d in file["reactions"].items()}
            data["moments"] = {n: d[:frames] for n, d in file.get("moments", {}).items()}
            data["touches"], data["held"] = _touches(file, frames)
            data["points"] = file["points"][:]
            for name in ("model", "wall_seconds", "viscosity", "complete"):
                data[name] = file.attrs[name]
        n = len(data["points"])
        shapes = dict.fromkeys(("displacements", "velocities"), (frames, n, 3)) | dict.fromkeys(SERIES, (frames,))
        arrays: dict[str, tuple[Any, tuple[int, ...]]] = {name: (data[name], shape) for name, shape in shapes.items()}
        arrays |= {f"reactions/{name}": (force, (frames, 3)) for name, force in data["reactions"].items()}
        arrays |= {f"moments/{name}": (moment, (frames, 3)) for name, moment in data["moments"].items()}
        arrays["touches"] = data["touches"], (len(data["touches"]), 5)
        arrays["held"] = data["held"], (len(data["touches"]),)
        arrays["points"] = data["points"], (n, data["points"].shape[-1])
        for name, (array, shape) in arrays.items():
            if array.shape != shape or not np.isfinite(array).all():
                raise FileFormatError(f"{path}: {name} is not finite or has shape {array.shape}, expected {shape}")
        data["complete"] = bool(data["complete"])
        return Trajectory(**data)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a trajectory's file to read; what goes wrong inside is said of the file."""
    import h5py

    if not path.is_file():
        raise FileNotFoundError(f"no trajectory file at {path}")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("version") != VERSION:
                raise FileFormatError(f"{path} is not a {FORMAT} of version {VERSION}")
            yield file
    except (OSError, KeyError, RuntimeError) as error:
        raise FileFormatError(f"{path} is truncated or corrupt ({error}); run the simulation again") from error


def _touches(file: Any, frames: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Read touches and which are held; in files of before forceps had forces on nodes, none is."""
    touches = file["touches"][:] if "touches" in file else np.zeros((0, 5))
    held = file["held"][: len(touches)] if "held" in file else np.zeros(len(touches), dtype=np.bool_)
    whole = touches[:, 0] < frames
    return np.asarray(touches[whole]), np.asarray(held[whole[: len(held)]], dtype=np.bool_)


class StoredTrajectory:
    """A trajectory that stays in its file: frames of its displacements are read when they are asked for.

    Parameters
    ----------
    path : path

    Attributes
    ----------
    path : path
    points : (n, d) array [m]
    times : (f,) array [s]
    displacements : Frames
        Takes a number or a slice, as the (f, n, 3) array [m] would.
    touches, held : (c, 5) and (c,) arrays
        As of `Trajectory`.

    Raises
    ------
    FileNotFoundError, FileFormatError
        As `Trajectory.load`; of a frame that cannot be read, when it is asked for.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with _opened(self.path) as file:
            frames = int(file.attrs["frames"])
            self.points, self.times = file["points"][:], file["times"][:frames]
            shape, (self.touches, self.held) = file["displacements"].shape[1:], _touches(file, frames)
        if shape != (len(self.points), 3) or len(self.times) != frames:
            raise FileFormatError(f"{self.path}: {frames} displacements of shape {shape}, {len(self.points)} points")
        self.displacements = Frames(self.path, (frames, *shape))


@dataclass(frozen=True)
class Frames:
    """The displacements of a stored trajectory.

    Parameters
    ----------
    path : path
    shape : tuple
        (f, n, 3).
    """

    path: Path
    shape: tuple[int, ...]

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, which: int | slice) -> Floats:
        with _opened(self.path) as file:
            return np.asarray(file["displacements"][which])


@dataclass
class Recorder:
    """Collects the frames of a run and streams them to an HDF5 file when it has a path.

    Every frame is flushed, so that whatever stops the run, the file holds the frames until then.

    Raises
    ------
    OSError
        The file cannot be created or the disk is full; names the file.
    """

    path: Path | None
    model: str
    points: Floats
    viscosity: float
    times: list[float] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    frames: list[Outputs] = field(default_factory=list)
    _file: Any = None

    def __post_init__(self) -> None:
        if self.path is None:
            return
        import h5py

        try:
            self._file = h5py.File(self.path, "w")
            self._file["points"] = self.points
            self._file.attrs.update(
                format=FORMAT, version=VERSION, model=self.model, frames=0, viscosity=self.viscosity, complete=False,
                wall_seconds=0.0,
            )  # fmt: skip
        except OSError as error:
            raise OSError(f"cannot write {self.path}: {error}; choose another folder or free some space") from error

    def add(self, time: float, steps: int, frame: Outputs) -> None:
        """Keep a frame."""
        self.times.append(time)
        self.steps.append(steps)
        self.frames.append(frame)
        if self._file is None:
            return
        values = {
            "times": time, "steps": steps, "kinetic": frame.kinetic, "strain": frame.strain,
            "external": frame.external, "dissipated": frame.dissipated, "displacements": frame.displacements,
            "velocities": frame.velocities, **{f"reactions/{name}": f for name, f in frame.reactions.items()},
            **{f"moments/{name}": m for name, m in frame.moments.items()},
        }  # fmt: skip
        needed = sum(np.asarray(value).nbytes for value in values.values())
        free = shutil.disk_usage(Path(self.path or ".").absolute().parent).free
        if free < 2 * needed + SPARE:  # HDF5 does not survive a failed write
            raise OSError(
                f"cannot write {self.path}: the disk is full ({free / 1e6:.1f} MB left); earlier frames are kept"
            )
        try:
            self._file.require_group("reactions")
            for name, value in values.items():
                array = np.asarray(value, dtype=float)
                if name not in self._file:
                    chunks = (1, *array.shape) if array.ndim == 2 else True  # so that a frame lies in one piece
                    self._file.create_dataset(
                        name, (0, *array.shape), maxshape=(None, *array.shape), dtype="f8", chunks=chunks
                    )
                self._file[name].resize(len(self.times), axis=0)
                self._file[name][-1] = array
            self._add_touches(frame.touches, frame.held)
            self._file.attrs["frames"] = len(self.times)
            self._file.flush()
        except OSError as error:
            raise OSError(f"cannot write {self.path}: {error}; its earlier frames are kept") from error

    def _add_touches(self, touches: Floats, held: NDArray[np.bool_]) -> None:
        if not len(touches):
            return
        if "touches" not in self._file:
            self._file.create_dataset("touches", (0, 5), maxshape=(None, 5), dtype="f8")
            self._file.create_dataset("held", (0,), maxshape=(None,), dtype="?")
        frame = np.full(len(touches), float(len(self.times) - 1))
        for name, added in (("held", held), ("touches", np.column_stack([frame, touches]))):
            rows = self._file[name]
            rows.resize(len(rows) + len(added), axis=0)
            rows[-len(added) :] = added

    def close(self, wall_seconds: float, complete: bool) -> None:
        """Finish the file."""
        if self._file is not None:
            self._file.attrs.update(wall_seconds=wall_seconds, complete=complete)
            self._file.close()
            self._file = None

    def discard(self) -> None:
        """Drop the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
        if self.path is not None:
            self.path.unlink(missing_ok=True)

    def trajectory(self, wall_seconds: float, complete: bool) -> Trajectory:
        """Return what was collected."""
        kept = [f.name for f in fields(Outputs) if f.name not in ("reactions", "moments", "touches", "held")]
        series = {name: np.array([getattr(o, name) for o in self.frames]) for name in kept}
        names = self.frames[0].reactions if self.frames else {}
        touching = self.frames[0].moments if self.frames else {}
        return Trajectory(
            model=self.model, times=np.array(self.times), steps=np.array(self.steps, dtype=float), points=self.points,
            reactions={name: np.array([o.reactions[name] for o in self.frames]) for name in names},
            moments={name: np.array([o.moments[name] for o in self.frames]) for name in touching},
            touches=np.concatenate(
                [np.zeros((0, 5)), *(np.insert(o.touches, 0, k, axis=1) for k, o in enumerate(self.frames))]
            ),
            held=np.concatenate([np.zeros(0, dtype=np.bool_), *(o.held for o in self.frames)]),
            wall_seconds=wall_seconds, viscosity=self.viscosity, complete=complete, **series,
        )  # fmt: skip
