"""Measured curves from CSV files with units.

    # Where the curve comes from: lines with # are kept as its source.
    # kind: uniaxial
    stretch [-], nominal stress [kPa]
    1.00, 0.00
    1.10, 0.61

The kind of a single curve is on a comment line. In a file of several curves, the columns `kind` and
`curve` identify the curve of a row.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import read_text, shortened
from palpate.tissue.measurements import Measurement

KIND_BY_WORD = {
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
RATIO_UNITS = {"-": 1.0, "1": 1.0, "m/m": 1.0, "mm/mm": 1.0, "%": 0.01}
STRESS_UNITS = {
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "N/m^2": 1.0,
    "N/cm^2": 1e4,
    "N/mm^2": 1e6,
    "kgf/cm^2": 98066.5,  # of standard gravity
    "psi": 6894.757293168,
}
QUANTITY_BY_COLUMN = {  # name: quantity and units
    "stretch": ("stretch", RATIO_UNITS),
    "strain": ("strain", RATIO_UNITS),
    "engineering strain": ("strain", RATIO_UNITS),
    "nominal strain": ("strain", RATIO_UNITS),
    "logarithmic strain": ("logarithmic strain", RATIO_UNITS),
    "true strain": ("logarithmic strain", RATIO_UNITS),
    "shear": ("shear", RATIO_UNITS),
    "shear strain": ("shear", RATIO_UNITS),
    "nominal stress": ("stress", STRESS_UNITS),
    "engineering stress": ("stress", STRESS_UNITS),
    "standard deviation": ("deviation", STRESS_UNITS),
}
TEXT_COLUMNS = ("kind", "curve")  # columns without a unit
DEFORMATION_QUANTITIES = ("stretch", "strain", "logarithmic strain", "shear")
CAUCHY_COLUMNS = ("true stress", "cauchy stress")
HEADER_PATTERN = re.compile(r"(?P<name>[^\[\]]*)(?:\[(?P<unit>[^\[\]]*)\])?")
LINE_PATTERN = re.compile(r"\r\n|\r|\n")  # only these: a form feed in a comment does not end a line
NUMBER_PATTERN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
MAX_LINE_CHARACTERS = 10_000
MAX_CURVES = 1000
MAX_NUMBER = 1e30  # squares of larger numbers overflow
CONTROL_PATTERN = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")


@dataclass(frozen=True)
class _Column:
    role: str
    factor: float
    label: str


def read_measurements(path: str | PathLike[str]) -> list[Measurement]:
    r"""Read measured curves from a CSV file.

    Columns are separated by commas, semicolons or tabs. The first line that is not a comment holds
    their names, with units in brackets. One column is the deformation: ``stretch``, ``strain``
    (``engineering strain``, ``nominal strain``: stretch - 1), ``logarithmic strain`` (``true
    strain``) or ``shear`` (``shear strain``), in ``-`` or ``%``. One is the force per undeformed
    area: ``nominal stress`` or ``engineering stress``, in Pa, kPa, MPa, N/m^2, N/cm^2, N/mm^2,
    kgf/cm^2 or psi. ``standard deviation`` of the stress is optional. The kind, on a line ``# kind:
    ...`` or in a column ``kind``, is uniaxial (tension, compression), equibiaxial (biaxial), planar
    (pure shear) or shear (simple shear). Strains and stresses of ``compression`` may be positive
    numbers.

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
        The file is not a regular text file in UTF-8; a kind, column or unit is unknown; a column is
        missing or repeated; a row has the wrong length or more than 10,000 characters; there are
        more than 1,000 curves; a cell is not a finite decimal number; or a curve is not a valid
        `Measurement`. The message names file and line.
    FileNotFoundError
        The file does not exist.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> path = Path(tempfile.mkdtemp()) / "curve.csv"
    >>> _ = path.write_text("# kind: uniaxial\nstretch [-],nominal stress [kPa]\n1.0,0\n1.1,1.4\n1.2,2.6\n")
    >>> curves = pt.io.read_measurements(path)
    >>> curves[0].kind, curves[0].stress.tolist()
    ('uniaxial', [0.0, 1400.0, 2600.0])
    """
    path = Path(path)
    lines = LINE_PATTERN.split(read_text(path, "table of measured curves"))
    for i, line in enumerate(lines, 1):
        if CONTROL_PATTERN.search(line):
            raise FileFormatError(f"{path}, line {i} must not hold control characters; save it as plain text")
    comments = [line.lstrip().lstrip("#").strip() for line in lines if line.lstrip().startswith("#")]
    rows = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise FileFormatError(f"{path} must have a header, got none; name the columns with units in the first line")
    separator = next((one for one in ("\t", ";", ",") if one in rows[0][1]), ",")
    where = f"{path}, line {rows[0][0]}"
    headers = _cells(rows[0][1], separator, where)
    if len(headers) > len(QUANTITY_BY_COLUMN) + len(TEXT_COLUMNS):
        raise FileFormatError(
            f"{where} must have at most {len(QUANTITY_BY_COLUMN) + len(TEXT_COLUMNS)} columns, got {len(headers)}"
        )
    columns = [_column(header, where) for header in headers]
    _check_roles(columns, where)
    table = [(i, _cells(line, separator, f"{path}, line {i}")) for i, line in rows[1:]]
    kinds = [line.partition(":")[2].strip() for line in comments if line.lower().startswith("kind:")]
    source = "\n".join(line for line in comments if line and not line.lower().startswith("kind:"))
    if len(set(kinds)) > 1:
        raise FileFormatError(f"{path} must have one line '# kind:', got {len(kinds)}; use a column 'kind' instead")
    return _curves(path, columns, table, kinds[0] if kinds else None, source)


def _cells(line: str, separator: str, where: str) -> list[str]:
    """Return the cells of a line."""
    if len(line) > MAX_LINE_CHARACTERS:
        raise FileFormatError(f"{where} must have at most {MAX_LINE_CHARACTERS} characters, got {len(line)}")
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, strict=True))]
    except csv.Error as error:
        raise FileFormatError(f"{where} must be valid CSV ({error}); close every quotation mark") from None


def _column(header: str, where: str) -> _Column:
    match = HEADER_PATTERN.fullmatch(header)
    name = (match["name"] if match else header).strip().lower()
    unit = match["unit"].strip() if match and match["unit"] is not None else None
    if name in TEXT_COLUMNS:
        return _Column(name, 1.0, name)
    if name in CAUCHY_COLUMNS:
        raise FileFormatError(
            f"{where}: stress must be per undeformed area, got {name!r}; give 'nominal stress' (at constant volume the "
            "true stress over the stretch in the machine's direction)"
        )
    if name not in QUANTITY_BY_COLUMN:
        allowed = ", ".join([*QUANTITY_BY_COLUMN, *TEXT_COLUMNS])
        raise FileFormatError(f"{where}: a column must be one of {allowed}, got {shortened(header)!r}")
    role, units = QUANTITY_BY_COLUMN[name]
    if unit not in units:
        got = "none" if unit is None else repr(shortened(unit))
        allowed = ", ".join(f"[{u}]" for u in units)
        raise FileFormatError(f"{where}: the unit of column {name!r} must be one of {allowed}, got {got}")
    return _Column(role, units[unit], name)


def _check_roles(columns: list[_Column], where: str) -> None:
    roles = [column.role for column in columns]
    for role in roles:
        if roles.count(role) > 1:
            raise FileFormatError(f"{where}: there must be one column of {role}, got {roles.count(role)}")
    deformations = [role for role in roles if role in DEFORMATION_QUANTITIES]
    if len(deformations) != 1:
        got = " and ".join(deformations) or "none"
        raise FileFormatError(
            f"{where}: one column must be the deformation ({', '.join(DEFORMATION_QUANTITIES)}), got {got}"
        )
    if "stress" not in roles:
        raise FileFormatError(f"{where}: one column must be the stress, got none; add 'nominal stress [kPa]'")


def _curves(
    path: Path, columns: list[_Column], rows: list[tuple[int, list[str]]], kind: str | None, source: str
) -> list[Measurement]:
    if kind is None and all(column.role != "kind" for column in columns):
        raise FileFormatError(
            f"{path} must have a kind of test, got none; add a line '# kind: uniaxial', or a column 'kind'"
        )
    curves: dict[tuple[str, str], list[tuple[int, dict[str, float]]]] = {}
    for line, cells in rows:
        if len(cells) != len(columns):
            raise FileFormatError(
                f"{path}, line {line} must have {len(columns)} cells, as the header, got {len(cells)}"
            )
        words = {c.role: cell for c, cell in zip(columns, cells, strict=True) if c.role in TEXT_COLUMNS}
        numbers = {
            c.role: c.factor * _number(cell, c.label, path, line)
            for c, cell in zip(columns, cells, strict=True)
            if c.role not in TEXT_COLUMNS
        }
        label = words.get("kind", kind or "").lower()
        if label not in KIND_BY_WORD:
            allowed = ", ".join(KIND_BY_WORD)
            raise FileFormatError(f"{path}, line {line}: kind must be one of {allowed}, got {shortened(label)!r}")
        curves.setdefault((label, words.get("curve", "")), []).append((line, numbers))
    if not curves:
        raise FileFormatError(f"{path} must have rows below its header, got none")
    if len(curves) > MAX_CURVES:
        raise FileFormatError(f"{path} must have at most {MAX_CURVES} curves, got {len(curves)}")
    return [_measurement(path, label, name, points, source) for (label, name), points in curves.items()]


def _number(cell: str, column: str, path: Path, line: int) -> float:
    number = float(cell) if NUMBER_PATTERN.fullmatch(cell) else math.nan
    if not math.isfinite(number):
        raise FileFormatError(f"{path}, line {line}: {column} must be a finite number, got {shortened(cell)!r}")
    if abs(number) > MAX_NUMBER:
        raise FileFormatError(f"{path}, line {line}: {column} must be at most {MAX_NUMBER:g}, got {number:g}")
    return number


def _measurement(
    path: Path, label: str, name: str, points: list[tuple[int, dict[str, float]]], source: str
) -> Measurement:
    columns = {role: np.array([numbers[role] for _, numbers in points]) for role in points[0][1]}
    lines = f"{path}, lines {points[0][0]} to {points[-1][0]}"
    role = next(role for role in DEFORMATION_QUANTITIES if role in columns)
    if (role == "shear") != (KIND_BY_WORD[label] == "shear"):
        raise FileFormatError(f"{lines}: a test of kind {label!r} must not have a column of {role}")
    deformation, stress = columns[role], columns["stress"]
    if label == "compression":
        deformation, stress = _compression_signs(role, deformation, stress, lines)
    if role == "strain":
        deformation = 1 + deformation
    elif role == "logarithmic strain":
        deformation = np.exp(np.minimum(deformation, np.log(MAX_NUMBER)))
    try:
        return Measurement(
            kind=KIND_BY_WORD[label],
            deformation=deformation,
            stress=stress,
            deviation=columns.get("deviation", 1.0),
            name=f"{label} {name}".strip(),
            source=source,
        )
    except InputError as error:
        raise FileFormatError(f"{lines}: {error}") from error


def _compression_signs(
    role: str, deformation: np.ndarray, stress: np.ndarray, lines: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return deformation and stress of a compression, negative in compression."""
    if role == "stretch":
        if np.any(deformation > 1):
            raise FileFormatError(f"{lines}: stretch must be in (0, 1] in compression, got {deformation.max():g}")
    elif np.all(deformation >= 0):
        deformation = -deformation
    elif np.any(deformation > 0):
        raise FileFormatError(f"{lines}: {role} must have one sign in compression, got both")
    return deformation, -stress if np.sum(stress) > 0 else stress
