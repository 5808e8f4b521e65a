"""Damage and forge files, texts, messages and command lines, and see how palpate takes them.

    python validation/fuzz.py KIND --seconds 60 --seed 1

Each trial runs in a process of its own with limits of memory and time. It ends as ``refused`` (an error of palpate's
types), as ``equal`` (the same numbers as without the damage), or as ``accepted`` (a forgery with right checksums whose
values a file of this kind may have, and which was then used). Anything else is a fault: another exception, a number
that differs silently, a crash, a hang, or too much memory. The script prints the counts and the faults, and ends with
status 1 if there is a fault. The seed and the number of a trial repeat it: --seed K --only N.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

# one thread, because every trial is a fork
os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
os.environ |= {"NUMBA_THREADING_LAYER": "workqueue", "PYTHONWARNINGS": "ignore"}

import numpy as np

from palpate.core.faults import DivergenceError, InputError

# bytes that a trial may take beyond the program's own, and computing time [s] after which it hangs: a forged model may
# need kernels that are not yet compiled
TRIAL_LIMITS = (200 << 20, 30.0)
LABEL_LIMITS = (300 << 20, 30.0)  # of label maps, whose voxels are unpacked
COMPILING = {"physics": (1 << 30, 120.0)}  # of kinds whose trials compile kernels of many bodies
SLOW = 1.0  # [s] of computing time that a trial should not exceed
GOOD = ("refused", "equal", "accepted")

Trial = Callable[[np.random.Generator, Path], str]


def run_trial(
    trial: Trial, seed: int, number: int, folder: Path, limits: tuple[int, float] = TRIAL_LIMITS
) -> dict[str, Any]:
    """Return the outcome of a trial in a process of its own: what, and the computing time [s]."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _perform(trial, seed, number, folder, writing, limits)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        text = pipe.read()
    _, status, used = os.wait4(child, 0)
    seconds = used.ru_utime + used.ru_stime
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        what = "hang" if name in ("SIGALRM", "SIGXCPU", "SIGVTALRM", "SIGKILL") else f"crash: {name}"
        return {"what": what, "seconds": seconds}
    return {**json.loads(text), "seconds": seconds} if text else {"what": "no answer", "seconds": seconds}


def _perform(trial: Trial, seed: int, number: int, folder: Path, pipe: int, limits: tuple[int, float]) -> None:
    """Run a trial in the child, answer, and end the child."""
    quiet = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(quiet, stream)
    own = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (own + limits[0],) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 28, 1 << 28))
    signal.setitimer(signal.ITIMER_VIRTUAL, limits[1])  # of computing time
    signal.alarm(int(6 * limits[1]))  # for what waits without computing
    answer: dict[str, Any] = {}
    try:
        answer["what"] = trial(np.random.default_rng([seed, number]), folder)
    except (InputError, FileNotFoundError, DivergenceError) as error:
        answer["what"] = "refused"
        if "\n" in str(error) or len(str(error)) > 2000:
            answer["what"] = "a message that is not one line"
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        answer |= {"what": f"escape: {type(error).__name__}", "text": str(error)[:200]}
        answer["where"] = f"{Path(where.filename).name}:{where.lineno}"
    try:
        os.write(pipe, json.dumps(answer).encode())
    finally:
        os._exit(0)


def study(kind: str, seconds: float, most: int, seed: int, only: int | None = None) -> dict[str, Any]:
    """Run trials of a kind until the time or their number ends; return the counts and the faults."""
    from fuzz_kinds import KINDS

    with TemporaryDirectory(prefix="palpate-fuzz-") as name:
        folder = Path(name)
        trial = KINDS[kind](folder)
        if only is not None:
            print(trial(np.random.default_rng([seed, only]), folder))
            return {"faults": []}
        counts: Counter[str] = Counter()
        faults: list[dict[str, Any]] = []
        began, slowest, slow, number = time.monotonic(), 0.0, 0, 0
        limits = LABEL_LIMITS if kind.startswith("labels") else COMPILING.get(kind, TRIAL_LIMITS)
        while number < most and time.monotonic() - began < seconds:
            found = run_trial(trial, seed, number, folder, limits)
            counts[found["what"]] += 1
            slowest, slow = max(slowest, found["seconds"]), slow + (found["seconds"] > SLOW)
            if found["what"] not in GOOD:
                faults.append({"number": number, **found})
            number += 1
    return {
        "kind": kind, "seed": seed, "trials": number, "counts": dict(counts), "slowest_seconds": round(slowest, 3),
        "slower_than_1_s": slow, "wall_seconds": round(time.monotonic() - began, 1), "faults": faults,
    }  # fmt: skip


def main() -> int:
    from fuzz_kinds import KINDS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="+", choices=[*KINDS, "all"], metavar="KIND", help=f"{', '.join(KINDS)}, or all")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each kind (60)")
    parser.add_argument("--trials", type=int, default=10**9, help="at most, for each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="number of the one trial to run, in this process")
    options = parser.parse_args()
    faults = 0
    for kind in KINDS if "all" in options.kinds else options.kinds:
        found = study(kind, options.seconds, options.trials, options.seed, options.only)
        faults += len(found["faults"])
        listed = found.pop("faults")
        print(json.dumps(found), flush=True)
        for fault in listed[:20]:
            print("   fault:", json.dumps(fault), flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
