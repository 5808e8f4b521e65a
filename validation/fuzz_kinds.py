"""What `fuzz.py` damages and forges: a sound file, text or message of every kind, its loader, and what differs.

A kind is a function of a folder that makes a sound example there and returns a trial: a function of a random generator
and the folder that damages or forges the example, and uses it as a person would.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import math
import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import fuzz_labels
import numpy as np

import palpate as pt
from palpate.app.device.hand_loop import HandLoop
from palpate.app.device.options import DeviceOptions
from palpate.app.device.service import force_message, parse_state
from palpate.app.recordings import recording as recordings
from palpate.app.recordings.recording_journal import RecordingJournal
from palpate.app.recordings.snapshot import Snapshot, ToolSnapshot
from palpate.app.session.messages import parse_message
from palpate.app.session.replay import Replay
from palpate.core.faults import InputError
from palpate.core.files import read_sealed_json, write_sealed_json
from palpate.core.sealed import HEAD_BYTES, open_sealed, write_sealed
from palpate.dynamics.run import trajectory as trajectories
from palpate.dynamics.run.recorder import Recorder
from palpate.reduction.lti import storage as linear_storage
from palpate.reduction.storage import model_file as storage

Rng = np.random.Generator
Trial = Callable[[Rng, Path], str]

NUMBERS = [0, 1, -1, 2, 0.5, -0.5, 1e-320, 1e-300, 1e300, 1.8e308, 2**31, 2**53, -(2**53), 10**6, 1e6, 1e-6, math.pi]
TEXTS = [
    "",
    "x",
    "np",
    "__import__",
    "os:system",
    "9**9**9",
    "../../x",
    "\x00",
    "a" * 300,
    "ä",
    "{}",
    "[]",
    "1e999",
    "-",
]


# changes of bytes


def damaged(rng: Rng, data: bytes) -> bytes:
    """Return a content with a few bytes changed, cut, doubled, moved, removed or put in; never the same."""
    while True:
        content, how = bytearray(data), rng.integers(8)
        at = int(rng.integers(len(data))) if rng.random() < 0.6 or len(data) < 2 * HEAD_BYTES else _edge(rng, len(data))
        size = int(rng.choice([1, 2, 8, 64, 512]))
        if how <= 2:
            for place in np.unique(rng.integers(at, min(at + 64, len(data)), size=int(rng.integers(1, 4)))):
                content[place] = rng.integers(256)
        elif how == 3:
            content[at] ^= 1 << int(rng.integers(8))
        elif how == 4:
            content = content[:at]
        elif how == 5:
            content[at:at] = (
                bytes(rng.integers(0, 256, size, dtype="u1")) if rng.random() < 0.5 else content[at : at + size]
            )
        elif how == 6:
            del content[at : at + size]
        else:
            content[at : at + size] = bytes(len(content[at : at + size]))
        if content != data:
            return bytes(content)


def _edge(rng: Rng, size: int) -> int:
    """Return a place near the beginning or the end, where heads and tables are."""
    near = int(rng.integers(min(size, 4 * HEAD_BYTES)))
    return near if rng.random() < 0.5 else size - 1 - near


# changes of values


def lie(rng: Rng, value: Any, depth: int = 0) -> Any:
    """Return a JSON value in which one leaf, key or branch is something else."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = str(rng.choice(sorted(value)))
        if rng.random() < 0.15:
            rest = {k: v for k, v in value.items() if k != key}
            return rest | ({str(rng.choice(TEXTS)): value[key]} if rng.random() < 0.5 else {})
        return value | {key: lie(rng, value[key], depth + 1)}
    if isinstance(value, list) and value and rng.random() < 0.85:
        k, how = int(rng.integers(len(value))), rng.random()
        if how < 0.15:
            return value[:k] + value[k + 1 :]
        if how < 0.3:
            return value[:k] + [value[k]] * int(rng.choice([2, 3, 100])) + value[k + 1 :]
        return [*value[:k], lie(rng, value[k], depth + 1), *value[k + 1 :]]
    if isinstance(value, str) and value[:1] in "{[" and value and rng.random() < 0.8:  # JSON in a text
        return json.dumps(lie(rng, json.loads(value)))
    return _other(rng, value)


def _other(rng: Rng, value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.6:
        scale = rng.choice([-1, 0.5, 2, 10, 1e3, 1e-3, 1e12, 1e-12])
        return rng.choice([value + 1, value - 1, float(value) * scale]).item()
    if isinstance(value, str) and value and rng.random() < 0.5:
        k = int(rng.integers(len(value)))
        return value[:k] + str(rng.choice(TEXTS)) + value[k + int(rng.integers(4)) :]
    kind = rng.integers(6)
    nested: Any = []
    for _ in range(int(rng.choice([1, 5, 30, 200]))):
        nested = [nested]
    return [
        rng.choice(np.array(NUMBERS, dtype=float)).item(), str(rng.choice(TEXTS)), None, bool(rng.integers(2)),
        {"a": 1.0}, nested,
    ][kind]  # fmt: skip


def lied_array(rng: Rng, array: Any) -> Any:
    """Return an array with other entries, type or shape."""
    array, how = array.copy(), rng.integers(8)
    if how <= 3 and array.size:
        hostile = (
            np.array([*NUMBERS, np.nan, np.inf, -np.inf])
            if array.dtype.kind == "f"
            else np.array([-1, 0, 1, 2**31, 2**62])
        )
        with np.errstate(all="ignore"):
            values = rng.choice(hostile, int(rng.integers(1, 4))).astype(array.dtype)
        array.flat[rng.integers(array.size, size=len(values))] = values
        if rng.random() < 0.2:
            array[...] = values[0]
        return array
    if how == 4:
        return array[: len(array) // 2] if array.ndim else array
    if how == 5:
        return np.concatenate([array, array]) if array.ndim else array
    if how == 6:
        return array.reshape(-1) if rng.random() < 0.5 else array[None]
    with np.errstate(all="ignore"):
        return array.astype(rng.choice(["<f8", "<f4", "<i8", "|u1", "|b1"]))


def forged(rng: Rng, path: Path, kind: str, version: int, to: Path) -> None:
    """Write a sealed file with one to three lies in it and right checksums, one that can be written."""
    while not to.exists():
        with contextlib.suppress(InputError, RuntimeError, ValueError, TypeError):
            _forge(rng, path, kind, version, to)


def _forge(rng: Rng, path: Path, kind: str, version: int, to: Path) -> None:
    file = open_sealed(path, kind, version)
    header: Any = dict(file.header)
    arrays = {name: file.read(name) for name in file.arrays}
    by_row = {name for name, entry in file.arrays.items() if entry.by_row}
    for _ in range(int(rng.integers(1, 4))):
        if rng.random() < 0.5:
            changed = lie(rng, header)
            header = changed if isinstance(changed, dict) else header
        else:
            name = str(rng.choice(sorted(arrays)))
            if rng.random() < 0.08:
                arrays.pop(name)
            else:
                arrays[name] = lied_array(rng, arrays[name])
    rows = {name: list(arrays.pop(name)) for name in by_row & arrays.keys() if arrays[name].ndim and len(arrays[name])}
    write_sealed(to, kind, version, header, arrays, rows, deflate=bool(rng.random() < 0.5))


def forged_deflated(rng: Rng, data: bytes) -> bytes:
    """Return a sealed file with other compressed bytes of an array, of the same number, and right checksums."""
    at = int(data[:HEAD_BYTES].split(b"\n")[2].split()[1])
    deflated = [entry for entry in json.loads(data[at:])["arrays"].values() if "deflated" in entry]
    if not deflated:
        return data
    entry = deflated[int(rng.integers(len(deflated)))]
    start, stop = entry["offset"], entry["offset"] + entry["deflated"]
    if rng.random() < 0.5:
        content = damaged(rng, data[start:stop])[: stop - start].ljust(stop - start, b"\0")
    else:  # of another array, which may be far longer
        content = zlib.compress(bytes(int(10 ** rng.uniform(0, 8))))[: stop - start].ljust(stop - start, b"\0")
    forgery = data[:start] + content + data[stop:]
    text = data[at:].replace(entry["sha256"].encode(), sha256(content).hexdigest().encode())
    return _with_table(forgery, at, text)


def forged_table(rng: Rng, data: bytes) -> bytes:
    """Return a sealed file with a lie in its table, and right checksums of the table."""
    at = int(data[:HEAD_BYTES].split(b"\n")[2].split()[1])
    table = json.loads(data[at:])
    if rng.random() < 0.7 and table["arrays"]:
        name = str(rng.choice(sorted(table["arrays"])))
        table["arrays"][name] = lie(rng, table["arrays"][name])
    else:
        table = lie(rng, table)
    return _with_table(data, at, json.dumps(table).encode())


def _with_table(data: bytes, at: int, text: bytes) -> bytes:
    kind, version = data[:HEAD_BYTES].split(b"\n")[:2]
    head = b"\n".join([kind, version, f"table {at} {len(text)} {sha256(text).hexdigest()}".encode(), b""])
    return head.ljust(HEAD_BYTES, b"\0") + data[HEAD_BYTES:at] + text


# sealed files


def sealed_kind(path: Path, kind: str, version: int, load: Callable[[Path], Any], use: Callable[[Any], None]) -> Trial:
    """Return the trial of a sealed file."""
    data, sound = path.read_bytes(), fingerprint(load(path))
    use(load(path))

    def trial(rng: Rng, folder: Path) -> str:
        changed, how = folder / f"changed{path.suffix}", rng.random()
        changed.unlink(missing_ok=True)
        if how < 0.4:
            changed.write_bytes(damaged(rng, data))
            return "equal" if fingerprint(load(changed)) == sound else "another number"
        if how < 0.6:
            changed.write_bytes(forged_table(rng, data))
        elif how < 0.7:
            changed.write_bytes(forged_deflated(rng, data))
        else:
            forged(rng, path, kind, version, changed)
        found = load(changed)
        use(found)
        return "equal" if fingerprint(found) == sound else "accepted"

    return trial


def fingerprint(value: Any) -> str:
    """Return a digest of all numbers and names of what was loaded."""
    digest = sha256()
    _add(digest, value)
    return digest.hexdigest()


def _add(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(value.dtype.str.encode() + repr(value.shape).encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for name in sorted(value, key=str):
            digest.update(str(name).encode("utf-8", "replace"))
            _add(digest, value[name])
    elif isinstance(value, pt.ReducedModel):
        _add(digest, list(storage.contents(value)))
    elif isinstance(value, pt.lti.LinearModel):
        _add(digest, value.reduced)
        _add(digest, value.report)
    elif hasattr(value, "__dataclass_fields__"):
        _add(digest, {f.name: getattr(value, f.name) for f in fields(value)})
    elif isinstance(value, list | tuple):
        digest.update(b"[%d" % len(value))
        for each in value:
            _add(digest, each)
    else:
        digest.update(repr(value).encode("utf-8", "replace"))


@cache
def bar() -> Any:
    """Return a small body in the energy form."""
    tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000.0, poisson=0.45)
    cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    return pt.Solid(cloud, tissue, fixed="x-", form="energy", stiffness_damping=1e-4)


def push(time: float) -> Any:
    """Return the place of a ball over the bar."""
    return 0.02, 0.0075, 0.015 + 0.008 - 0.1 * min(time, 0.02)


@cache
def pressed() -> Any:
    """Return a run of the bar under a ball."""
    return pt.rollout(bar(), [pt.tools.Contact(pt.tools.Sphere(0.008), push)], duration=0.02, every=0.002)


@cache
def model() -> pt.ReducedModel:
    """Return a reduced model that tools touch."""
    made = pt.hyper_reduce(bar(), [pressed()], modes=4)
    about = {"scene": {"name": "beam", "parameters": {"spacing": 0.005}}}
    return pt.ReducedModel(replace(made.data, report={**made.report, **about}))


def use_model(found: pt.ReducedModel) -> None:
    """Show the model's surface as the page would, and run the model for a millisecond, also under a ball."""
    from palpate.app.recordings.snapshot import scalar_descriptions, training_errors
    from palpate.app.session.tool_control import ToolWorkspace
    from palpate.realtime.bodies.display_surface import Surface

    scalar_descriptions(Surface(found))
    ToolWorkspace(Surface(found))
    training_errors(found)
    json.dumps(found.report)
    for loads in [], [pt.tools.Contact(pt.tools.Sphere(0.008), push)] if found.data.compliance else []:
        run = pt.rollout(found, loads, duration=1e-3, every=1e-3, progress=False)
        assert np.isfinite(run.displacements).all()


def reduced_kind(folder: Path) -> Trial:
    """Return trials of the file of a reduced model."""
    pt.save(model(), folder / "sound.rom")
    return sealed_kind(folder / "sound.rom", storage.FORMAT, storage.VERSION, pt.load, use_model)


def linear_kind(folder: Path) -> Trial:
    """Return trials of the file of a linear model."""
    pull = pt.SurfaceForce("x+", force=lambda t: (1e-3 * t, 0.0, 0.0))
    system = pt.lti.linearise(bar(), [pull], ["x+"])
    pt.save(pt.lti.reduce_linear(system, "modal", 4), folder / "sound.lti")

    def use(found: Any) -> None:
        assert np.isfinite(found.poles).all()

    load = lambda path: pt.load(path, system)  # noqa: E731
    return sealed_kind(folder / "sound.lti", linear_storage.FORMAT, linear_storage.VERSION, load, use)


def use_run(found: pt.Trajectory) -> None:
    """Use what a trajectory is for."""
    assert np.isfinite(found.balance).all() if len(found.times) else True
    assert all(np.isfinite(force).all() for force in found.reactions.values())


def trajectory_kind(folder: Path) -> Trial:
    """Return trials of the file of a trajectory."""
    pressed().save(folder / "sound.h5")
    return sealed_kind(folder / "sound.h5", trajectories.FORMAT, trajectories.VERSION, pt.Trajectory.load, use_run)


def stored_kind(folder: Path) -> Trial:
    """Return trials of a trajectory that is read frame by frame."""
    pressed().save(folder / "sound.h5")

    def load(path: Path) -> Any:
        found = trajectories.StoredTrajectory(path)
        return [found.points, found.times, found.displacements[:], found.contact_forces, found.bonded]

    return sealed_kind(folder / "sound.h5", trajectories.FORMAT, trajectories.VERSION, load, lambda found: None)


def journal_kind(folder: Path) -> Trial:
    """Return trials of the journal of a run that was cut off.

    A journal that ends before its last record does is a journal that was cut off, with one frame fewer.
    """
    path, run = folder / "sound.h5", pressed()
    recorder = Recorder(path, run.model, run, run.stiffness_damping, "journal")
    model, prepared = bar(), bar().prepare([pt.Gravity()])
    state = model.state(prepared)
    for k in range(6):
        recorder.add(1e-3 * k, k, model.outputs(state, prepared))
    recorder._journal.close()
    data, sound = path.read_bytes(), pt.Trajectory.load(path)

    def trial(rng: Rng, folder: Path) -> str:
        changed = folder / "changed.h5"
        content = damaged(rng, data)
        changed.write_bytes(content)
        found = pt.Trajectory.load(changed)
        use_run(found)
        count = len(found.times)
        whole = np.array_equal(found.displacements, sound.displacements[:count]) and np.array_equal(
            found.times, sound.times[:count]
        )
        shortened = count == len(sound.times) or len(content) < len(data)  # bytes of the last record are missing
        return "equal" if whole and shortened and not found.complete else "another number"

    return trial


def recording(full: bool = False) -> recordings.Recording:
    """Return a recording of a few moments of a reduced model or a full body with two tools, as a session leaves it."""
    body, zero = bar() if full else model(), np.zeros(3)
    count, moments = 3 * len(body.cloud) if full else body.count, []
    for k in range(8):
        touched = np.arange(2 if k % 3 else 0)
        tools = tuple(
            ToolSnapshot(
                force=zero + k,
                moment=zero,
                stiffness=np.eye(3),
                position=zero,
                quaternion=np.array([1.0, 0, 0, 0]),
                sequence=k,
                device_force=zero,
                kind=kind,
                pinned=kind == "grasp",
            )
            for kind in ("sphere", "grasp" if k > 3 else "none")
        )
        moments.append(
            Snapshot(
                tools=tools, time=0.01 * k, steps=10 * k, trust=0.1, kinetic=0.0, strain=1e-6, computing=1e-4,
                lateness=0.0, coordinates=1e-4 * k * np.ones(count, dtype=np.float32), state="running",
                contact_nodes=touched, contact_forces=np.ones((len(touched), 3)) * 1e-3, contact_tools=touched,
                modulus_ratio=1.0,
            )
        )  # fmt: skip
    sizes = {"radius": 0.008, "length": 0.04, "friction": 0.2, "stiffness": None}
    placed = (("sphere", 0, 0), ("none", 1, 0), ("grasp", 1, 4))
    tools_by_start = [{"kind": kind, **sizes, "index": index, "start": start} for kind, index, start in placed]
    return recordings.Recording("Bar", body, 0.01 * np.arange(8.0), moments, tools_by_start, {})


def use_recording(found: recordings.Recording) -> None:
    """Show the recording as the server would, and ask for its full model as `palpate replay --full` does."""
    from palpate.app.session.full_model_replay import tool_path
    from palpate.app.view.server import frames

    show = Replay(found)
    json.dumps([show.hello(), show.status(), show.statistics()], allow_nan=False)
    frames.geometry_frame(show.surface)
    for moment in found.snapshots[:3]:
        body = frames.state_body(show.surface, moment, "displacement")
        assert np.isfinite(np.frombuffer(body, "<f4")[44:]).all()
        numbers = np.frombuffer(frames.tools_frame(moment.tools, 1), "<f8", offset=16)
        assert len(numbers) == 16 * show.max_tools
        assert np.isfinite(numbers).all()
        for index in range(show.max_tools):
            frames.force_frame(moment, 1, index)
    with contextlib.suppress(InputError):
        tool_path(found)


def recording_kind(full: bool) -> Callable[[Path], Trial]:
    """Return the kind of a recording of a reduced model, or of a full body."""

    def kind(folder: Path) -> Trial:
        path = folder / "sound.h5"
        recordings.save_recording(path, recording(full))
        path.with_suffix(".vtkhdf").unlink()
        return sealed_kind(path, recordings.FORMAT, recordings.VERSION, recordings.load_recording, use_recording)

    return kind


def recording_journal_kind(folder: Path) -> Trial:
    """Return trials of the journal of a recording that was cut off."""
    path, sound = folder / "sound.h5", recording()
    journal = RecordingJournal(path, sound.title, sound.model)
    for k in range(0, len(sound.snapshots), 2):
        tools = [tool for tool in sound.tools if tool["start"] in (k, k + 1)]
        journal.add(sound.times[k : k + 2], sound.snapshots[k : k + 2], tools)
    journal.close()
    data = path.read_bytes()
    known = [fingerprint(moment) for moment in recordings.load_recording(path).snapshots]

    def trial(rng: Rng, folder: Path) -> str:
        changed = folder / "changed.h5"
        content = damaged(rng, data)
        changed.write_bytes(content)
        found = recordings.load_recording(changed)
        use_recording(found)
        same = [fingerprint(moment) for moment in found.snapshots] == known[: len(found.snapshots)]
        shortened = len(found.snapshots) == len(known) or len(content) < len(data)
        return "equal" if same and shortened else "another number"

    return trial


def manifest_kind(folder: Path) -> Trial:
    """Return trials of a campaign's manifest."""
    from palpate.app.train import folder as folders

    manifest = {
        "format": folders.FORMAT, "version": folders.VERSION, "palpate": pt.__version__, "scene": "beam",
        "title": "Beam", "parameters": {"spacing": 0.005, "poisson": 0.45}, "seed": 0, "every": 1e-3, "nodes": 112,
    }  # fmt: skip
    (folder / "runs").mkdir()
    path = folder / "campaign.json"
    write_sealed_json(path, manifest)
    data = path.read_bytes()

    def trial(rng: Rng, folder: Path) -> str:
        if rng.random() < 0.6:
            path.write_bytes(damaged(rng, data))
        else:
            path.unlink()
            while not path.exists():
                content = lie(rng, manifest)
                with contextlib.suppress(ValueError):
                    write_sealed_json(path, content if isinstance(content, dict) else {"a": content})
        folders.Folder(folder, manifest).check()
        same = read_sealed_json(path, "campaign") == manifest
        return "equal" if same else "another number"

    return trial


# texts


def material_kind(folder: Path) -> Trial:
    """Return trials of the text of a law: words of its grammar in any order, and sound ones damaged."""
    sound = ["C1 * (I1bar - 3) + C2 * (I1bar - 3)**2", "C1 * (exp(C2 * (I1bar - 3)) - 1)", "C1*(l1**2+l2**2+l3**2-3)"]
    words = ["I1", "I2", "J", "I1bar", "l1", "l2", "l3", "+", "-", "*", "/", "**", "(", ")", "exp(", "log(", "sqrt("]
    words += [
        "9",
        "2",
        "0.5",
        "1e999",
        "0x" + "f" * 200,
        "C1",
        "energy",
        "__dict__",
        "lambda:",
        "[",
        "]",
        ",",
        "if",
        ":=",
    ]

    def trial(rng: Rng, folder: Path) -> str:
        if rng.random() < 0.5:
            text = damaged(rng, str(rng.choice(sound)).encode()).decode("utf-8", "replace")
        elif rng.random() < 0.7:
            text = " ".join(rng.choice(words, int(rng.integers(1, 60))))
        else:
            text = str(rng.choice(["exp(", "(", "-", "9**", "sqrt("])) * int(rng.integers(1, 1500)) + "I1"
            text += ")" * text.count("(")
        parameters = {name: 1e3 for name in ("C1", "C2") if name in text}
        pt.materials.Hyperelastic(text, density=1000.0, poisson=0.45, stable=None, **parameters)
        return "accepted"

    return trial


SCENE = """
title = "Block"
[surface]
generated = "box"
size = ["40 mm", "30 mm", "30 mm"]
[body]
spacing = "5 mm"
[tissue]
law = "MooneyRivlin"
parameters = { C1 = "2.2 kPa", C2 = 100 }
poisson = "45 %"
[tissue.relaxation]
shares = [0.3]
times = ["20 ms"]
[[region]]
name = "tumour"
place = { ball = { centre = [0, 0, 0], radius = "15 mm" } }
stiffness = 3
[[support]]
place = { group = "x-" }
[[support]]
kind = "springs"
place = { side = "lowest 15%" }
stiffness = "12 kPa/cm"
[tool]
radius = "10 mm"
[[load]]
kind = "force"
place = { side = "x+" }
force = ["100 mN", 0, -2]
times = [0, "500 ms"]
factors = [0, 1]
[training]
paths = 7
depth = "5 mm"
"""
SCENE_VALUES = [
    "nan", "-inf", "1e308", "-0.0", "9" * 4999,
    "0x" + "f" * 900, "true", '""', '"1e999 mm"', '"1e-320"', '"1 kg"',
    '"٣ mm"',    '"near 1.2.3,e,1,1"', '"near 1e400,0,0,1"', '"lowest 1e9%"', '"x+"',
    '"/dev/zero"', '"/"', '"../.."', '"\\u0000"',
    '"' + "a" * 9999 + '"', "[]", "[[]]", "[1, 2, 3]", "[1e308, 1e308, 1e308]", "{}",
    "{ file = '/dev/zero', distance = 1 }", "[" * 5000, "{ side = 'x-' }", "1979-05-27", "1979-05-27T07:32:00Z",
    "a." * 9999 + "a", '"liver"', '"disc"',
    '"Ogden"',
    '"exp(exp(exp(I1)))"', '"springs"', '"roller"', "1e-9", "1e9",
]  # fmt: skip


def scene_kind(folder: Path) -> Trial:
    """Return trials of scene files: damaged bytes, and keys and values in wrong places; the body is made."""
    from palpate.scenes.description import Body, Load, Place, Run, Shape, Support, Tissue, Tool, Training
    from palpate.scenes.open_scene import open_scene

    keys = [f.name for each in (Body, Load, Place, Run, Shape, Support, Tissue, Tool, Training) for f in fields(each)]
    sound = folder / "sound.toml"
    sound.write_text(SCENE)
    known = open_scene(sound)
    body, prepared = known.body, known.body.prepare(known.loads)
    body.stable_step(body.state(prepared), prepared)  # compiles
    known.paths(0)

    def lied(rng: Rng) -> bytes:
        if rng.random() < 0.5:  # other numbers in their places
            numbers = list(re.finditer(r"(?<![\w.])\d+(\.\d+)?", SCENE))
            found = numbers[int(rng.integers(len(numbers)))]
            number = rng.choice(NUMBERS) if rng.random() < 0.3 else float(found[0]) * 10 ** rng.normal(0.0, 0.5)
            return f"{SCENE[: found.start()]}{number:.6g}{SCENE[found.end() :]}".encode()
        lines = SCENE.splitlines()
        for _ in range(int(rng.integers(1, 4))):
            k = int(rng.integers(len(lines)))
            value = str(rng.choice(SCENE_VALUES if rng.random() < 0.7 else [str(each) for each in NUMBERS]))
            key = lines[k].partition(" = ")[0] if "=" in lines[k] and rng.random() < 0.6 else str(rng.choice(keys))
            if rng.random() < 0.2:
                lines[k] = str(rng.choice(["[[support]]", "[load]", "[[a]]", "[tissue.fibres]", "[surface]", ""]))
            elif "=" in lines[k] and rng.random() < 0.8:
                lines[k] = f"{key} = {value}"
            else:
                lines.insert(k, f"{key} = {value}")
        return "\n".join(lines).encode("utf-8", "replace")

    def trial(rng: Rng, folder: Path) -> str:
        path = folder / "changed.toml"
        path.write_bytes(damaged(rng, SCENE.encode()) if rng.random() < 0.4 else lied(rng))
        scene = open_scene(path)
        made, loads, same = scene.body, scene.loads, scene.digest == known.digest
        made.prepare(loads)
        loads, _ = scene.paths(0)
        made.prepare(loads)
        return "equal" if same else "accepted"

    return trial


def curve_kind(folder: Path) -> Trial:
    """Return trials of a CSV file of measured curves."""
    sound = "# source\n# kind: uniaxial\nstretch [-], nominal stress [kPa]\n1.00, 0.00\n1.10, 0.61\n1.2, 1.1\n"
    bits = [
        ",",
        ";",
        "\t",
        "\n",
        "#",
        "[",
        "]",
        '"',
        "kind",
        "curve",
        "nan",
        "inf",
        "1e999",
        "\x00",
        "\uff11",
        "1_0",
        "%",
    ]

    def trial(rng: Rng, folder: Path) -> str:
        data = sound.encode()
        if rng.random() < 0.5:
            data = damaged(rng, data)
        for _ in range(int(rng.integers(3))):
            at = int(rng.integers(len(data) + 1))
            data = data[:at] + str(rng.choice(bits)).encode() * int(rng.choice([1, 2, 1000])) + data[at:]
        (folder / "curve.csv").write_bytes(data)
        for curve in pt.io.read_measurements(folder / "curve.csv"):
            assert np.isfinite(curve.deformation).all()
            assert np.isfinite(curve.stress).all()
        return "accepted"

    return trial


def message_kind(folder: Path) -> Trial:
    """Return trials of what a client of the page's server says."""
    sound = [
        {"type": "hello", "protocol": 2, "token": "abc", "name": ""}, {"type": "pose", "position": [0.1, 0.0, 0.2]},
        {"type": "tool", "kind": "sphere", "radius": 0.01, "position": [0, 0, 0.1]}, {"type": "latency", "stamp": 1.5},
        {"type": "force", "rate": 100.0}, {"type": "material", "name": "shear modulus", "value": 5.0},
        {"type": "pin", "index": 1, "pinned": True}, {"type": "pose", "position": [0.1, 0.0, 0.2], "index": 3},
        {"type": "force", "rate": 100.0, "tools": [0, 2]}, {"type": "release", "index": 2},
    ]  # fmt: skip

    def trial(rng: Rng, folder: Path) -> str:
        content = sound[int(rng.integers(len(sound)))]
        if rng.random() < 0.4:
            text = damaged(rng, json.dumps(content).encode()).decode("utf-8", "replace")
        else:
            text = json.dumps(lie(rng, content))
        if rng.random() < 0.2:
            text = text.replace(
                "1", str(rng.choice(["1e999", "NaN", "Infinity", "9" * 500, '"\\ud800"', "[" * 50_000]))
            )
        version = int(rng.integers(2, 4))
        message = parse_message(text, version)
        json.dumps(message, allow_nan=False).encode()
        assert version > 2 or (message.get("index", 0), message.get("tools", [0])) == (0, [0])
        return "accepted"

    return trial


def device_kind(folder: Path) -> Trial:
    """Return trials of what the service of a haptic device says."""
    cursor = {"cursor_position": {"x": 0.0, "y": -0.12, "z": 0.15}, "cursor_velocity": {"x": 0.0, "y": 0.0, "z": 0.0}}
    grip = {"orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}, "buttons": {"a": False, "b": True, "c": False}}
    sound = {
        "inverse3": [
            {"device_id": name, "config": {"handedness": "left"}, "state": cursor} for name in ("049D", "04BA")
        ],
        "wireless_verse_grip": [{"device_id": "61548", "state": grip}],
    }
    loop = HandLoop(DeviceOptions(), 2, lambda answer: None)

    def trial(rng: Rng, folder: Path) -> str:
        if rng.random() < 0.5:
            text = damaged(rng, json.dumps(sound).encode()).decode("utf-8", "replace")
        else:
            text = json.dumps(lie(rng, sound))
        forces = loop.forces(parse_state(text), float(rng.uniform(0, 1e3)))
        force_message(forces)
        return "accepted"

    return trial


def surface_kind(suffix: str) -> Callable[[Path], Trial]:
    """Return the kind of a surface file."""

    def kind(folder: Path) -> Trial:
        import pyvista
        import trimesh

        ball, path = trimesh.creation.icosphere(subdivisions=2, radius=0.05), folder / f"sound.{suffix}"
        if suffix in ("vtk", "vtp"):
            faces = np.column_stack([np.full(len(ball.faces), 3), ball.faces]).ravel()
            pyvista.PolyData(np.asarray(ball.vertices), faces).save(path)
        elif suffix == "trian":
            rows = [f"{len(ball.vertices)}", *(f"{x} {y} {z}" for x, y, z in ball.vertices), f"{len(ball.faces)}"]
            path.write_text("\n".join([*rows, *(f"{a} {b} {c} 0 0 0" for a, b, c in ball.faces)]) + "\n")
        elif suffix.endswith(".gz"):
            path.write_bytes(gzip.compress(ball.export(file_type=suffix.removesuffix(".gz"))))
        else:
            ball.export(path)
        data, sound = path.read_bytes(), pt.io.read_surface(path, units="m")

        def trial(rng: Rng, folder: Path) -> str:
            changed = folder / f"changed.{suffix}"
            changed.write_bytes(damaged(rng, data))
            found = pt.io.read_surface(changed, units="m", repair=bool(rng.integers(2)))
            pt.io.check_surface(found)
            same = np.array_equal(found.vertices, sound.vertices) and np.array_equal(found.triangles, sound.triangles)
            return "equal" if same else "accepted"  # surfaces of others have no checksum

        return trial

    return kind


def label_kind(suffix: str) -> Callable[[Path], Trial]:
    """Return the kind of a label map: half of the files have headers that lie, all others are damaged."""

    def kind(folder: Path) -> Trial:
        sound = fuzz_labels.dicom(folder) if suffix == "dcm" else b""

        def trial(rng: Rng, folder: Path) -> str:
            data = sound or fuzz_labels.compose(suffix, rng)
            if sound or rng.random() < 0.5:
                data = damaged(rng, data)
            path = folder / f"changed.{suffix}"
            path.write_bytes(data)
            return fuzz_labels.read_and_use(path, rng)

        return trial

    return kind


def command_kind(folder: Path) -> Trial:
    """Return trials of command lines: options of the parser with odd values, and files of other kinds."""
    import argparse

    from palpate.app.cli import build_parser, main

    def leaves(parser: Any, words: list[str]) -> list[tuple[list[str], Any]]:
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                return [leaf for name, sub in action.choices.items() for leaf in leaves(sub, [*words, name])]
        return [(words, parser)]

    commands = leaves(build_parser(), [])
    values = [
        "nan",
        "inf",
        "-1",
        "0",
        "1e-320",
        "1e999",
        "9" * 400,
        "",
        "x" * 5000,
        "\n",
        "../..",
        "/dev/null",
        "é",
        "liver:x",
    ]
    files = []
    for name, data in (
        ("text", b"hello"),
        ("json", b"[" * 9999),
        ("bytes", bytes(range(256))),
        ("hdf", b"\x89HDF\r\n\x1a\n"),
    ):
        (folder / name).write_bytes(data)
        files.append(str(folder / name))

    def trial(rng: Rng, folder: Path) -> str:
        words, parser = commands[int(rng.integers(len(commands)))]
        argv = [*words]
        for action in parser._actions:
            value = str(rng.choice(values + files))
            if not action.option_strings:
                argv.append(value if action.choices is None else str(rng.choice([*map(str, action.choices), value])))
            elif action.dest not in ("help", "realtime") and rng.random() < 0.3:
                argv += [action.option_strings[0], *([] if action.nargs == 0 else [value])]
        if len(argv) == len(words) and words[:1] != ["laws"]:
            return "refused"
        if words[:1] in (["reproduce"], ["run"]):
            argv += ["--out", files[0]]  # a file: refused before anything long
        told = io.StringIO()
        with contextlib.redirect_stderr(told):
            try:
                status = main(argv)
            except SystemExit as end:
                status = int(end.code or 0)
        lines = [line for line in told.getvalue().splitlines() if line]
        if status == 2 and lines and "Traceback" not in told.getvalue():
            return "refused"
        return "accepted" if status == 0 else f"status {status}: {lines[-1:]} of {argv}"

    return trial


def physics_kind(folder: Path) -> Trial:
    """Return trials of models, loads and runs with numbers of any size."""
    from fuzz_physics import trial as physics

    return lambda rng, folder: {"ran": "accepted"}.get(physics(rng), "refused")


def cost_kind(folder: Path) -> Trial:
    """Return trials of small surface files that are composed to cost much time or memory."""
    import fuzz_surfaces

    return fuzz_surfaces.trial


def folder_kind(folder: Path) -> Trial:
    """Return trials of commands in a working folder with files that other packages look for."""
    import fuzz_folder

    return fuzz_folder.folder_kind(folder)


KINDS: dict[str, Callable[[Path], Trial]] = {
    "model": reduced_kind, "linear": linear_kind, "trajectory": trajectory_kind, "stored": stored_kind,
    "journal": journal_kind, "recording": recording_kind(False), "full_recording": recording_kind(True),
    "recording journal": recording_journal_kind, "manifest": manifest_kind,
    **{suffix: surface_kind(suffix) for suffix in ("stl", "obj", "ply", "off", "glb", "vtk", "vtp", "trian", "stl.gz")},
    **{f"labels {suffix}": label_kind(suffix) for suffix in fuzz_labels.SUFFIXES},
    "material": material_kind, "scene": scene_kind, "curve": curve_kind, "message": message_kind,
    "device": device_kind, "command": command_kind, "physics": physics_kind, "cost": cost_kind, "folder": folder_kind,
}  # fmt: skip
