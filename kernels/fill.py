"""Fill the pack of palpate-kernels for this Python, Numba and system.

    python kernels/fill.py [--laws NeoHookean MooneyRivlin ...] [--family x86-64-v3]

What is packed follows from starts, not from a list: a surface is touched with each law, and a beam is reduced and
stepped, as a user does it. Each start is repeated with all code compiled; what the second one reads is packed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from palpate.compiled.code_cache import DIGEST_BYTES, FILE_SUFFIX
from palpate.compiled.shipped_code import pack_name, write_pack
from palpate.scenes.organ import liver_surface
from palpate.surface.surface import Surface
from palpate.tissue.catalogue import LAWS

FOLDER = Path(__file__).parent / "src" / "palpate_kernels"
FAMILIES = {"x86_64": "x86-64-v3", "AMD64": "x86-64-v3", "aarch64": "generic", "arm64": "apple-m1"}
OLD = 2 * 86_400.0  # [s] of age, so that a use of a file is noted
SPACING, BALL = 0.012, 0.02  # [m]


def main() -> None:
    """Fill the pack."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [law.name for law in LAWS]
    parser.add_argument("--laws", nargs="+", choices=names, default=names, metavar="LAW")
    parser.add_argument("--family", default=FAMILIES.get(platform.machine(), "generic"))
    parser.add_argument("--no-reduced", action="store_true", help="leave out reduced models")
    arguments = parser.parse_args()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = os.environ | {
            "NUMBA_CPU_NAME": arguments.family, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(folder / "numba"),
            "XDG_CACHE_HOME": str(folder / "cache"), "OPENBLAS_NUM_THREADS": "1",
        }  # fmt: skip
        jobs = touches(folder, arguments.laws) + ([] if arguments.no_reduced else [REDUCED])
        with ThreadPoolExecutor(max_workers=2) as pool:
            list(pool.map(lambda job: start(job, folder, environment), jobs))
        code = folder / "numba" / "palpate-code"
        then = time.time() - OLD
        for file in code.iterdir():
            os.utime(file, (then, then))
        for job in jobs:
            start(job, folder, environment)
        read = [file for file in sorted(code.glob(f"*{FILE_SUFFIX}")) if file.stat().st_mtime > then + 1.0]
        entries = {file.name.removesuffix(FILE_SUFFIX): file.read_bytes()[DIGEST_BYTES:] for file in read}
        triple = subprocess.run(
            [sys.executable, "-c", "from palpate.compiled.shipped_code import machine_processor as m; print(m()[0])"],
            env=environment, capture_output=True, text=True, check=True,
        ).stdout.strip()  # fmt: skip
    path = FOLDER / pack_name(triple, arguments.family)
    for old in FOLDER.glob("*.pack"):
        old.unlink()
    write_pack(path, entries)
    size = 1e-6 * path.stat().st_size
    print(f"{path.name}: {len(entries)} functions, {size:.2f} MB, in {time.monotonic() - began:.0f} s")


REDUCED = ["run", "beam", "--realtime", "--seconds", "1"]


def touches(folder: Path, laws: Sequence[str]) -> list[list[str]]:
    """Write a surface and the script of a touch, and return the commands that touch it with each law."""
    surface: Surface = liver_surface(2 * SPACING / 3)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in 1e3 * surface.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in surface.triangles + 1]
    (folder / "organ.obj").write_text("\n".join(lines) + "\n")
    x, y, z = surface.vertices[surface.vertices[:, 2].argmax()].tolist()
    above = [x, y, z + BALL + 0.005]
    script: list[dict[str, Any]] = [
        {"time": 0.2, "type": "tool", "kind": "sphere", "radius": BALL, "position": above},
        *(
            {"time": 0.4 + 0.05 * k, "type": "pose", "position": [x, y, above[2] - 0.0015 * k],
             "quaternion": [1, 0, 0, 0], "sequence": k}
            for k in range(12)
        ),
        {"time": 1.5, "type": "material", "name": "shear modulus", "value": 3.0},
        {"time": 2.0, "type": "tool", "kind": "capsule", "radius": BALL, "length": 0.05, "position": above},
        {"time": 2.5, "type": "control", "action": "reset"},
    ]  # fmt: skip
    (folder / "touch.jsonl").write_text("\n".join(map(json.dumps, script)) + "\n")
    command = ["run", "organ.obj", "--full", "--script", "touch.jsonl", "--seconds", "3"]
    command += ["--spacing", f"{SPACING}"]
    return [[*command, "--law", law.name, "--set", *_parameters(law)] for law in LAWS if law.name in laws]


def _parameters(law: Any) -> list[str]:
    """Return the parameters of a law's example as words of a command."""
    return [f"{name}={json.dumps(value)}" for name, value in law.example.items()]


def start(words: list[str], folder: Path, environment: dict[str, str]) -> None:
    """Run a command of palpate; a failure ends the program with what it has printed."""
    program = "import sys; from palpate.app.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        sys.exit(f"{' '.join(words)}: {done.stdout}\n{done.stderr}")


if __name__ == "__main__":
    main()
