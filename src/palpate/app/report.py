"""The report of a study: numbers for machines, and the paper's claims beside them."""

from __future__ import annotations

import math
import os
import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate import __version__

if TYPE_CHECKING:
    from palpate.app.reproduce import Study

__all__ = ["build_report", "tip_displacement"]

PACKAGES = ("numpy", "scipy", "numba", "h5py", "matplotlib", "pyvista", "vtk")
SLIGHT = 0.1  # share of the whole decrease of the error that may still come after 8 modes
NEARLY_LINEAR = 0.9  # coefficient of determination
NEAR = 1.5  # at most this many times the printed ratio of times still is its "almost" or "around"


def build_report(study: Study) -> dict[str, Any]:
    """Return the report of a study: only what JSON can hold, in SI units.

    Parameters
    ----------
    study : Study

    Returns
    -------
    dict
    """
    scene, full = study.scene, study.full
    report = {
        "title": scene.title,
        "parameters": dict(scene.parameters) | {"duration": scene.duration, "every": scene.every},
        "nodes": len(scene.model.cloud),
        "machine": _machine(),
        "stability": asdict(scene.model.stability),
        "full": _full_run(study),
        "pod_seconds": study.pod_seconds,
        "singular_values": study.basis.singular_values.tolist(),
        "snapshots": len(full.times),
        "reduced": study.reduced,
        "paper": _claims({entry["modes"]: entry for entry in study.reduced if not entry["failed"]}),
    }
    return {name: _finite(value) for name, value in report.items()}


def tip_displacement(study: Study, run: Any) -> Any:
    """Return the mean axial displacement [m] of the pulled end over a run, shape (f,)."""
    nodes = study.scene.model.cloud.group("x+")
    return run.displacements[:, nodes, 0].mean(axis=1)


def _machine() -> dict[str, Any]:
    import numba

    versions = {"palpate": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "versions": versions,
        "system": f"{platform.system()} {platform.machine()}",
        "cpu_count": os.cpu_count(),
        "threads": numba.get_num_threads(),
    }


def _full_run(study: Study) -> dict[str, Any]:
    full, scene = study.full, study.scene
    tip = tip_displacement(study, full)
    peak, middle = int(np.argmax(np.abs(tip))), int(np.argmin(np.abs(full.times - scene.duration / 2)))
    force = scene.loads[0].force  # type: ignore[union-attr]
    return {
        "wall_seconds": full.wall_seconds,
        "real_time_factor": scene.duration / full.wall_seconds,
        "steps": int(full.steps[-1]),
        "viscosity": full.viscosity,
        "peak_tip_displacement": float(tip[peak]),
        "peak_tip_time": float(full.times[peak]),
        "energy_balance": float(np.abs(full.balance).max() / np.abs(full.external).max()),
        "load_at_peak": float(force(full.times[middle])[0]) if callable(force) else math.nan,
        "reaction_at_peak": float(-full.reactions["x-"][middle, 0]),
    }


def _claims(done: dict[int, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the paper's claims, what stands against them here, and whether they hold; None where it was not run."""
    claims = [
        _error_at_six(done.get(6)),
        _slight_after_eight(done),
        _linear_time(done),
        _ratio(done.get(2), 2, 0.01, "almost 1 % of the full model's time with 2 modes"),
        _ratio(done.get(8), 8, 0.03, "around 3 % of the full model's time with 8 modes"),
    ]
    return [dict(zip(("figure", "claim", "here", "holds"), claim, strict=True)) for claim in claims]


Claim = tuple[str, str, str, bool | None]


def _error_at_six(entry: dict[str, Any] | None) -> Claim:
    claim = "displacement error below 3 % with 6 modes"
    if entry is None:
        return "Figure 3", claim, "not run with 6 modes", None
    error = entry["errors"]["displacement"]
    return "Figure 3", claim, f"{error:.3%}", error < 0.03


def _slight_after_eight(done: dict[int, dict[str, Any]]) -> Claim:
    claim = "the error decreases only slightly after 8 modes"
    if 8 not in done or len(done) < 3 or max(done) == 8 or min(done) == 8:
        return "Figure 3", claim, "needs fewer modes, 8, and more", None
    first, eight, last = (done[m]["errors"]["displacement"] for m in (min(done), 8, max(done)))
    here = f"{first:.3%} with {min(done)}, {eight:.3%} with 8, {last:.3%} with {max(done)}"
    return "Figure 3", claim, here, eight - last <= SLIGHT * (first - last)


def _linear_time(done: dict[int, dict[str, Any]]) -> Claim:
    claim = "the time grows almost linearly with the modes"
    if len(done) < 3:
        return "Figure 4", claim, "needs three sizes", None
    sizes, seconds = np.array(list(done), dtype=float), np.array([entry["wall_seconds"] for entry in done.values()])
    line = np.polynomial.Polynomial.fit(sizes, seconds, 1)
    spread = np.sum((seconds - seconds.mean()) ** 2)
    fit = float(1 - np.sum((seconds - line(sizes)) ** 2) / spread) if spread > 0 else 1.0
    slope = float(line.convert().coef[-1])
    return "Figure 4", claim, f"{slope:.3g} s a mode, R^2 = {fit:.3f}", fit > NEARLY_LINEAR and slope > 0


def _ratio(entry: dict[str, Any] | None, size: int, printed: float, claim: str) -> Claim:
    if entry is None:
        return "Figure 5", claim, f"not run with {size} modes", None
    return "Figure 5", claim, f"{entry['ratio']:.2%}", entry["ratio"] <= NEAR * printed


def _finite(value: Any) -> Any:
    """Replace numbers that JSON cannot hold by None, and NumPy's numbers by Python's."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
