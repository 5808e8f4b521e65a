"""A session: a body in real time, the tool in a hand, and what is done with both. It knows no server and no page."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.view.hand import UNTURNED, Held, Outside, forceps, shape, turned
from palpate.app.view.messages import Message
from palpate.app.view.recording import Recorder, Recording, save_recording
from palpate.app.view.snapshot import Snapshot, told_scalars, told_training
from palpate.dynamics.contact.tools import Contact, Forceps, Sphere, Tool
from palpate.faults import InputError
from palpate.realtime.engine import Engine
from palpate.realtime.row import Reading
from palpate.realtime.watched import Seen, watched
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.realtime.change_tool import change_tool
from palpate.reduction.realtime.display_surface import Surface
from palpate.reduction.realtime.model import realtime_model

__all__ = ["Session"]

Floats = NDArray[np.float64]

RATE = 1000.0  # [Hz]
MOST_SPEED = 0.5  # [m/s] of the tool
TRIES = 1000  # to read the engine's row and the model's of one period
ASLEEP = 3.0  # [s] without a tick: the machine slept
NOTHING = Held("none", None)
MODULUS = "shear modulus"
SOFTEST, FIRMEST = 0.25, 4.0  # of the model's moduli


class Session:
    """A reduced model in an `Engine`, with the tool that a hand holds.

    Messages come from one thread at a time; `snapshot` may be asked from any.

    Parameters
    ----------
    model : ReducedModel
        One that tools touch, or that holds one group.
    title : str
    rate : float [Hz]

    Raises
    ------
    InputError
        The model takes no tool.
    """

    mode = "live"

    def __init__(self, model: ReducedModel, title: str, rate: float = RATE) -> None:
        self.model, self.title, self.rate = model, title, rate
        self.surface = Surface(model)
        self._outside = Outside(self.surface)
        self.touched = not model.data.prescribed and model.data.compliance is not None
        far = Contact(Sphere(model.cloud.spacing), model.cloud.points.max(axis=0) + 10.0) if self.touched else None
        self._ready = realtime_model(model, contact=far)
        self._home, self._turn = np.zeros(3), UNTURNED  # of the tool when it was put down
        self.held, self.chosen = NOTHING, NOTHING
        if self.touched:
            change_tool(self._ready, None, np.concatenate([np.zeros(3), UNTURNED]))
        else:
            group = model.cloud.points[model.cloud.group(model.data.prescribed[0])].mean(axis=0)
            self._home[: len(group)] = group
            self.held = self.chosen = Held("group", None)
        self._watched = watched(self._ready)
        self.engine = Engine(self._watched, rate, most_speed=MOST_SPEED)
        self.engine._warned = True  # every frame tells the trust number
        self.paused_because: str | None = None
        self.speed, self.modulus_ratio = 1.0, 1.0
        self.news: list[dict[str, Any]] = []  # what all who watch are still to be told
        self.folder = Path("out/view")  # of recordings
        self._recorder: Recorder | None = None
        self._path: Path | None = None  # of the recording that goes on, where it was chosen
        self._writers: list[threading.Thread] = []
        self._lock, self._beat = threading.RLock(), (time.time(), time.monotonic())

    # what it tells

    def snapshot(self) -> Snapshot:
        """Return what is known of the last period: the engine's row and the model's touched nodes, of one period."""
        with self._lock:
            row, seen = self._together()
            return Snapshot(
                time=row.time, steps=row.steps, force=row.force, moment=row.moment, stiffness=row.stiffness,
                trust=row.trust, position=self._home + seen.place, quaternion=turned(self._turn, row.quaternion),
                sequence=row.sequence, kinetic=row.kinetic, strain=row.strain, computing=row.computing,
                lateness=row.lateness, coordinates=seen.coordinates, state=row.state, hand=seen.hand, nodes=seen.nodes,
                forces=seen.forces, modulus_ratio=seen.modulus_ratio, tool=self.held.kind,
            )  # fmt: skip

    def _together(self) -> tuple[Reading, Seen]:
        for _ in range(TRIES):
            row, seen = self.engine.read(), self._watched.seen()
            if np.array_equal(row.coordinates, seen.coordinates):
                break
        return row, seen  # of periods side by side if the processor is so busy that they never were of one

    def hello(self) -> dict[str, Any]:
        """Return what does not change."""
        return {
            "tools": self.tools, "tool": self._described(), "materials": self._materials(), "rate": self.rate,
            "scalars": told_scalars(self.surface), "trained": told_training(self.model), "overlay": False,
        }  # fmt: skip

    def _materials(self) -> list[dict[str, Any]]:
        """Return what of the material may be changed: all moduli together, unless the tissue has times of its own."""
        if self.model.material.prony is not None:
            return []
        own = 1e-3 * float(self.model.material.shear_modulus)
        return [{"name": MODULUS, "unit": "kPa", "value": self.modulus_ratio * own, "low": SOFTEST * own,
                 "high": FIRMEST * own, "live": True}]  # fmt: skip

    def _described(self) -> dict[str, Any]:
        return self._moment()[1]

    def _moment(self) -> tuple[Snapshot, dict[str, Any]]:
        with self._lock:
            now = self.snapshot()
            return now, self.chosen.described(now.position, now.quaternion, self.held is self.chosen)

    def overlay(self, time: float) -> None:
        """Return the full model's positions: a session has none."""
        return None

    def status(self) -> dict[str, Any]:
        """Return what changes seldom."""
        return {
            "state": self.engine.state, "tool": self._described(), "speed": self.speed,
            "paused_because": self.paused_because, "recording": self._recorder is not None,
            "materials": self._materials(),
        }  # fmt: skip

    def statistics(self) -> dict[str, Any]:
        """Return how the engine kept its deadlines since it was started."""
        known = self.engine.statistics()
        return {
            "median_ms": 1e3 * known.computing.percentile(50), "p99_ms": 1e3 * known.computing.percentile(99),
            "misses": known.missed, "periods": known.count,
        }  # fmt: skip

    @property
    def tools(self) -> list[str]:
        """Kinds of tools that a hand may take."""
        return ["sphere", "capsule", "grasp"] if self.touched else []

    # what it is told

    def handle(self, message: Message) -> None:
        """Do what a checked message of whoever holds the tool says.

        Raises
        ------
        InputError
            It cannot be done; says why.
        """
        kind = message["type"]
        if kind == "pose":
            self._move(message)
        elif kind == "tool":
            self._take(message)
        elif kind == "release":
            self.release()
        elif kind == "control":
            {"reset": self.reset, "pause": self.pause, "resume": self.resume}[message["action"]]()
        elif kind == "material":
            self._stiffen(message["name"], 1e3 * message["value"])
        elif kind == "record":
            self.record() if message["action"] == "start" else self.finish_recording()
        elif kind == "speed":
            with self._lock:
                self.engine.slow_down(message["factor"])
                self.speed = message["factor"]
        else:
            raise InputError(f"{kind!r} is for replays" if kind == "replay" else f"{kind!r} is nothing to do here")

    def start(self) -> None:
        """Let the engine step."""
        self.engine.start()

    def stop(self) -> None:
        """End the engine's thread."""
        self.engine.stop()

    def close(self) -> None:
        """End the engine's thread and the recording that goes on, and return when all recordings are written."""
        self.stop()
        if self._recorder is not None:
            self.finish_recording()
        for writer in self._writers:
            writer.join()

    def pause(self, because: str | None = None) -> None:
        """Let the body's time stand still."""
        self.engine.pause()
        self.paused_because = because

    def resume(self) -> None:
        """Let the body's time go on."""
        if self.engine.state == "ran away":
            raise InputError("the state ran away: reset it")
        if self.engine.state == "stopped":
            self.engine.start()
        self.engine.resume()
        self.paused_because = None

    def reset(self) -> None:
        """Put the body at rest, the tool away."""
        with self._lock:
            running = self.engine.state in ("running", "ran away")
            self.engine.pause()
            if self.touched:
                self._equip(NOTHING, self._home, UNTURNED)
            self.engine.reset()
            self._watched.put(self._ready.rest, np.zeros(3))
            if running:
                self.resume()

    def release(self) -> None:
        """Take the tool away; a group that the model holds goes back to where it was at rest."""
        if not self.touched:
            self.engine.set_pose(np.zeros(3))
        elif self.held is not NOTHING:
            with self._lock:
                row = self.snapshot()
                self._swap(NOTHING, row.position, row.quaternion)

    # recordings

    def record(self, path: Path | None = None) -> None:
        """Begin a recording.

        Parameters
        ----------
        path : path, optional
            Where it is written in the end, whoever ends it; by default a new name in the session's folder.

        Raises
        ------
        InputError
            One goes on already.
        """
        if self._recorder is not None:
            raise InputError("record: a recording goes on already")
        self._recorder, self._path = Recorder(self._moment), path

    def finish_recording(self, path: Path | None = None, wait: bool = False) -> None:
        """End the recording and write it, in a thread of its own; `news` then tells where it is.

        Parameters
        ----------
        path : path, optional
            By default that of `record`.
        wait : bool
            Whether to return only when it is written.

        Raises
        ------
        InputError
            None goes on.
        """
        if self._recorder is None:
            raise InputError("record: no recording goes on")
        recorder, self._recorder = self._recorder, None
        recorder.stop()
        recording = Recording(
            self.title, self.model, np.array(recorder.times), recorder.moments, recorder.tools, {}
        )  # fmt: skip
        writer = threading.Thread(target=self._write, args=(path or self._path, recording), name="palpate writer")
        self._writers = [*(each for each in self._writers if each.is_alive()), writer]
        writer.start()
        if wait:
            writer.join()

    def _write(self, path: Path | None, recording: Recording) -> None:
        chosen = path
        try:
            path = chosen or _new_file(self.folder)
            save_recording(path, recording)
        except (InputError, OSError) as error:
            written = chosen is None and path is not None and path.stat().st_size > 0
            lost = "the file for ParaView" if written else "the recording"
            self.news.append({"type": "error", "reason": f"{lost} is lost: {error}"})
            if path is not None and chosen is None and not written:
                path.unlink(missing_ok=True)
        else:
            self.news.append({"type": "recorded", "file": str(path), "frames": len(recording.times)})

    def tick(self) -> None:
        """Notice that the machine slept, or this program was stopped; to be called several times a second."""
        now = (time.time(), time.monotonic())
        slept = max(now[0] - self._beat[0], now[1] - self._beat[1]) > ASLEEP
        self._beat = now
        if slept and self.engine.state == "running":
            self.pause("sleep")

    def _stiffen(self, name: str, modulus: float) -> None:
        if name != MODULUS or not self._materials():
            raise InputError(f"material: {name!r} cannot be changed here")
        own = float(self.model.material.shear_modulus)
        if not SOFTEST <= modulus / own <= FIRMEST:
            low, high = 1e-3 * SOFTEST * own, 1e-3 * FIRMEST * own
            raise InputError(f"{name} = {1e-3 * modulus:g} kPa: allowed is from {low:g} to {high:g} kPa")
        with self._lock, self._standing():
            self._watched.stiffen(modulus / own)
            self.modulus_ratio = modulus / own

    # the tool

    @contextlib.contextmanager
    def _standing(self) -> Iterator[None]:
        """Let the engine stand still for a moment."""
        running = self.engine.state == "running"
        self.engine.pause()
        try:
            yield
        finally:
            if running:
                self.engine.resume()

    def _move(self, message: Message) -> None:
        position, quaternion = self._outside.limited(np.array(message["position"])), np.array(message["quaternion"])
        with self._lock:
            if self.touched and self.held is NOTHING and not self._brought_back(position, quaternion):
                return
            turn = turned(self._turn, quaternion, back=True)
            self.engine.set_pose(position - self._home, turn, message["sequence"])

    def _brought_back(self, position: Floats, quaternion: Floats) -> bool:
        """Put the tool that was last held down again, if it is outside of the body."""
        tool = self.chosen.shape
        if tool is None or isinstance(tool, Forceps):
            return False
        if not self._outside.tells(self._moved(), tool, np.concatenate([position, quaternion])):
            return False
        self._swap(self.chosen, position, quaternion)
        return True

    def _take(self, message: Message) -> None:
        if not self.touched:
            raise InputError("tool: this model holds one group of nodes and takes no other tool")
        position, turn = self._outside.limited(np.array(message["position"])), np.array(message["quaternion"])
        tool: Tool
        if message["kind"] == "grasp":
            tool, position = forceps(self.surface, self._moved(), position, message["radius"])
        else:
            tool = shape(message)
            if not self._outside.tells(self._moved(), tool, np.concatenate([position, turn])):
                raise InputError("tool: it would be inside the body there; put it down outside")
        self.chosen = Held(
            message["kind"], tool, message["radius"], message["length"], message["friction"], message["stiffness"]
        )
        self._swap(self.chosen, position, turn, message["sequence"])

    def _moved(self) -> Floats:
        return self.snapshot().displacements(self.surface).astype(float)

    def _swap(self, held: Held, position: Floats, quaternion: Floats, sequence: int | None = None) -> None:
        """Take another tool in the hand, the body going on from the state in which it is."""
        with self._lock, self._standing():
            self._equip(held, position, quaternion, self.engine.read().sequence if sequence is None else sequence)

    def _equip(self, held: Held, position: Floats, quaternion: Floats, sequence: int = 0) -> None:
        grasps = isinstance(held.shape, Forceps)  # they turn what they hold by as much as they are turned
        turn = UNTURNED if grasps else quaternion
        change_tool(self._ready, held.shape, np.concatenate([position, turn]), held.friction)
        self._watched.couple(held.stiffness)
        self._watched.put(self.engine.read().coordinates, np.zeros(3))
        self.engine.place_tool(np.zeros(3), turn, sequence)
        self.held, self._home, self._turn = held, np.array(position), quaternion if grasps else UNTURNED


def _new_file(folder: Path) -> Path:
    """Make an empty file for a recording, of a name that nobody else has; named after the time."""
    folder.mkdir(parents=True, exist_ok=True)
    stem = time.strftime("recording-%Y%m%d-%H%M%S")
    for number in itertools.count(1):
        path = folder / (f"{stem}.h5" if number == 1 else f"{stem}-{number}.h5")
        with contextlib.suppress(FileExistsError):
            path.touch(exist_ok=False)
            break
    return path
