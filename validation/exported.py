"""Exported libraries against the engine: equal bits, largest differences, and times, for many kinds of models.

    python validation/exported.py [--cases NeoHookean ...] [--periods 1000] [--times]

trains a small block of every kind, exports it by `palpate export`, and steps the library and the engine's period
through the same presses, slides, turns, grasps and pulls. Strict libraries are compared bit by bit with the same
functions compiled by Numba without contraction and reassociation, and by differences with the engine as shipped.
Times are medians of periods that alternate. It writes docs/validation/exported.json and prints a table.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import struct
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numba
import numpy as np
from llvmlite import ir

STRICT = "--strict" in sys.argv
if STRICT:  # before palpate's functions are declared
    relaxed_njit = numba.njit
    numba.njit = lambda *a, **given: relaxed_njit(*a, **{k: v for k, v in given.items() if k != "fastmath"})
    for instruction in ("fadd", "fmul"):  # of palpate's own instructions
        relaxed = getattr(ir.IRBuilder, instruction)
        setattr(ir.IRBuilder, instruction, lambda self, a, b, name="", flags=(), put=relaxed: put(self, a, b, name))

import result_files  # noqa: E402

import palpate as pt  # noqa: E402
from palpate.realtime.bodies.display_surface import Surface  # noqa: E402
from palpate.realtime.record import HEADER_SIZE, TOOL_DTYPE, TOOL_SIZE, field_offset  # noqa: E402
from palpate.tissue.catalogue import LAWS  # noqa: E402

SIZE, SPACING, BALL, DEPTH = (0.06, 0.06, 0.03), 0.0075, 0.015, 0.004
GIVEN = {"density": 1000.0, "poisson": 0.4}
TEXT = "C1*(I1bar - 3) + C2*(exp(b*(I1bar - 3)) - 1)"
HEADER, ENTRY = 64, struct.Struct("<24sQIIII")
TYPES = ("f8", "f4", "i8", "u4", "b1", "u1", "i4")
PRONY = pt.materials.Prony(shares=(0.5, 0.2), times=(0.01, 0.1))
FIBRES = pt.materials.Fibres(k1=2e3, k2=3.0, directions=(1.0, 0.0, 0.0))
FORCE, STIFFNESS, TOOL_FORCE = field_offset("force"), field_offset("stiffness"), field_offset("force", TOOL_DTYPE)


class Library:
    """An exported library and its memory."""

    def __init__(self, folder: Path, name: str) -> None:
        self.functions, self.name = ctypes.CDLL(str(folder / f"lib{name}.so")), name
        content = (folder / f"{name}.palpate").read_bytes()
        size = self._number("memory_size")
        block = np.zeros(size + 64, np.uint8)
        self.memory = block[-block.ctypes.data % 64 :][:size]
        self.memory[: len(content)] = np.frombuffer(content, np.uint8)
        self.arrays = {}
        for k in range(struct.unpack_from("<I", content, 12)[0]):
            label, offset, kind, rows, columns, _ = ENTRY.unpack_from(content, HEADER + ENTRY.size * k)
            dtype = np.dtype(TYPES[kind])
            part = self.memory[offset : offset + rows * columns * dtype.itemsize].view(dtype)
            self.arrays[label.rstrip(b"\0").decode()] = part.reshape(rows, columns) if columns > 1 else part

    def _number(self, function: str) -> int:
        pointer = self.functions[f"{self.name}_{function}"]
        pointer.restype = ctypes.c_int64
        return int(pointer())

    def __call__(self, function: str) -> int:
        return int(self.functions[f"{self.name}_{function}"](ctypes.c_void_p(self.memory.ctypes.data)))


class Engine:
    """The functions of a library, compiled by Numba in this process."""

    def __init__(self, model: pt.ReducedModel, tools: int = 2) -> None:
        from palpate.export.library import model_functions

        self._functions, self.arrays = model_functions(model, tools)

    def __call__(self, name: str) -> int:
        function, arguments = self._functions[name]
        return int(function(*arguments))


def step_through(model: Any, periods: int, touches: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step a library or an engine through the motions; return records, vertices of the end, and times [s]."""
    arrays, records, times = model.arrays, [], np.zeros(periods)
    for k in range(periods):
        if touches and k == 0:
            set_tool(model, 0, (BALL, 0.0, 0.0), (0.024, 0.038, SIZE[2] + BALL + 0.001), 0.3)
        elif touches and k == periods // 2:
            set_tool(model, 3, (0.012, 0.0, 0.0), (0.03, 0.03, SIZE[2]), 0.0)
        arrays["pose"][0] = pose_at((2.0 * k / periods) % 1.0, k < periods // 2)
        began = perf_counter()
        status = model("step")
        times[k] = perf_counter() - began
        if status:
            raise RuntimeError(f"status {status} in period {k}")
        records.append(np.append(arrays["record"], arrays["force_bound"]))
    model("vertices")
    return np.array(records), arrays["vertices"].copy(), times


def coordinates_part(library: Library, count: int) -> slice:
    """Return where a number of coordinates are in the record."""
    first = HEADER_SIZE + TOOL_SIZE * len(np.atleast_2d(library.arrays["pose"]))
    return slice(first, first + count)


def set_tool(model: Any, kind: int, sizes: tuple[float, ...], place: Any, friction: float, index: int = 0) -> None:
    arrays = model.arrays
    arrays["tool_index"][0] = index
    arrays["tool_kind"][0], arrays["tool_sizes"][:], arrays["tool_friction"][0] = kind, sizes, friction
    arrays["tool_pose"][:], arrays["tool_point"][:] = (*place, 1.0, 0.0, 0.0, 0.0), place
    if model("set_tool"):
        raise RuntimeError(f"tool of kind {kind} is refused")


def tool_record(model: Any, index: int) -> np.ndarray:
    """Return a copy of the part of a tool in the record."""
    first = HEADER_SIZE + TOOL_SIZE * index
    return np.array(model.arrays["record"][first : first + TOOL_SIZE])


def pose_at(s: float, presses: bool) -> tuple[float, ...]:
    """Return the pose at a share of a motion: press, slide and turn; or pull with a turn."""
    angle = 0.15 * max(0.0, s - 0.5)
    turned = (np.cos(angle), 0.0, 0.0, np.sin(angle))
    if presses:
        return (0.006 * max(0.0, s - 0.35), 0.0, -0.005 * min(1.0, 3.0 * s), *turned)
    return (0.002 * s, 0.0, 0.004 * min(1.0, 2.0 * s), *turned)


def press(time: float) -> tuple[float, float, float]:
    share = np.sin(np.pi * min(time / 0.16, 1.0)) ** 2
    return 0.024, 0.030, SIZE[2] + BALL + 0.001 - share * (DEPTH + 0.001)


def lift(points: np.ndarray, time: float) -> np.ndarray:
    return 2e-3 * np.sin(30 * time) ** 2 * np.array([0.3, 0.0, 1.0])


def materials() -> dict[str, Any]:
    """Return the material of every case, and the name of a motion where no tool touches the body."""
    neo = pt.materials.NeoHookean(C1=2e3, **GIVEN)
    laws = [law for law in LAWS if law.kind is not pt.materials.LinearElastic]  # has no reduced model that samples
    found: dict[str, Any] = {law.name: law.kind(**law.example, **GIVEN) for law in laws}
    found["text"] = pt.materials.Hyperelastic(TEXT, C1=1.5e3, C2=5e2, b=2.0, **GIVEN)
    found["relaxation"] = replace(neo, prony=PRONY)
    found["regions, relaxation, fibres"] = {
        "": replace(neo, prony=PRONY), "half": pt.materials.NeoHookean(C1=4e3, prony=PRONY, **GIVEN)
    }  # fmt: skip
    found["moved group"] = found["moved group, implicit steps"] = neo
    return found


def train(case: str, path: Path) -> None:
    """Train and store a small model of a case."""
    cloud, material = pt.box(SIZE, spacing=SPACING), materials()[case]
    cloud = replace(cloud, groups={**cloud.groups, "half": np.flatnonzero(cloud.points[:, 0] > 0.03)})
    fibres = FIBRES if isinstance(material, dict) else None
    body = pt.Solid(cloud, material, "z-", stiffness_damping=1e-4, fibres=fibres)
    if case.startswith("moved"):
        run = pt.rollout(body, [pt.PrescribedMotion("z+", lift)], duration=0.1, every=0.005, progress=False)
        model = pt.hyper_reduce(body, [run], modes=8, prescribed="z+")
        model = model.with_step(5e-4) if case.endswith("steps") else model
    else:
        ball = pt.tools.Contact(pt.tools.Sphere(BALL), press)
        run = pt.rollout(body, [ball], duration=0.2, every=0.005, progress=False)
        model = pt.hyper_reduce(body, [run], modes=0, enrichment=pt.vibration_modes(body, 12)[0])
    pt.save(model, path)


def export(path: Path, *options: str) -> Path:
    """Run `palpate export` on a model; return the last option, its folder."""
    command = [sys.executable, "-m", "palpate", "export", str(path), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(done.stdout + done.stderr)
    return Path(options[-1])


def reference(path: Path, periods: int) -> tuple[np.ndarray, np.ndarray]:
    """Return records and vertices of the functions that Numba compiles in another process, without fast math."""
    target = path.with_suffix(".npz")
    command = [sys.executable, __file__, "--strict", str(path), str(target), str(periods)]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(path.parent / "numba")}
    subprocess.run(command, check=True, env=environment)
    with np.load(target) as found:
        return found["records"], found["vertices"]


def _difference(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference over the largest number."""
    return float(np.abs(found - expected).max() / max(np.abs(expected).max(), 1e-30))


def compare(case: str, folder: Path, periods: int) -> dict[str, Any]:
    """Return how a library of a case differs from the engine, and the time of a period of either [s]."""
    path, touches = folder / "organ.rom", not case.startswith("moved")
    train(case, path)
    began = perf_counter()
    export(path, "--c", str(folder / "c"))
    exported = perf_counter() - began
    library, model = Library(folder / "c", "organ"), pt.load(path)
    if library("check"):
        raise RuntimeError("the library refuses its own file")
    records, vertices, times = step_through(library, periods, touches)
    strict_records, strict_vertices = reference(path, periods)
    shipped, shipped_vertices, _ = step_through(Engine(model), periods, touches)
    _, _, shipped_times = step_through(Engine(model), periods, touches)  # compiled by now
    moved = np.abs(shipped_vertices - Surface(model).rest).max()
    coordinates = coordinates_part(library, model.count)
    parts = {"force": slice(FORCE, FORCE + 3), "stiffness": slice(STIFFNESS, STIFFNESS + 9), "coordinates": coordinates}
    return {
        "case": case,
        "periods": periods,
        "equal": int(np.sum((records == strict_records).all(axis=1))),
        "equal_vertices": bool(np.array_equal(vertices, strict_vertices)),
        "differences": {name: _difference(records[:, part], shipped[:, part]) for name, part in parts.items()},
        "vertices": float(np.abs(vertices - shipped_vertices).max() / moved),
        "largest_force": float(np.linalg.norm(records[:, FORCE : FORCE + 3], axis=1).max()),
        "library": float(np.median(times)),
        "engine": float(np.median(shipped_times)),
        "seconds": exported,
    }


def measure_times(folder: Path, periods: int, rounds: int = 7) -> list[dict[str, Any]]:
    """Return the time of a period [s] of libraries and of the engine, in turn in one run, while a ball presses."""
    from numba import njit

    path = folder / "organ.rom"
    train("NeoHookean", path)
    libraries = {}
    for name, more in (("library, strict", []), ("library, relaxed", ["--relaxed"])):
        target = folder / name.replace(", ", "_")
        export(path, *more, "--c", str(target))
        libraries[name] = Library(target, "organ")
    engine = Engine(pt.load(path))
    step, arguments = engine._functions["step"]

    @njit
    def repeat(data, work, pose, options, curve, bound, count):
        for _ in range(count):
            step(data, work, pose, options, curve, bound)

    models = {"engine (Numba)": engine, **libraries}
    for model in models.values():
        set_tool(model, 0, (BALL, 0.0, 0.0), (0.024, 0.038, SIZE[2] + BALL + 0.001), 0.3)
        model.arrays["pose"][0] = pose_at(0.34, True)
        for _ in range(200):
            model("step")
    repeat(*arguments, 1)
    times: dict[str, list[float]] = {name: [] for name in models}
    for _ in range(rounds):
        for name, model in models.items():
            began = perf_counter()
            if model is engine:
                repeat(*arguments, periods)
            else:
                function, memory = model.functions["organ_step"], ctypes.c_void_p(model.memory.ctypes.data)
                for _ in range(periods):
                    function(memory)
            times[name].append((perf_counter() - began) / periods)
    medians = {name: float(np.median(each)) for name, each in times.items()}
    base = medians["engine (Numba)"]
    return [{"name": name, "seconds": value, "ratio": value / base} for name, value in medians.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=list(materials()), default=list(materials()))
    parser.add_argument("--periods", type=int, default=1000)
    parser.add_argument("--times", action="store_true", help="measure times instead, of libraries and engine in turn")
    options = parser.parse_args()
    if options.times:
        with tempfile.TemporaryDirectory() as folder:
            rows = measure_times(Path(folder), options.periods)
        for row in rows:
            print(f"{row['name']}: {1e6 * row['seconds']:.1f} us, {row['ratio']:.2f} of the engine's")
        result_files.write("exported_times", rows)
        return
    found = {row["case"]: row for row in result_files.read("exported", [])}
    for case in options.cases:
        with tempfile.TemporaryDirectory() as folder:
            row = compare(case, Path(folder), options.periods)
        found[case] = row
        print(
            f"{case}: {row['equal']} of {row['periods']} periods equal, vertices {row['equal_vertices']}; engine as "
            f"shipped within {row['differences']}, vertices {row['vertices']:.1e}; {row['largest_force']:.3g} N; "
            f"{1e6 * row['library']:.1f} us, {row['library'] / row['engine']:.2f} of the engine's; "
            f"exported in {row['seconds']:.0f} s",
            flush=True,
        )
        result_files.write("exported", list(found.values()))


if __name__ == "__main__":
    if STRICT:
        model, target, count = pt.load(sys.argv[2]), sys.argv[3], int(sys.argv[4])
        records, vertices, _ = step_through(Engine(model), count, not model.data.prescribed)
        np.savez(target, records=records, vertices=vertices)
    else:
        main()
