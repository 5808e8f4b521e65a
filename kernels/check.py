"""Start from the wheels of palpate and palpate-kernels in a new environment, and count the functions that compile.

    python kernels/check.py dist

Nothing can be written but results: a surface is pressed and a beam is stepped with no function compiled, also as
another processor with AVX2. Without AVX2 the force compiles, and is equal. At the end pip removes all of both wheels.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from fill import REDUCED, touches

from palpate.compiled.code_cache import code_folder
from palpate.compiled.shipped_code import PROCESSOR_FAMILIES

AVX2 = PROCESSOR_FAMILIES["x86-64-v3"]
COUNT = """
import sys
from numba.core import event
class Listener(event.Listener):
    compiled = []
    def on_start(self, each): pass
    def on_end(self, each): self.compiled.append(each.data["dispatcher"].py_func.__qualname__)
event.register("numba:compile", Listener())
"""
COMMAND = (
    COUNT
    + """
from palpate.app.cli import main
status = main(sys.argv[1:])
print("compiled", len(Listener.compiled), *Listener.compiled[:20])
sys.exit(status)
"""
)
FORCE = (
    COUNT
    + """
import numpy as np, palpate as pt
body = pt.Solid(pt.box((0.03, 0.03, 0.03), 0.005), pt.materials.NeoHookean(C1=1e3, density=1e3, poisson=0.45), "z-")
force = body.force(1e-3 * np.sin(300 * body.cloud.points))
print("force", repr(float(np.abs(force).sum())))
print("compiled", len(Listener.compiled))
"""
)


def main() -> None:
    """Run the starts; a defect ends the program with status 1."""
    wheels = sorted(Path(sys.argv[1]).resolve().glob("*.whl"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "venv", with_pip=True)
        python = folder / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
        words = [f"{wheel}[view]" if wheel.name.startswith("palpate-") else str(wheel) for wheel in wheels]
        subprocess.run([python, "-m", "pip", "install", "--quiet", *words], check=True)
        touch = touches(folder, ["NeoHookean"])[0]
        training = folder / "trained"
        _train(training)
        nowhere = {"HOME": os.devnull, "XDG_CACHE_HOME": os.devnull}
        for processor in ({}, {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": AVX2}):
            _expect_none(_run(python, COMMAND, touch, folder, nowhere | processor), touch, processor)
            _expect_none(
                _run(python, COMMAND, REDUCED, folder, {"XDG_CACHE_HOME": str(training)} | processor),
                REDUCED,
                processor,
            )
        packed = _run(python, FORCE, [], folder, nowhere).split()
        old = _run(
            python, FORCE, [], folder, nowhere | {"NUMBA_CPU_NAME": "x86-64-v2", "NUMBA_CPU_FEATURES": ""}
        ).split()
        left = _uninstall(python, folder / "venv")
    if left:
        sys.exit(f"pip uninstall leaves {', '.join(left)}")
    if packed[3] != "0" or old[3] == "0" or abs(float(old[1]) / float(packed[1]) - 1) > 1e-12:
        sys.exit(f"forces {packed} and, without AVX2, {old}")
    print(f"{len(wheels)} wheels: nothing compiled with AVX2; {old[3]} functions without, and an equal force")


def _uninstall(python: Path, environment: Path) -> list[str]:
    """Uninstall both packages, and return what is left of them."""
    command = [python, "-m", "pip", "uninstall", "--quiet", "--yes", "palpate", "palpate-kernels"]
    subprocess.run(command, check=True)
    return sorted(str(path.relative_to(environment)) for path in environment.rglob("*palpate*"))


def _train(folder: Path) -> None:
    """Train the beam with the clone and its compiled functions, of which nothing is left in the folder."""
    (folder / "palpate").mkdir(parents=True)
    code = folder / "palpate" / "code"
    code.symlink_to(code_folder() or folder)
    command = [sys.executable, "-c", COMMAND, *REDUCED]
    environment = _environment(XDG_CACHE_HOME=str(folder))
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    code.unlink()


def _environment(**more: str) -> dict[str, str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "PYTHONPATH"))}
    return environment | {"OPENBLAS_NUM_THREADS": "1"} | more


def _run(python: Path, program: str, words: list[str], folder: Path, variables: dict[str, str]) -> str:
    command, environment = [python, "-P", "-c", program, *words], _environment(**variables)
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(words)}: {done.stdout}\n{done.stderr}")
    return done.stdout


def _expect_none(printed: str, words: list[str], processor: dict[str, str]) -> None:
    last = printed.strip().splitlines()[-1]
    if last != "compiled 0":
        sys.exit(f"{' '.join(words)} as {processor}: {last}")


if __name__ == "__main__":
    main()
