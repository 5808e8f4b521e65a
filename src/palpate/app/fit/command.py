"""``palpate fit``: find the parameters of a law from measured curves, with a report and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from palpate.app.common.console import Console, Table, quantities_table
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.app.fit.figure import draw_fit
from palpate.core.extras import require
from palpate.core.faults import InputError, integer_in_range
from palpate.core.files import check_folder, plain
from palpate.tissue.catalogue import law_class
from palpate.tissue.fitting import Fit, fit
from palpate.tissue.materials import Material
from palpate.tissue.measurement_files import read_measurements
from palpate.tissue.measurements import Measurement
from palpate.tissue.parameters import field_metadata, is_sequence, own_fields

FILES = (*REPORTS, "fit.png")
MAX_STARTS = 1000


def fit_law(
    *,
    law: str,
    data: Sequence[Path],
    start: Sequence[str] = (),
    bounds: Sequence[str] = (),
    fixed: Sequence[str] = (),
    starts: int = 8,
    seed: int = 0,
    density: float = 1060.0,
    poisson: float = 0.5,
    out: Path,
    as_json: bool = False,
) -> int:
    """Fit a law to the curves of CSV files and leave a report and a picture in a folder.

    `law` is a name, whatever its case, with or without hyphens. Entries of `start` are, for example, ``"C1=1e3"`` or
    ``"alpha=2,-2"``, of `bounds` ``"C1=10,1e5"``, and of `fixed` ``"C2=0"``. The rest is as for
    `palpate.tissue.fitting.fit`.
    """
    kind, starts = law_class(law), integer_in_range("starts", starts, 1, MAX_STARTS)
    curves = [_with_file_name(curve, path, len(data)) for path in data for curve in read_measurements(path)]
    require("matplotlib", "palpate fit")
    check_folder(out)
    with Console().status(f"fitting {kind.__name__} to {len(curves)} curve{'' if len(curves) == 1 else 's'}"):
        fitted = fit(
            kind,
            curves,
            start=_law_arguments(kind, _numbers("start", start)),
            bounds=_pairs(_numbers("bounds", bounds)),
            fixed=_law_arguments(kind, _numbers("fix", fixed)),
            starts=starts,
            seed=seed,
            density=density,
            poisson=poisson,
        )
        report = plain(_report(fitted, data))
    out.mkdir(parents=True, exist_ok=True)
    draw_fit(fitted, out / "fit.png")
    deliver(report, _tables(fitted), out, FILES, as_json)
    return 0


def _numbers(option: str, assignments: Sequence[str]) -> dict[str, list[float]]:
    """Return numbers by name from words such as ``alpha=2,-2``."""
    numbers = {}
    for word in assignments:
        name, equals, values = word.partition("=")
        try:
            numbers[name.strip()] = [float(value) for value in values.split(",")]
        except ValueError:
            equals = ""
        if not equals or not name.strip():
            raise InputError(
                f"--{option} must be NAME=NUMBER, or several numbers with commas between, got {word!r:.60}"
            )
    return numbers


def _pairs(numbers: dict[str, list[float]]) -> dict[str, tuple[float, float]]:
    for name, values in numbers.items():
        if len(values) != 2:
            raise InputError(f"--bounds {name} must be two numbers, NAME=LOW,HIGH, got {len(values)}")
    return {name: (values[0], values[1]) for name, values in numbers.items()}


def _law_arguments(law: type[Material], parameters: dict[str, list[float]]) -> dict[str, float | tuple[float, ...]]:
    """Return a number for a field that is one, a sequence for a field of several; `fit` refuses unknown names."""
    single = {
        name
        for name in parameters
        if len(parameters[name]) == 1 and not (name in own_fields(law) and is_sequence(law, name))
    }
    return {name: values[0] if name in single else tuple(values) for name, values in parameters.items()}


def _with_file_name(curve: Measurement, path: Path, files: int) -> Measurement:
    return curve if files == 1 else replace(curve, name=f"{path.stem}, {curve.name}")


def _report(fitted: Fit, data: Sequence[Path]) -> dict[str, Any]:
    material, errors = fitted.material, fitted.standard_errors
    return {
        "title": f"{type(material).__name__} fitted to measured curves",
        "law": type(material).__name__,
        "parameters": {name: {"value": v, "standard_error": errors[name]} for name, v in fitted.parameters.items()},
        "material": asdict(material),
        "shear_modulus": material.shear_modulus,
        "covariance": fitted.covariance.tolist(),
        "condition": fitted.condition,
        "curves": [asdict(curve) for curve in fitted.curves],
        "starts": [asdict(start) for start in fitted.starts],
        "remarks": fitted.remarks,
        "stability": asdict(fitted.stability) | {"text": fitted.stability.text},
        "data": [str(path) for path in data],
        "sources": sorted({m.source for m in fitted.measurements if m.source}),
        "machine": machine(),
    }


def _tables(fitted: Fit) -> list[Table | str]:
    errors, material = fitted.standard_errors, fitted.material
    law = type(material)
    units = {name: field_metadata(law, name).get("unit", "") for name in fitted.parameters}
    rows = {
        f"{name} [{units[name]}]" if units[name] else name: [f"{value:.5g}", f"{errors[name]:.2g}"]
        for name, value in fitted.parameters.items()
    }
    curves = {c.name: [str(c.points), f"{c.rms / 1e3:.3g}", f"{c.r_squared:.5f}"] for c in fitted.curves}
    costs = ", ".join(f"{start.cost / fitted.starts[0].cost:.4g}" for start in fitted.starts)
    return [
        quantities_table(law.__name__, ["value", "standard error"], rows, first="parameter"),
        quantities_table("Curves", ["points", "rms [kPa]", "R^2"], curves, first="curve"),
        f"Poisson's ratio {material.poisson:g}, shear modulus at rest {material.shear_modulus:.4g} Pa",
        f"cost of each start over the least: {costs}",
        *(f"note: {remark}" for remark in fitted.remarks),
        fitted.stability.text,
    ]
