"""Functions that commands compile from an empty cache, and the processor time of that.

    python benchmarks/compiled_functions.py [beam] [touch] [reduced]

Each command runs in one process with one thread and an empty folder of compiled functions. A function counts once, and
a version for each signature. The time is exclusive: that of a function is without the functions that it calls. It
writes docs/validation/compiled_functions.json; `tests/benchmarks/test_compiled_functions.py` compares today's count of
the beam with it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
COMMANDS = {
    "beam": "what palpate reproduce beam compiles before its runs, of both forms",
    "touch": "palpate run liver --full --realtime --seconds 1 --spacing 0.012 --out out",
    "reduced": "a reduced model of a pressed block, and its run and engine",
}
# the listener counts in the process that compiles; a call of Numba's compiler in another one charges only itself
COUNT = """
import collections, json, os, sys, time
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # one process compiles all
import numba
from numba.core import event

counts, seconds, stack, last = collections.Counter(), collections.Counter(), [], [0.0]


def charge():
    now = time.thread_time()
    if stack:
        seconds[stack[-1]] += now - last[0]
    last[0] = now


class Compiled(event.Listener):
    def on_start(self, event):
        charge()
        function = event.data["dispatcher"].py_func
        stack.append(f"{function.__module__}:{function.__qualname__}")
        counts[stack[-1]] += 1

    def on_end(self, event):
        charge()
        stack.pop()


event.register("numba:compile", Compiled())
"""
PRESS = """
import numpy as np
import palpate as pt

tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000.0, poisson=0.45)
body = pt.Solid(pt.box((0.03, 0.03, 0.015), spacing=0.004), tissue, fixed="z-")
ball = pt.tools.Contact(pt.tools.Sphere(0.006), lambda t: (0.015, 0.015, 0.0212 - 0.1 * t))
run = pt.rollout(body, [ball], duration=0.02, every=0.001, progress=False)
model = pt.hyper_reduce(body, run, modes=4)
pt.rollout(model, [ball], duration=0.005, every=0.001, progress=False)
engine = pt.Engine(pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(0.006), (0.015, 0.015, 0.0212))))
"""
BEAM = """
from palpate.app.studies.reproduce import PAPER_EXAMPLES
from palpate.app.studies.study import compile_study

example = PAPER_EXAMPLES["beam"]
for make in example.studies.values():
    study = make(example.case())
    compile_study(study, study.series)
"""
RUN = """
import warnings
from palpate.app.cli import main

warnings.simplefilter("ignore")
status = main({words})
if status:
    sys.exit(status)
"""
END = """
Path(sys.argv[1]).write_text(json.dumps({"counts": counts, "seconds": seconds}))
os._exit(0)
"""


def compiled_functions(name: str) -> dict[str, Any]:
    """Return what a command compiles from an empty cache.

    Parameters
    ----------
    name : str
        One of `COMMANDS`.

    Returns
    -------
    dict
        ``"functions"``, ``"versions"``, ``"seconds"`` of processor time, and ``"by_function"``: versions and seconds by
        the name of a function.
    """
    code = {"beam": BEAM, "reduced": PRESS}.get(name) or RUN.format(words=COMMANDS[name].split()[1:])
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder, "cache")
        cache.mkdir(mode=0o700)
        variables = {"NUMBA_CACHE_DIR": str(cache), "XDG_CACHE_HOME": str(cache)}
        threads = dict.fromkeys(("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        done = subprocess.run(
            [sys.executable, "-P", "-c", COUNT + code + END, str(Path(folder, "counts.json"))], cwd=folder,
            env={**os.environ, **variables, **threads}, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"{COMMANDS[name]} failed:\n{done.stderr}")
        found = json.loads(Path(folder, "counts.json").read_text(encoding="utf-8"))
    counts, seconds = found["counts"], found["seconds"]
    return {
        "functions": len(counts), "versions": sum(counts.values()), "seconds": round(sum(seconds.values()), 1),
        "by_function": {each: [counts[each], round(seconds[each], 2)] for each in sorted(counts)},
    }  # fmt: skip


def main() -> None:
    """Count for some commands, print the most expensive functions, and keep the counts."""
    sys.path.insert(0, str(ROOT / "validation"))
    import result_files

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", choices=[[], *COMMANDS], metavar="COMMAND")
    for name in parser.parse_args().commands or COMMANDS:
        found = compiled_functions(name)
        print(f"{COMMANDS[name]}: {found['functions']} functions, {found['versions']} versions, {found['seconds']} s")
        by_function = found.pop("by_function")
        for function in sorted(by_function, key=lambda each: -by_function[each][1])[:12]:
            print(f"  {by_function[function][1]:6.2f} s  {by_function[function][0]} x {function}")
        results = result_files.read("compiled_functions", {})
        result_files.write("compiled_functions", results | {name: {"command": COMMANDS[name]} | found})


if __name__ == "__main__":
    main()
