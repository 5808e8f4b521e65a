"""Times of a newcomer's first commands, in a fresh clone with an empty cache, and of the same commands again.

    python benchmarks/first_start.py [demo] [press] [test]

Wall-clock time and processor time of each, both with all child processes. `demo` is `make demo`, `press` runs the full
body of the generated liver in real time, `test` is `make test`. Packages are downloaded the first time. Run it with
nothing else on the machine; it writes docs/validation/first_start.json.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).parents[1]
COMMANDS = {
    "demo": "make demo",
    "press": ".venv/bin/palpate run liver --full --realtime --seconds 1 --spacing 0.012 --out out/liver",
    "test": "make test",
}


def seconds_of(command: str, clone: Path, cache: Path) -> dict[str, float]:
    """Return the wall-clock and processor time [s] of a command in a clone, with a cache of its own."""
    variables = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    done = subprocess.run(
        command, shell=True, cwd=clone, env={**variables, "XDG_CACHE_HOME": str(cache)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    wall, after = perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"{command} failed:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return {"wall": wall, "processor": after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime}


def main() -> None:
    """Time each command twice, and keep the times."""
    sys.path.insert(0, str(ROOT / "validation"))
    import result_files

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", choices=[[], *COMMANDS], metavar="COMMAND")
    for name in parser.parse_args().commands or COMMANDS:
        with tempfile.TemporaryDirectory() as folder:
            clone, cache = Path(folder, "palpate"), Path(folder, "cache")
            cache.mkdir(mode=0o700)
            subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
            if name == "press":  # the environment is not a part of it
                subprocess.run(["make", ".venv/.installed-base"], cwd=clone, check=True, capture_output=True)
                install = [".venv/bin/python", "-m", "pip", "install", "--quiet", "--editable", ".[view]"]
                subprocess.run(install, cwd=clone, check=True, capture_output=True)
            first, second = (seconds_of(COMMANDS[name], clone, cache) for _ in range(2))
        print(
            f"{COMMANDS[name]}: {first['wall']:.0f} s ({first['processor']:.0f} s of processor), again "
            f"{second['wall']:.0f} s ({second['processor']:.0f} s)"
        )
        results = result_files.read("first_start", {})
        command = f"python benchmarks/first_start.py {name}"
        result_files.write("first_start", results | {name: {"first": first, "second": second}}, command)


if __name__ == "__main__":
    main()
