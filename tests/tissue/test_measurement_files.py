"""Measured curves and the CSV files they come from."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.tissue.measurement_files import read_measurements
from palpate.tissue.measurements import Measurement

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def read(tmp_path):
    """A function that reads a file of some text."""

    def reading(text):
        path = tmp_path / "curve.csv"
        path.write_text(text, encoding="utf-8")
        return read_measurements(path)

    return reading


def test_a_file_is_read_with_its_units_and_its_source(read):
    (curve,) = read("# Doe, 2001\n# kind: uniaxial\nstretch [-], nominal stress [kPa]\n1.0, 0\n1.1, 0.61\n\n1.2,1.3\n")
    assert (curve.kind, curve.name, curve.source) == ("uniaxial", "uniaxial", "Doe, 2001")
    np.testing.assert_allclose(curve.deformation, [1.0, 1.1, 1.2], rtol=1e-15)
    np.testing.assert_allclose(curve.stress, [0.0, 610.0, 1300.0], rtol=1e-15)
    np.testing.assert_array_equal(curve.deviation, 1.0)


@pytest.mark.parametrize(
    ("unit", "pascals"),
    [
        ("Pa", 1.0),
        ("kPa", 1e3),
        ("MPa", 1e6),
        ("N/m^2", 1.0),
        ("N/cm^2", 1.0 / 0.01**2),
        ("N/mm^2", 1.0 / 0.001**2),
        ("kgf/cm^2", 9.80665 / 0.01**2),
        ("psi", 0.45359237 * 9.80665 / 0.0254**2),
    ],
)
def test_stress_is_read_in_every_unit(read, unit, pascals):
    (curve,) = read(
        f"# kind: shear\nshear [-], engineering stress [{unit}], standard deviation [{unit}]\n0,0,2\n.2,3,4"
    )
    np.testing.assert_allclose(curve.stress, [0, 3 * pascals], rtol=1e-12)
    np.testing.assert_allclose(curve.deviation, [2 * pascals, 4 * pascals], rtol=1e-12)


@pytest.mark.parametrize(
    ("column", "cells"),
    [
        ("stretch [-]", ("0.8", "0.9")),
        ("stretch [%]", ("80", "90")),
        ("strain [%]", ("-20", "-10")),
        ("Engineering Strain [mm/mm]", ("-0.2", "-0.1")),
        ("true strain [-]", (str(np.log(0.8)), str(np.log(0.9)))),
    ],
)
def test_deformation_is_read_in_every_measure_as_a_stretch(read, column, cells):
    (curve,) = read(f"# kind: uniaxial\n{column}; nominal stress [Pa]\n{cells[0]}; -3\n{cells[1]}; -1\n")
    np.testing.assert_allclose(curve.deformation, [0.8, 0.9], rtol=1e-12)


@pytest.mark.parametrize(
    "text", ["strain [%]\tnominal stress [Pa]\n0\t0\n20\t3", "stretch [-],nominal stress [Pa]\n1,0\n0.8,3"]
)
def test_compression_may_be_given_in_positive_numbers(read, text):
    (curve,) = read(f"# kind: compression\n{text}\n")
    assert curve.kind == "uniaxial"
    np.testing.assert_allclose(curve.deformation, [1, 0.8], rtol=1e-15)
    np.testing.assert_allclose(curve.stress, [0, -3])


def test_one_file_may_hold_several_curves(read):
    curves = read(
        "kind, curve, stretch [-], nominal stress [Pa]\n"
        "tension, a, 1.1, 1\ntension, b, 1.2, 3\nbiaxial, a, 1.1, 4\ntension, a, 1.2, 2\ntension, b, 1.4, 5\n"
        "biaxial, a, 1.3, 6\n"
    )
    assert [(c.kind, c.name) for c in curves] == [
        ("uniaxial", "tension a"),
        ("uniaxial", "tension b"),
        ("equibiaxial", "biaxial a"),
    ]
    np.testing.assert_array_equal(curves[0].stress, [1, 2])
    np.testing.assert_array_equal(curves[1].deformation, [1.2, 1.4])


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.csv")), ids=lambda path: path.stem)
def test_every_example_is_read_and_has_a_source(path):
    for curve in read_measurements(path):
        assert len(curve.stress) > 10
        assert "Synthetic, not measured" in curve.source or "Trans. Faraday Soc." in curve.source


HEADER = "# kind: uniaxial\nstretch [-], nominal stress [Pa]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must have a header"),
        (
            "# kind: uniaxial\nstretch, nominal stress [Pa]\n",
            r"line 2: the unit of column 'stretch' must be one of \[-\].*, got none",
        ),
        (
            "# kind: uniaxial\nstretch [m], nominal stress [Pa]\n",
            "the unit of column 'stretch' must be one of .*, got 'm'",
        ),
        (
            "# kind: uniaxial\nstretch [-], nominal stress [bar]\n",
            r"must be one of \[Pa\], \[kPa\].*, got 'bar'",
        ),
        ("# kind: uniaxial\nstretch [-], force [N]\n", r"a column must be one of stretch, strain.*, got 'force \[N\]'"),
        ("# kind: uniaxial\nstretch [-], true stress [Pa]\n", "stress must be per undeformed area, got 'true stress'"),
        ("# kind: uniaxial\nstretch [-], strain [%], nominal stress [Pa]\n", "got stretch and strain"),
        ("# kind: uniaxial\nstretch [-], stretch [%], nominal stress [Pa]\n", "one column of stretch, got 2"),
        ("# kind: uniaxial\nnominal stress [Pa]\n", "one column must be the deformation .*, got none"),
        ("# kind: uniaxial\nstretch [-]\n", "one column must be the stress"),
        ("stretch [-], nominal stress [Pa]\n1.0, 0\n1.1, 1\n", "must have a kind of test"),
        (
            "# kind: torsion\nstretch [-], nominal stress [Pa]\n1, 0\n",
            "line 3: kind must be one of uni.*, got 'torsion'",
        ),
        (HEADER, "must have rows below its header"),
        (HEADER + "1.0, 0\n1.1\n", "line 4 must have 2 cells, as the header, got 1"),
        (HEADER + "1.0, 0\n1.1, soft\n", "line 4: nominal stress must be a finite number, got 'soft'"),
        (HEADER + "1.0, 0\n1.1, nan\n", "line 4: nominal stress must be a finite number, got 'nan'"),
        (HEADER + "1.0, 0\n-1.1, 3\n", "lines 3 to 4: stretch must be .*, got -1.1 at point 2"),
        (HEADER + "1.0, 0\n1.2, 3\n1.1, 2\n", r"stretch must be monotonic, got 1.1 at point 3 after 1.2"),
        (
            "# kind: shear\nstretch [-], nominal stress [Pa]\n1, 0\n1.1, 1\n",
            "kind 'shear' must not have a column of str",
        ),
        (
            "# kind: compression\nstretch [-], nominal stress [Pa]\n1, 0\n1.1, 1\n",
            "stretch must be in .* in compression, got 1.1",
        ),
        ("# kind: compression\nstrain [-], nominal stress [Pa]\n-.1, 0\n.1, 1\n", "strain must have one sign"),
    ],
)
def test_files_that_are_not_a_curve_are_refused_with_line_and_allowed_values(read, text, message):
    with pytest.raises(pt.FileFormatError, match=message):
        read(text)


def test_files_that_are_not_text_are_refused(tmp_path):
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(pt.FileFormatError, match="is not text in UTF-8"):
        read_measurements(tmp_path / "picture.csv")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "pull"}, "kind must be one of uniaxial, equibiaxial, planar, shear, got 'pull'"),
        ({"stress": [0.0, 1.0]}, "stress must have 3 points, as the deformation, got 2"),
        ({"stress": [0.0, np.inf, 1.0]}, "stress must be finite, got inf at point 2"),
        ({"stress": "soft"}, "stress must be an array of numbers"),
        ({"stress": [0.0, -1.0, -2.0]}, "got only stresses against the deformation"),
        ({"deformation": [1.0], "stress": [0.0]}, r"stretch must have shape .*, got \(1,\)"),
        ({"deformation": [1.0, 1.3, 1.2]}, "stretch must be monotonic, got 1.2 at point 3 after 1.3"),
        ({"deformation": [0.0, 1.1, 1.2]}, r"stretch must be in \(0, inf\), got 0 at point 1"),
        ({"deformation": [1.0, 1.0, 1.0]}, "stretch must differ from 1, the value at rest"),
        ({"deformation": [1.0, 1.1, 1e6]}, r"stretch must be in \[-20, 20\], got 1e\+06 at point 3"),
        ({"deviation": 0.0}, "deviation must be .*, got 0 at point 1"),
        ({"deviation": [1.0, 2.0, -1.0]}, "deviation must be .*, got -1 at point 3"),
    ],
)
def test_invalid_curves_are_refused(change, message):
    curve = {"kind": "uniaxial", "deformation": [1.0, 1.1, 1.2], "stress": [0.0, 1.0, 2.0]}
    with pytest.raises(pt.InputError, match=message):
        Measurement(**(curve | change))


def test_a_curve_copies_its_arrays_and_is_read_only():
    stress = np.array([0.0, 1.0])
    curve = Measurement(kind="shear", deformation=[0.0, 0.1], stress=stress)
    stress[1] = 7.0
    assert curve.stress[1] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        curve.stress[1] = 7.0


HARMFUL = {
    "a long cell": (HEADER + "1," + "9" * 200_000, "line 3 must have at most 10000 characters, got 200002"),
    "an open quotation": (HEADER + '1,"2\n3,4\n', "line 3 must be valid CSV"),
    "an infinite number": (HEADER + "1,1e999\n2,3\n", "line 3: nominal stress must be a finite number, got '1e999'"),
    "a large number": (HEADER + "1,0\n2,1e300\n", r"line 4: nominal stress must be .*, got 1e\+300"),
    "an underscore": (HEADER + "1_0,1\n2,3\n", "line 3: stretch must be a finite number, got '1_0'"),
    "wide digits": (HEADER + "1,\uff11\n2,3\n", "line 3: nominal stress must be a finite number, got '\uff11'"),
    "a hexadecimal number": (HEADER + "0x1p3,1\n2,3\n", "line 3: stretch must be a finite number, got '0x1p3'"),
    "a null byte": (HEADER + "1,0\0\n", "line 3 must not hold control characters"),
    "an escape": ("# kind: uniaxial\n# \x1b[2J\n", "line 2 must not hold control characters"),
    "many columns": (",".join(["stretch [-]"] * 1_000_000), "line 1 must have at most 10000 characters, got 11999999"),
    "columns": (",".join(["kind"] * 200), "line 1 must have at most 13 columns, got 200"),
    "many curves": (
        "kind, curve, stretch [-], nominal stress [Pa]\n"
        + "".join(f"tension, {i // 2}, {1 + i % 2}, {i % 2}\n" for i in range(10_000)),
        "must have at most 1000 curves, got 5000",
    ),
    "two kinds": ("# kind: shear\n# kind: planar\nshear [-], nominal stress [Pa]\n0, 0\n1, 1\n", "one line .*, got 2"),
    "brackets": ("[" * 9000 + "\n1,2", "line 1: a column must be one of .*, got '"),
    "spaces": ("stretch" + " " * 9000 + "x [-\n1", "line 1: a column must be one of .*, got '"),
    "an endless stretch": (
        "# kind: uniaxial\ntrue strain [-], nominal stress [Pa]\n0, 0\n-1e9, 1\n",
        "stretch must be .*, got 0 at point 2",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", HARMFUL)
def test_harmful_files_are_refused_in_one_short_line(read, case):
    text, message = HARMFUL[case]
    with pytest.raises(pt.FileFormatError, match=message) as refusal:
        read(text)
    assert len(str(refusal.value).splitlines()) == 1
    assert len(str(refusal.value)) < 500


def test_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(pt.FileFormatError, match="is not a regular file"):
        read_measurements(tmp_path / "pipe.csv")


def test_damaged_files_give_curves_or_are_refused(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "damaged.csv"
    text = (
        "# Doe, 2001\n# kind: compression\nkind; curve; strain [%]; nominal stress [kPa]; standard deviation [kPa]\n"
        + "".join(f"tension; {i % 3}; {i}; {2 * i}; 1\n" for i in range(12))
    )
    pieces = [
        *(b"\xff", b"\0", b'"', b"\r", b"\n", b"nan", b"-inf", b"1e999", b"1e30", b"-", b";", b"\t", b"#", b"[", b"]"),
        *(b"%", b"kind", b"stretch [-]", b"\xef\xbc\x91", b"\xed\xa0\x80", b"9" * 400, b"\xc2\x85", b"\xe2\x80\xa8"),
    ]
    read = 0
    for _ in range(2000):
        data = bytearray(text.encode())
        for _ in range(rng.integers(1, 4)):
            at = rng.integers(len(data))
            data[at : at + rng.integers(0, 6)] = pieces[rng.integers(len(pieces))]
        path.write_bytes(data[: rng.integers(1, len(data) + 1)] if rng.integers(4) == 0 else data)
        try:
            curves = read_measurements(path)
        except pt.FileFormatError as error:
            message = str(error)
            assert len(message.splitlines()) == 1
        else:
            read += 1
            assert all(np.isfinite(curve.stress).all() for curve in curves)
    assert 20 < read < 1900
