"""The folder of an exported model: objects, its file, and sources in C and C# around them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from palpate import __version__
from palpate.compiled.code_digest import kernel_sources
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.core.files import check_folder, write_bytes
from palpate.dynamics.contact import kinds
from palpate.export.library import Library
from palpate.export.link import host_target
from palpate.export.targets import HOST_TARGET, TARGET_MACHINES, TARGET_NAMES
from palpate.realtime.bodies.display_surface import Surface
from palpate.realtime.record import HEADER_DTYPE, HEADER_SIZE, TOOL_DTYPE, TOOL_SIZE, field_offset
from palpate.reduction.hyper.model import ReducedModel

TEMPLATE_NAMES = ("palpate.h", "model.h", "main.c", "CMakeLists.txt", "Organ.cs", "README.md")
PRESS_SHARE, RADIUS_SPACINGS = 0.5, 3.0  # depth of the example's press over the ball's radius, and that radius
ZIG_TARGETS = {
    "linux-x86-64-v2": "x86_64-linux-gnu.2.17", "linux-x86-64-v3": "x86_64-linux-gnu.2.17",
    "linux-aarch64": "aarch64-linux-gnu.2.17", "windows-x86-64": "x86_64-windows-gnu", "macos-arm64": "aarch64-macos",
}  # fmt: skip
FILE_DESCRIPTIONS = {
    "palpate.h": "arrays of a model, and functions that find them",
    "main.c": "a program that presses the organ and prints forces and deadline statistics",
    "CMakeLists.txt": "builds it",
    "Organ.cs": "the model in C#, for Unity",
    "kernels/": "the Python code that was compiled, to read",
}


def identifier(text: str) -> str:
    """Return an identifier of C for the name of a file."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_").lower()
    return name if name and not name[0].isdigit() else f"model_{name}".strip("_")


def check_new(folder: Path, name: str = "folder") -> None:
    """Raise `InputError` unless a folder is new or empty, and OSError if it cannot be made."""
    check_folder(folder.parent, name)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{name} must be new or empty, got {str(folder)!r}; choose another, or remove it")


@contextmanager
def complete_folder(folder: Path) -> Iterator[Path]:
    """Give a folder to write to, whose files are in `folder` at the end; a run that is stopped leaves nothing there.

    A process that is killed leaves the hidden folder, which the next one replaces.
    """
    folder = folder.absolute()
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part
        folder.mkdir(exist_ok=True)
        for entry in list(part.iterdir()):
            entry.rename(folder / entry.name)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def export_c(
    library: Library,
    folder: Path,
    *,
    title: str = "",
    targets: Sequence[str] = (HOST_TARGET,),
    strict: bool = True,
    say: Callable[[str], None] = print,
) -> dict[str, str]:
    """Write a library for programs in C, and what they need to use it.

    The folder must be new or empty. The names of files and functions begin with the name of the library.

    A `strict` library is compiled without contraction and reassociation of sums: all targets compute the same bits but
    for the functions of their C library. `say` is called with a line about each file that could not be made.

    Returns the files, and what they are.
    """
    for target in targets:
        if target not in TARGET_NAMES:
            raise InputError(f"target must be one of {', '.join(TARGET_NAMES)}, got {target!r}; choose one of these")
    check_new(folder)
    with complete_folder(folder) as part:
        return _write(part, library, title, targets, strict, say)


def _write(
    folder: Path,
    library: Library,
    title: str,
    targets: Sequence[str],
    strict: bool,
    say: Callable[[str], None],
) -> dict[str, str]:
    """Write the files of a library; arguments and result as of `export_c`."""
    name, words = library.name, _words(library.model, library.name)
    written = {f"{name}.palpate": "the constants of the model"}
    write_bytes(folder / f"{name}.palpate", library.image)
    for target in targets:
        stem = name if target == HOST_TARGET else f"{name}.{target}"
        content = library.emit(host_target() if target == HOST_TARGET else TARGET_MACHINES[target], strict)
        write_bytes(folder / f"{stem}.o", content)
        written[f"{stem}.o"] = f"the functions, for {'this machine' if target == HOST_TARGET else target}"
        shared = _link_shared(folder, name, target)
        if shared is None:
            say(f"{stem}.o was not linked to a shared library; the linker for {target} comes with pip install ziglang")
        else:
            written[shared] = f"the same as a shared library, for {'this machine' if target == HOST_TARGET else target}"
    written |= {f"{name}.h": "the functions of the model", **FILE_DESCRIPTIONS}
    rows = "\n".join(f"| `{file}` | {about} |" for file, about in written.items())
    words |= {"FILES": rows, "TITLE": title or name, "MODEL": title or name, "VERSION": __version__}
    for template in TEMPLATE_NAMES:
        text = files("palpate.export").joinpath("c", template).read_text(encoding="utf-8")
        text = re.sub(r"@([A-Z_]+)@", lambda match: words[match[1]], text)
        write_bytes(folder / (f"{name}.h" if template == "model.h" else template), text.encode())
    _write_kernels(folder / "kernels")
    return written | {"README.md": "how to build and use it"}


def _words(model: ReducedModel, name: str) -> dict[str, str]:
    """Return what stands in place of the words of the templates."""
    places = {field: field_offset(field) for field in HEADER_DTYPE.names or ()}
    lines = [f"    PALPATE_{field.upper()} = {place}" for field, place in places.items()]
    lines += [f"    PALPATE_HEADER_SIZE = {HEADER_SIZE}, PALPATE_TOOL_SIZE = {TOOL_SIZE}"]
    of_tool = [f"    PALPATE_TOOL_{each.upper()} = {field_offset(each, TOOL_DTYPE)}" for each in TOOL_DTYPE.names or ()]
    names = {"CAPSULE": kinds.CAPSULE, "PLANE": kinds.PLANE, "PUNCH": kinds.PUNCH, "FORCEPS": kinds.BONDED}
    point, inward, radius = _example_press(model)
    return {
        "NAME": name,
        "RECORD": ",\n".join(lines),
        "TOOL_RECORD": ",\n".join(of_tool),
        "KINDS": ", ".join(f"PALPATE_{key} = {value}" for key, value in names.items()),
        "POINT": ", ".join(f"{x:.6g}" for x in point),
        "INWARD": ", ".join(f"{x:.6g}" for x in inward),
        "RADIUS": f"{radius:.6g}",
        "DEPTH": f"{PRESS_SHARE * radius:.6g}",
        "TAKES_TOOLS": "1" if not model.data.prescribed else "0",
        "TRUST_INDEX": str(places["trust"]),
        "HEADER_SIZE": str(HEADER_SIZE),
        "TOOL_SIZE": str(TOOL_SIZE),
        "FORCE_INDEX": str(field_offset("force", TOOL_DTYPE)),
        "POSITION_INDEX": str(field_offset("position", TOOL_DTYPE)),
    }


def _example_press(model: ReducedModel) -> tuple[Floats, Floats, float]:
    """Return a point of the surface far from the supports, its inward normal, and the radius of a ball [m]."""
    surface = Surface(model)
    rest, triangles = surface.rest.astype(float), surface.triangles
    normals = np.zeros_like(rest)
    faces = np.cross(rest[triangles[:, 1]] - rest[triangles[:, 0]], rest[triangles[:, 2]] - rest[triangles[:, 0]])
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], faces)
    lengths = np.linalg.norm(normals, axis=1)
    fixed = rest[surface.fixed] if surface.fixed.any() else rest.mean(axis=0, keepdims=True)
    inward = -normals / np.maximum(lengths, 1e-30)[:, None]
    # against the supports: the product with the vector to their middle
    towards = fixed.mean(axis=0) - rest
    score = np.sum(inward * towards, axis=1) * (lengths > 0)
    best = int(np.argmax(score))
    return rest[best], inward[best], RADIUS_SPACINGS * float(model.cloud.spacing)


def _link_shared(folder: Path, name: str, target: str) -> str | None:
    """Link the object of a target to a shared library; return its name, or None without a linker."""
    if target == HOST_TARGET:
        compiler, stem = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang"), name
        command = [] if compiler is None else [compiler, "-shared"]
    else:
        stem = f"{name}.{target}"
        zig = [sys.executable, "-m", "ziglang", "cc", "-target", ZIG_TARGETS[target], "-s", "-shared"]
        command = [] if find_spec("ziglang") is None else zig
    if not command:
        return None
    system = "windows" if "windows" in target or (target == HOST_TARGET and sys.platform == "win32") else ""
    system = "macos" if "macos" in target or (target == HOST_TARGET and sys.platform == "darwin") else system
    shared = f"{stem}.dll" if system == "windows" else f"lib{stem}.{'dylib' if system == 'macos' else 'so'}"
    exports = ["-Wl,--export-all-symbols"] if system == "windows" else []
    math = [] if system else ["-lm"]
    done = subprocess.run(
        [*command, "-o", shared, f"{stem}.o", *exports, *math], cwd=folder, capture_output=True, text=True, check=False
    )
    return shared if done.returncode == 0 else None


def _write_kernels(folder: Path) -> None:
    """Write the sources of the compiled functions, to read."""
    folder.mkdir()
    modules: Mapping[str, str] = kernel_sources("palpate.export.entries") | kernel_sources(
        "palpate.realtime.bodies.period"
    )
    for module, text in modules.items():
        if ":" not in module and text:
            write_bytes(folder / f"{module.removeprefix('palpate.')}.py", text.encode())
