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
import math
import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from palpate.faults import FileFormatError, InputError
from palpate.files import read_text, shortened
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
HEADER = re.compile(r"(?P<name>[^\[\]]*)(?:\[(?P<unit>[^\[\]]*)\])?")
LINE = re.compile(r"\r\n|\r|\n")  # and no other: a form feed in a comment ends no line
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
LONGEST_LINE = 10_000  # characters
MOST_CURVES = 1000
LARGEST = 1e30  # size of a number; the squares of larger ones overflow
CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")


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
        Not a regular file of text in UTF-8; an unknown kind, column or unit, a column missing or there twice, a row of
        the wrong length or of more than 10,000 characters, more than 1,000 curves, a cell that is not a finite decimal
        number, or a curve that `Measurement` refuses: names the file, the line and what is allowed.
    FileNotFoundError
        There is no such file.
    """
    path = Path(path)
    lines = LINE.split(read_text(path, "table of measured curves"))
    for i, line in enumerate(lines, 1):
        if CONTROL.search(line):
            raise FileFormatError(f"{path}, line {i} has a control character; save it as plain text")
    comments = [line.lstrip().lstrip("#").strip() for line in lines if line.lstrip().startswith("#")]
    rows = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise FileFormatError(f"{path} has no header: its first line names the columns with units")
    separator = next((one for one in ("\t", ";", ",") if one in rows[0][1]), ",")
    where = f"{path}, line {rows[0][0]}"
    headers = _cells(rows[0][1], separator, where)
    if len(headers) > len(COLUMNS) + len(WORDS):
        raise FileFormatError(f"{where} has {len(headers)} columns: allowed are {len(COLUMNS) + len(WORDS)}")
    columns = [_column(header, where) for header in headers]
    _check_roles(columns, where)
    table = [(i, _cells(line, separator, f"{path}, line {i}")) for i, line in rows[1:]]
    kinds = [line.partition(":")[2].strip() for line in comments if line.lower().startswith("kind:")]
    source = "\n".join(line for line in comments if line and not line.lower().startswith("kind:"))
    if len(set(kinds)) > 1:
        raise FileFormatError(f"{path} has {len(kinds)} lines '# kind:': allowed is one; else give a column 'kind'")
    return _curves(path, columns, table, kinds[0] if kinds else None, source)


def _cells(line: str, separator: str, where: str) -> list[str]:
    """Return the cells of a line."""
    if len(line) > LONGEST_LINE:
        raise FileFormatError(f"{where} has {len(line)} characters: allowed are {LONGEST_LINE}")
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, strict=True))]
    except csv.Error as error:
        raise FileFormatError(f"{where} cannot be read as cells ({error}); close every quotation mark") from None


def _column(header: str, where: str) -> _Column:
    match = HEADER.fullmatch(header)
    name = (match["name"] if match else header).strip().lower()
    unit = match["unit"].strip() if match and match["unit"] is not None else None
    if name in WORDS:
        return _Column(name, 1.0, name)
    if name in CAUCHY:
        raise FileFormatError(
            f"{where}: {name!r} is force per deformed area; give 'nominal stress', force per undeformed area "
            "(the true stress over the stretch in the machine's direction, where the volume stays)"
        )
    if name not in COLUMNS:
        allowed = ", ".join([*COLUMNS, *WORDS])
        raise FileFormatError(f"{where}: column {shortened(header)!r} is unknown: allowed are {allowed}")
    role, units = COLUMNS[name]
    if unit not in units:
        said = "has no unit" if unit is None else f"has the unknown unit {shortened(unit)!r}"
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
            c.role: c.factor * _number(cell, c.label, path, line)
            for c, cell in zip(columns, cells, strict=True)
            if c.role not in WORDS
        }
        label = words.get("kind", kind or "").lower()
        if label not in KINDS:
            allowed = ", ".join(KINDS)
            raise FileFormatError(f"{path}, line {line}: kind {shortened(label)!r} is unknown: allowed are {allowed}")
        curves.setdefault((label, words.get("curve", "")), []).append((line, numbers))
    if not curves:
        raise FileFormatError(f"{path} has no rows below its header")
    if len(curves) > MOST_CURVES:
        raise FileFormatError(f"{path} has {len(curves)} curves: allowed are {MOST_CURVES}")
    return [_measurement(path, label, name, points, source) for (label, name), points in curves.items()]


def _number(cell: str, column: str, path: Path, line: int) -> float:
    number = float(cell) if NUMBER.fullmatch(cell) else math.nan
    if not math.isfinite(number):
        said = shortened(cell)
        raise FileFormatError(f"{path}, line {line}: {column} = {said!r} is not a finite number, such as 1.25")
    if abs(number) > LARGEST:
        raise FileFormatError(f"{path}, line {line}: {column} = {number:g} is out of range: allowed is to {LARGEST:g}")
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
        deformation = np.exp(np.minimum(deformation, np.log(LARGEST)))
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
