"""Working folders with files that other packages would read or import.

`fuzz.py` runs these trials as kind ``folder``: a command in a folder with random files, links and
pipes of names that Python, Numba, pyMOR and matplotlib look for. None of them may run, and the
command must print what it prints in an empty folder.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

Rng = np.random.Generator

SECONDS = 120
MODULES = (
    "IPython", "dask", "distributed", "h5py", "json", "matplotlib", "mpi4py", "multiprocessing", "numba", "numpy",
    "palpate", "pickle", "pymor", "pyvista", "random", "scipy", "selectors", "sitecustomize", "struct", "tempfile",
    "usercustomize", "vtkmodules", "websockets", "yaml",
)  # fmt: skip
RUN = "open({ran!r}, 'w').close()\n"
SETTINGS = {
    ".numba_config.yaml": ["CACHE_DIR: cache\n", "DISABLE_JIT: 1\n", "CACHE_LOCATOR_CLASSES: os.path\n", "{{[", "a"],
    "matplotlibrc": ["text.usetex: True\n", "backend: module://numpy\n", "figure.figsize: 1, 1\n", "\0\udcff"],
    "pymor_defaults.py": [RUN],
    ".env": ["NUMBA_CACHE_DIR=.\nPYTHONPATH=.\n"],
    "setup.cfg": ["[options]\n"],
    "pyproject.toml": ["[tool.palpate]\n"],
}
CURVE = "# kind: uniaxial\nstretch [-], nominal stress [kPa]\n1.0, 0.0\n1.1, 0.61\n1.2, 1.1\n1.3, 1.6\n"
PYMOR = "from palpate.reduction.lti.pymor_bridge import need_pymor; need_pymor('this'); print('imported')"
KERNEL = (
    "import numpy as np, palpate as pt; from numba import njit; f = njit(lambda x: x + 1); "
    "print(pt.fill(pt.Surface(*(lambda b: (b.points, b.triangles))(pt.box((1, 1, 1), 0.25))), spacing=0.2), f(1))"
)


def folder_kind(folder: Path) -> Callable[[Rng, Path], str]:
    """Return trials of a command in a working folder with odd files."""
    curve = folder / "curve.csv"
    curve.write_text(CURVE)
    commands = [
        ["-m", "palpate", "laws"],
        ["-m", "palpate", "fit", "NeoHookean", str(curve), "--out", "out"],
        ["-c", PYMOR],
        ["-c", KERNEL],
    ]
    expected = {}
    for number, command in enumerate(commands):
        with TemporaryDirectory(dir=folder) as empty:
            expected[number] = _run(command, Path(empty))
        if expected[number][0]:
            raise RuntimeError(f"{command} must end with status 0 in an empty folder, got {expected[number]}")

    def trial(rng: Rng, place: Path) -> str:
        number = int(rng.integers(len(commands)))
        with TemporaryDirectory(dir=place) as name:
            working, ran = Path(name) / "working", Path(name) / "ran"
            working.mkdir()
            for _ in range(int(rng.integers(1, 8))):
                _put(rng, working, ran)
            found = _run(commands[number], working)
            if ran.exists():
                return f"a file of the working folder ran: {sorted(os.listdir(working))}"
        return "equal" if found == expected[number] else f"another output of command {number}: {found!r:.200}"

    return trial


def _put(rng: Rng, working: Path, ran: Path) -> None:
    """Put a file, a folder, a link or a pipe of a name that a package looks for into a folder."""
    if rng.random() < 0.6:
        name = str(rng.choice(list(SETTINGS)))
        content = str(rng.choice(SETTINGS[name]))
    else:
        module, content = str(rng.choice(MODULES)), RUN + "raise ImportError\n"
        name = f"{module}.py" if rng.random() < 0.7 else f"{module}/__init__.py"
    path, how = working / name, rng.random()
    path.parent.mkdir(exist_ok=True)
    if os.path.lexists(path):
        return
    data = content.replace("{ran!r}", repr(str(ran))).encode("utf-8", "surrogateescape")
    if how < 0.7:
        path.write_bytes(data)
    elif how < 0.8:
        path.mkdir()
    elif how < 0.9:
        (working.parent / f"{path.name}.target").write_bytes(data)
        path.symlink_to(working.parent / f"{path.name}.target")
    else:
        os.mkfifo(path)


def _run(command: list[str], working: Path) -> tuple[int, str]:
    """Return the exit status and the standard output of a command."""
    done = subprocess.run(
        [sys.executable, "-P", *command], cwd=working, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, text=True, timeout=SECONDS, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout
