"""Measured curves from CSV files with units.

    # Where the curve comes from: lines with # are kept as its source.
    # kind: uniaxial
    stretch [-], nominal stress [kPa]
    1.00, 0.00
    1.10, 0.61

A file has one curve, its kind on a comment line, or several: then a column `kind` says which curve a row belongs to,
and a column `curve` tells several curves of one kind apart.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from palpate.faults import FileFormatError, InputError
from palpate.tissue.measurements import Measurement

__all__ = ["read_measurements"]

KINDS = {
    "uniaxial": "uniaxial",
    "tension": "uniaxial",
    "compression": "uniaxial",
    "equibiaxial": "equibiaxial",
    "biaxial": "equibiaxial",
    "planar": "planar",
    "pure shear": "planar",
    "shear": "shear",
    "simple shear": "shear",
}
RATIOS = {"-": 1.0, "1": 1.0, "m/m": 1.0, "mm/mm": 1.0, "%": 0.01}
STRESSES = {
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "N/m^2": 1.0,
    "N/cm^2": 1e4,
    "N/mm^2": 1e6,
    "kgf/cm^2": 98066.5,  # of standard gravity
    "psi": 6894.757293168,
}
COLUMNS = {  # name: what it is and its units
    "stretch": ("stretch", RATIOS),
    "strain": ("strain", RATIOS),
    "engineering strain": ("strain", RATIOS),
    "nominal strain": ("strain", RATIOS),
    "logarithmic strain": ("logarithmic strain", RATIOS),
    "true strain": ("logarithmic strain", RATIOS),
    "shear": ("shear", RATIOS),
    "shear strain": ("shear", RATIOS),
    "nominal stress": ("stress", STRESSES),
    "engineering stress": ("stress", STRESSES),
    "standard deviation": ("deviation", STRESSES),
}
WORDS = ("kind", "curve")  # columns without a unit
DEFORMATIONS = ("stretch", "strain", "logarithmic strain", "shear")
CAUCHY = ("true stress", "cauchy stress")
HEADER = re.compile(r"^\s*(?P<name>[^\[\]]*?)\s*(?:\[\s*(?P<unit>[^\[\]]*?)\s*\])?\s*$")


@dataclass(frozen=True)
class _Column:
    role: str
    factor: float
    label: str


def read_measurements(path: str | PathLike[str]) -> list[Measurement]:
    """Read the curves of a CSV file.

    Columns are separated by commas, semicolons or tabs, named in the first line that is no comment, with their unit in
    brackets. One gives the deformation: ``stretch``, ``strain`` (``engineering strain``, ``nominal strain``: stretch
    - 1), ``logarithmic strain`` (``true strain``) or ``shear`` (``shear strain``), in ``-`` or ``%``. One gives the
    force per undeformed area: ``nominal stress`` or ``engineering stress``, in Pa, kPa, MPa, N/m^2, N/cm^2, N/mm^2,
    kgf/cm^2 or psi. ``standard deviation`` of the stress may follow. The kind, on a line ``# kind: ...`` or in a
    column ``kind``, is uniaxial (tension, compression), equibiaxial (biaxial), planar (pure shear) or shear (simple
    shear). Under ``compression`` strains and stresses may be given as positive numbers.

    Parameters
    ----------
    path : path

    Returns
    -------
    list of Measurement
        Stretches, and stresses in Pa.

    Raises
    ------
    FileFormatError
        An unknown kind, column or unit, a column missing or there twice, a row of the wrong length, a cell that is not
        a finite number, or a curve that `Measurement` refuses: names the file, the line and what is allowed.
    FileNotFoundError
        There is no such file.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise FileFormatError(f"{path} is not a text file in UTF-8") from None
    comments = [line.lstrip().lstrip("#").strip() for line in lines if line.lstrip().startswith("#")]
    rows = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise FileFormatError(f"{path} has no header: its first line names the columns with units")
    separator = next((one for one in ("\t", ";", ",") if one in rows[0][1]), ",")
    table = [(i, [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]) for i, line in rows]
    where = f"{path}, line {rows[0][0]}"
    columns = [_column(header, where) for header in table[0][1]]
    _check_roles(columns, where)
    kinds = [line.partition(":")[2].strip() for line in comments if line.lower().startswith("kind:")]
    source = "\n".join(line for line in comments if line and not line.lower().startswith("kind:"))
    return _curves(path, columns, table[1:], kinds[0] if kinds else None, source)


def _column(header: str, where: str) -> _Column:
    match = HEADER.match(header)
    name, unit = (match["name"].lower(), match["unit"]) if match else (header.lower(), None)
    if name in WORDS:
        return _Column(name, 1.0, name)
    if name in CAUCHY:
        raise FileFormatError(
            f"{where}: {name!r} is force per deformed area; give 'nominal stress', force per undeformed area "
            "(the true stress over the stretch in the machine's direction, where the volume stays)"
        )
    if name not in COLUMNS:
        raise FileFormatError(f"{where}: column {header!r} is unknown: allowed are {', '.join([*COLUMNS, *WORDS])}")
    role, units = COLUMNS[name]
    if unit not in units:
        said = "has no unit" if unit is None else f"has the unknown unit {unit!r}"
        raise FileFormatError(f"{where}: column {name!r} {said}: allowed are {', '.join(f'[{u}]' for u in units)}")
    return _Column(role, units[unit], name)


def _check_roles(columns: list[_Column], where: str) -> None:
    roles = [column.role for column in columns]
    for role in roles:
        if roles.count(role) > 1:
            raise FileFormatError(f"{where}: there are {roles.count(role)} columns of {role}: allowed is one")
    deformations = [role for role in roles if role in DEFORMATIONS]
    if len(deformations) != 1:
        found = " and ".join(deformations) or "none"
        raise FileFormatError(f"{where}: one column gives the deformation ({', '.join(DEFORMATIONS)}), not {found}")
    if "stress" not in roles:
        raise FileFormatError(f"{where}: there is no column of stress: 'nominal stress [kPa]', or another unit")


def _curves(
    path: Path, columns: list[_Column], rows: list[tuple[int, list[str]]], kind: str | None, source: str
) -> list[Measurement]:
    if kind is None and all(column.role != "kind" for column in columns):
        raise FileFormatError(f"{path} says no kind of test: give a line '# kind: uniaxial', or a column 'kind'")
    curves: dict[tuple[str, str], list[tuple[int, dict[str, float]]]] = {}
    for line, cells in rows:
        if len(cells) != len(columns):
            raise FileFormatError(f"{path}, line {line} has {len(cells)} cells: the header has {len(columns)}")
        words = {c.role: cell for c, cell in zip(columns, cells, strict=True) if c.role in WORDS}
        numbers = {
            c.role: c.factor * _number(cell, c.label, f"{path}, line {line}")
            for c, cell in zip(columns, cells, strict=True)
            if c.role not in WORDS
        }
        label = words.get("kind", kind or "").lower()
        if label not in KINDS:
            raise FileFormatError(f"{path}, line {line}: kind {label!r} is unknown: allowed are {', '.join(KINDS)}")
        curves.setdefault((label, words.get("curve", "")), []).append((line, numbers))
    if not curves:
        raise FileFormatError(f"{path} has no rows below its header")
    return [_measurement(path, label, name, points, source) for (label, name), points in curves.items()]


def _number(cell: str, column: str, where: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise FileFormatError(f"{where}: {column} = {cell!r} is not a finite number, such as 1.25")
    return number


def _measurement(
    path: Path, label: str, name: str, points: list[tuple[int, dict[str, float]]], source: str
) -> Measurement:
    given = {role: np.array([numbers[role] for _, numbers in points]) for role in points[0][1]}
    lines = f"{path}, lines {points[0][0]} to {points[-1][0]}"
    role = next(role for role in DEFORMATIONS if role in given)
    if (role == "shear") != (KINDS[label] == "shear"):
        raise FileFormatError(f"{lines}: a test of kind {label!r} is not given by a column of {role}")
    deformation, stress = given[role], given["stress"]
    if label == "compression":
        deformation, stress = _downwards(role, deformation, stress, lines)
    if role == "strain":
        deformation = 1 + deformation
    elif role == "logarithmic strain":
        deformation = np.exp(deformation)
    try:
        return Measurement(
            kind=KINDS[label],
            deformation=deformation,
            stress=stress,
            deviation=given.get("deviation", 1.0),
            name=f"{label} {name}".strip(),
            source=source,
        )
    except InputError as error:
        raise FileFormatError(f"{lines}: {error}") from error


def _downwards(role: str, deformation: np.ndarray, stress: np.ndarray, lines: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the deformation and the stress of a compression with the signs of mechanics."""
    if role == "stretch":
        if np.any(deformation > 1):
            raise FileFormatError(f"{lines}: stretch = {deformation.max():g} is no compression: allowed is (0, 1]")
    elif np.all(deformation >= 0):
        deformation = -deformation
    elif np.any(deformation > 0):
        raise FileFormatError(f"{lines}: {role} changes its sign: a compression has one")
    return deformation, -stress if np.sum(stress) > 0 else stress
