"""How much memory the modes of many snapshots of a large body take, and how near they are to the exact ones.

    python validation/out_of_core.py [--side 46] [--snapshots 10000] [--modes 100] [--method strain|displacement]

A fixed block of side^3 nodes (46: 97,336). The snapshots are smooth random motions, 100 to a file, in single precision
(12 GB for 10,000; --folder says where). They are made of a few hundred known shapes, so that the exact singular values
follow from small matrices. The modes are found in a process of its own, whose peak memory is measured.

strain        modes of du/dX, as `palpate.hyper_reduce` takes them (`main_modes`)
displacement  `palpate.pod`

Prints what was found, and appends it to docs/validation/out_of_core.json.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import result_files
from numpy.typing import NDArray

import palpate as pt
from palpate.core.sealed import write_sealed
from palpate.dynamics.run.trajectory import FORMAT, VERSION
from palpate.reduction.basis.incremental_pod import block_size
from palpate.reduction.basis.snapshots import Snapshots
from palpate.reduction.basis.strain_pod import MIN_SIZE, main_modes

Floats = NDArray[np.float64]

SHAPES, FRAMES, LARGEST = 150, 100, 0.1  # frames in a file; the largest displacement over the block's side
SPARE = 8


def body(side: int) -> pt.Solid:
    """Return the fixed block."""
    tissue = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.49)
    return pt.Solid(pt.box((0.1, 0.1, 0.1), 0.1 / (side - 1)), tissue, "x-", form="energy", stiffness_damping=1e-6)


def shapes(points: Floats) -> Floats:
    """Smooth random fields (SHAPES, n) that vanish at the fixed face, small ones where they vary fast."""
    random = np.random.default_rng(0)
    waves, phases = random.uniform(-2.5, 2.5, (SHAPES, 3)), random.uniform(0, 2 * np.pi, SHAPES)
    place = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    fade = 1 / (1 + np.linalg.norm(waves, axis=1) ** 4)
    return np.sin(np.pi * place @ waves.T + phases).T * place[:, 0] * fade[:, None]


def shares(snapshots: int) -> Floats:
    """Coefficients (t, 3, SHAPES) of the shapes: in every file smooth in time, and at rest at its start."""
    found = np.zeros((snapshots, 3, SHAPES))
    for k, first in enumerate(range(0, snapshots, FRAMES)):
        random = np.random.default_rng([1, k])
        time = np.linspace(0, 1, FRAMES)[: snapshots - first, None, None, None]
        turns = np.sin(np.pi * time * random.uniform(0.5, 6.0, (3, SHAPES, 3)))
        found[first : first + FRAMES] = np.sum(turns * random.standard_normal((3, SHAPES, 3)), axis=-1)
    return found * 0.001 * LARGEST


def write(points: Floats, snapshots: int, folder: Path) -> list[Path]:
    """Write the files that are not there yet."""
    fields, parts, paths = shapes(points).astype(np.float32), shares(snapshots).astype(np.float32), []
    folder.mkdir(parents=True, exist_ok=True)
    for k, first in enumerate(range(0, snapshots, FRAMES)):
        own = parts[first : first + FRAMES]
        paths.append(folder / f"{len(points)}_{k:04d}_{len(own)}.h5")
        if paths[-1].exists():
            continue
        frames, count = [(share @ fields).T for share in own], np.zeros(len(own))
        header = {"model": "shapes", "label": "", "wall_seconds": 0.0, "stiffness_damping": 0.0, "complete": True}
        arrays = {"points": points, "times": np.linspace(0, 1, len(own)), "steps": count,
                  "contact_forces": np.zeros((0, 5)), "bonded": np.zeros(0, dtype=bool)}  # fmt: skip
        write_sealed(paths[-1], FORMAT, VERSION, header, arrays, {"displacements": frames})
    return paths


def peak() -> float:
    """Peak memory of this process [GB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def measured(side: int, modes: int, method: str, files: list[Path]) -> dict[str, Any]:
    """Find the modes in this process, and compare them with the exact ones."""
    model = body(side)
    before, start = peak(), perf_counter()
    snapshots, values = Snapshots(files), None
    if method == "strain":
        found, lost = main_modes(model, snapshots, modes, SPARE)
        found = found[:modes]
    else:
        basis = pt.pod(files, model.volumes, modes=modes)
        found, values = basis.modes, basis.singular_values[:modes]
        lost = float(np.sqrt(basis.dropped / (basis.dropped + np.sum(basis.singular_values**2))))
    entry = {
        "nodes": len(model.cloud), "snapshots": len(snapshots), "modes": modes, "method": method,
        "block": block_size(len(model.cloud)), "seconds": perf_counter() - start, "gigabytes_before": before,
        "gigabytes": peak(), "bytes_of_files": sum(file.stat().st_size for file in files), "lost": lost,
    }  # fmt: skip
    return entry | compared(model, len(snapshots), found, values, method)


def compared(
    model: pt.Solid, count: int, modes: Floats, values: Floats | None, method: str
) -> dict[str, float | list[float]]:
    """Say what the modes miss of the snapshots and what the best ones miss, from small matrices alone."""
    fields, parts = shapes(model.cloud.points), shares(count)
    products = model.stencils.products(model.volumes)
    images = (products @ fields.T).T if method == "strain" else fields * model.volumes
    gram = fields @ images.T  # of the shapes, the same for every direction
    root = np.linalg.cholesky(gram + 1e-15 * np.trace(gram) * np.eye(SHAPES))
    rows = (parts @ root).reshape(count, -1)
    if method == "strain":
        sizes = np.linalg.norm(rows, axis=1)
        scale = np.maximum(sizes, MIN_SIZE * sizes.max()) ** -0.5
        rows, parts = rows * scale[:, None], parts * scale[:, None, None]
    exact, whole = np.linalg.svd(rows, compute_uv=False), float(np.sum(rows**2))
    # orthonormal in the product at hand, then their products with the shapes
    flat = modes.reshape(len(modes), -1)
    weighted = np.stack([products @ u if method == "strain" else u * model.volumes[:, None] for u in modes])
    lower = np.linalg.cholesky(flat @ weighted.reshape(len(modes), -1).T)
    onto = np.linalg.solve(lower, np.einsum("mnc,sn->mcs", weighted, fields).reshape(len(modes), -1))
    missed = whole - float(np.sum((parts.reshape(count, -1) @ onto.T) ** 2))
    best = float(np.sum(exact[len(modes) :] ** 2))
    result: dict[str, float | list[float]] = {
        "missed": float(np.sqrt(max(missed, 0.0) / whole)), "best": float(np.sqrt(best / whole)),
        "last_singular_value": float(exact[len(modes) - 1] / exact[0]),
    }  # fmt: skip
    if values is not None:
        result["singular_values_off"] = float(np.abs(values / exact[: len(values)] - 1).max())
    return result


def main() -> None:
    """Write the files, measure in a process of its own, and keep what it says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=46, help="nodes along an edge")
    parser.add_argument("--snapshots", type=int, default=10_000)
    parser.add_argument("--modes", type=int, default=100)
    parser.add_argument("--method", choices=("strain", "displacement"), default="strain")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "palpate_out_of_core")
    parser.add_argument("--inside", action="store_true", help="measure in this process, and print only JSON")
    chosen = parser.parse_args()
    points = pt.box((0.1, 0.1, 0.1), 0.1 / (chosen.side - 1)).points
    if chosen.inside:
        files = write(points, chosen.snapshots, chosen.folder)
        print(json.dumps(measured(chosen.side, chosen.modes, chosen.method, files)))
        return
    start = perf_counter()
    files = write(points, chosen.snapshots, chosen.folder)
    size = sum(file.stat().st_size for file in files) / 1e9
    print(f"{len(files)} files of {size:.1f} GB written in {perf_counter() - start:.0f} s", flush=True)
    command = [sys.executable, __file__, *sys.argv[1:], "--inside"]
    entry = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    print(json.dumps(entry, indent=1))
    result_files.write("out_of_core", [*result_files.read("out_of_core", []), entry])


if __name__ == "__main__":
    main()
