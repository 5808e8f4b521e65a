"""Size of the file of a reduced model by array, and the time to load it.

    python benchmarks/model_file.py FILE [--rounds 5]

Loading is measured in a process in which palpate is imported and the file was loaded once. The columns are bytes in the
file, and bytes of the array.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from timing import median_seconds

import palpate as pt
from palpate.core.sealed import open_sealed
from palpate.reduction.storage.model_file import FORMAT, OLDER_VERSIONS, VERSION

MIN_SHARE = 0.005  # of the file, of an array with a line of its own


def main() -> None:
    """Print the table of a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    size, model = arguments.file.stat().st_size, pt.load(arguments.file)
    (seconds,) = median_seconds(lambda: pt.load(arguments.file), repeats=arguments.rounds)
    print(f"{len(model.cloud)} nodes, {model.count} coordinates: {size / 1e6:.1f} MB, loaded in {seconds:.2f} s")
    arrays = open_sealed(arguments.file, FORMAT, VERSION, OLDER_VERSIONS).arrays
    for name, entry in sorted(arrays.items(), key=lambda item: -item[1].size):
        if entry.size > MIN_SHARE * size:
            whole = math.prod(entry.shape) * np.dtype(entry.type).itemsize
            print(f"  {name:24}{entry.type:4}{entry.shape!s:18}{entry.size / 1e6:7.2f}{whole / 1e6:8.2f} MB")


if __name__ == "__main__":
    main()
