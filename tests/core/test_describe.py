"""Objects print as one line with units, and as a table and a picture in notebooks."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pytest

import palpate as pt
from palpate.core.describe import MAX_LINE_CHARACTERS, Described, format_quantity
from palpate.dynamics.run.trajectory import StoredTrajectory
from palpate.meshfree.stencils import moving_least_squares
from palpate.realtime.statistics import Histograms, Statistics, count_step
from palpate.reduction.training.errors import Errors
from palpate.tissue.catalogue import FIBRE_LAWS, LAWS

SVG = "{http://www.w3.org/2000/svg}svg"


@pytest.fixture(scope="module")
def still(bar, tissue, calm):
    return pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=calm)


@pytest.fixture(scope="module")
def energy_form(bar, tissue):
    return pt.Solid(bar, tissue, fixed="x-", form="energy")


@pytest.fixture(scope="module")
def system(energy_form, pull):
    return pt.lti.linearise(energy_form, [pull], ["x+"])


def statistics(*computing: float) -> Statistics:
    """Of steps that compute for some times [s] in a period of 1 ms."""
    histograms = Histograms.zeros()
    for seconds in computing:
        count_step(histograms, seconds, 1e-5, int(1e9 * seconds), 0, 1_000_000, 0)
    return Statistics.from_histograms(histograms, 1e-3)


def described(still, energy_form, system, run, tmp_path):
    """Return objects with what their lines must hold."""
    basis = pt.pod(run, still.weights, modes=3)
    reduced = pt.hyper_reduce(energy_form, run, modes=3)
    run.save(tmp_path / "run.h5")
    membrane = pt.Membrane(pt.disc(0.1, 0.02), pt.materials.NeoHookean(C1=5e3, density=1000, poisson=0.5), 1e-3, "rim")
    curve = pt.materials.Measurement(
        kind="uniaxial", deformation=[1.0, 1.1, 1.2, 1.3], stress=[0.0, 2.8e3, 5.1e3, 7.1e3]
    )
    surface = pt.Surface(*_tetrahedron(), name="piece")
    state = still.state(still.prepare([]))
    return [
        (pt.equilibrium(energy_form, [pt.Gravity()]), ["largest displacement", "m, 112 nodes", "iterations", "N"]),
        (still.cloud, ["112 nodes", "spacing=5 mm", "size=(30, 15, 15) mm", "volume=6.75 cm^3"]),
        (membrane.cloud, ["91 nodes", "spacing=20 mm", "area=314 cm^2"]),
        (surface, ["name=piece", "4 vertices", "size=(30, 30, 30) mm", "volume=4.5 cm^3"]),
        (moving_least_squares(still.cloud.points, order=1, neighbours=20), ["112 nodes", "condition number"]),
        (still, ["form=strong", "law=MooneyRivlin", "shear modulus 25 kPa", "stable step", "stability not examined"]),
        (energy_form, ["form=energy", "stable at rest", "112 nodes"]),
        (energy_form.stability, ["stable at rest", "µs"]),
        (membrane, ["thickness=1 mm", "prestretch=1", "ms"]),
        (pt.galerkin(still, run, modes=3), ["3 modes", "energy not held", "%", "shear modulus 25 kPa"]),
        (reduced, ["3 modes", "sampled nodes", "step=explicit", "not measured"]),
        (system, ["288 unknowns", "symmetric=yes", "inputs=force x on x+"]),
        (pt.lti.reduce_linear(system, "modal", 4), ["4 coordinates", "method=modal", "stable"]),
        (basis, ["3 modes", "112 nodes", "61 snapshots", "m^5/2"]),
        (run, ["61 frames", "112 nodes", "complete", "end=30 ms", "mm", "largest force on 'x-'", "N"]),
        (StoredTrajectory(tmp_path / "run.h5"), ["file=run.h5", "61 frames", "30 ms"]),
        (Errors(0.0235, 0.06, 0.0024, 0.5), ["displacement=2.35 %", "velocity=6 %", "reaction=50 %"]),
        (statistics(1e-4, 2e-4), ["2 steps", "rate=1 kHz", "µs", "in real time yes"]),
        (statistics(3e-3, 3e-3), ["in real time no", "2 deadlines missed"]),
        (statistics(1e-4).computing, ["maximum=100 µs"]),
        (state, ["336 coordinates", "time=0 s"]),
        (curve, ["kind=uniaxial", "4 points", "stretch=1 to 1.3", "(0, 7.1) kPa"]),
        (pt.materials.fit(pt.materials.NeoHookean, curve), ["law=NeoHookean", "+-", "Pa", "stable"]),
        (pt.SurfaceForce("x+", force=(0, 0, -2.5)), ["group=x+", "force=(0, 0, -2.5) N"]),
        (pt.Pressure("x+", 2e3), ["pressure=2 kPa"]),
        (pt.SurfaceForce("x+", force=lambda t: (t, 0, 0)), ["force=a function [N]"]),
        (pt.Gravity(), ["(0, 0, -9.81) m/s^2"]),
        (pt.PrescribedMotion("x+", (1e-3, 0, 0), until=0.5), ["(1, 0, 0) mm", "until=500 ms"]),
        (pt.Foundation("x-", 2e5), ["N/m^3"]),
        (pt.Rail("x+", (1.0, 0.0, 0.0)), ["group=x+", "axis=(1, 0, 0)"]),
        (pt.Roller("x+"), ["group=x+"]),
        (pt.tools.Sphere(0.01), ["radius=10 mm"]),
        (pt.tools.Capsule(0.01, 0.02), ["length=20 mm"]),
        (pt.tools.Punch(0.01), ["rounding=500 µm"]),
        (
            pt.tools.Contact(pt.tools.Sphere(0.01), (np.arange(9.0), np.zeros((9, 3)))),
            ["tool=Sphere(", "9 samples from 0 to 8 s"],
        ),
        (pt.tools.Grasp((0, 0, 0.01), 0.01, (0, 0, 0)), ["point=(0, 0, 10) mm", "motion=at rest"]),
        (pt.materials.Prony(shares=(0.5, 0.3), times=(0.02, 0.3)), ["2 branches", "times=(20, 300) ms"]),
        (reduced.body, ["3 modes", "112 nodes", "cubature points"]),
        (energy_form.evaluate(np.zeros((112, 3))), ["112 nodes", "largest stress 0 Pa", "energy density"]),
        (pt.realtime_model(pt.lti.reduce_linear(tool_system(energy_form), "modal", 4)), ["coordinates"]),
        *data_of_results(curve, surface, still),
    ]


def tool_system(body):
    return pt.lti.linearise(body, [pt.PrescribedMotion("x+", (0, 0, 0))])


def data_of_results(curve, surface, body):
    """Return results that hold arrays, with what their lines must hold."""
    arrays = np.full((50, 3), 0.5)
    engine_model = pt.typing.RealtimeModel(
        None, None, arrays, np.zeros(30_000), np.eye(12), max_backlog=4, tool_names=("left", "right")
    )
    fit = pt.materials.fit(pt.materials.NeoHookean, curve)
    scene = pt.TrainingScene(
        body, path=lambda seed: ((), 0.03), every=0.001, title="Bar", parameters={"spacing": 0.005}, tools=("x+",)
    )
    return [
        (engine_model, ["30,000 coordinates", "tools=left, right", "can be cut no", "at most 4 periods", "not known"]),
        (
            pt.typing.DeviceLog(np.arange(50.0), arrays, arrays, arrays),
            ["50 poses", "end=49 s", "largest force 866 mN"],
        ),
        (pt.DummyDevice(lambda t: ((t, 0, 0), (1, 0, 0, 0))), ["path=a function"]),
        (scene, ["title=Bar", "112 nodes", "tools=x+", "every=1 ms", "parameters=spacing"]),
        (fit.curves[0], ["kind=uniaxial", "4 points", "Pa", "r_squared=1"]),
        (fit.starts[0], ["values=C1=", "converged=yes"]),
        (pt.io.check_surface(surface), ["4 vertices", "4 triangles", "cm^3", "problems="]),
        (pt.io.SurfaceProblem("note", "hole", "an open edge", arrays), ["kind=note", "50 places", "an open edge"]),
        (pt.typing.ExpectedError(*np.array([0.02, 0.05, 0.95, 0.9, 0.001])), ["median=2 %", "level=95 %"]),
    ]


@pytest.mark.parametrize(
    "module", [pt, pt.materials, pt.tools, pt.io, pt.lti, pt.typing], ids=lambda each: each.__name__
)
def test_every_public_class_prints_as_a_described_object(module):
    for name in module.__all__:
        kind = getattr(module, name)
        if inspect.isclass(kind) and not issubclass(kind, BaseException) and kind is not pt.typing.DeadLoad:
            assert kind.__repr__ is Described.__repr__, name
            assert kind._repr_html_ is Described._repr_html_, name


def _tetrahedron():
    vertices = 0.03 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def check(thing, parts):
    line = repr(thing)
    assert "\n" not in line
    assert line.isprintable()
    assert len(line) <= MAX_LINE_CHARACTERS
    title = "Solid" if isinstance(thing, pt.Solid) else type(thing).__name__
    assert line.startswith(f"{title}(")
    assert "array(" not in line
    for part in parts:
        assert part in line
    page = ElementTree.fromstring(thing._repr_html_())
    assert page.find("table/caption/b").text == title
    assert all(len(row) == 2 and row[0].text and row[1].text for row in page.iter("tr"))
    return page


def test_every_object_prints_one_line_with_units_and_a_table(still, energy_form, system, run, tmp_path):
    drawn = set()
    for thing, parts in described(still, energy_form, system, run, tmp_path):
        if check(thing, parts).find(SVG) is not None:
            drawn.add("Solid" if isinstance(thing, pt.Solid) else type(thing).__name__)
    assert drawn >= {"Cloud", "Surface", "Solid", "Membrane", "Trajectory", "Basis"}


@pytest.mark.parametrize("law", [law.kind for law in LAWS])
def test_every_law_prints_its_parameters_and_moduli(law):
    entry = next(each for each in LAWS if each.kind is law)
    material = law(**entry.example, density=1060, poisson=0.45)
    parts = ["density=1060 kg/m^3", "poisson=0.45", "shear modulus", "bulk modulus", "kPa"]
    check(material, [*parts, *(f"{name}=" for name in entry.example)])


@pytest.mark.parametrize("entry", FIBRE_LAWS, ids=lambda entry: entry.name)
def test_every_law_of_fibres_prints_its_parameters_without_directions(entry):
    directions = np.tile([1.0, 0.0, 0.0], (500, 1))
    check(entry.kind(**entry.example, directions=directions), ["kPa", "directions=at 500 nodes"])


def test_a_user_defined_law_prints_as_the_others():
    @dataclass(frozen=True, kw_only=True)
    class Own(pt.materials.NeoHookean):
        pass

    check(Own(C1=5e3, density=1060, poisson=0.45), ["C1=5 kPa", "shear modulus 10 kPa"])
    written = pt.materials.Hyperelastic("C1 * (I1bar - 3)", C1=5e3, density=1060, poisson=0.45)
    assert "C1 * (I1bar - 3)" in repr(written)


def test_an_object_whose_construction_failed_still_prints():
    assert repr(pt.Solid.__new__(pt.Solid)) == "Solid(incomplete)"


class Fault(Described):
    def _facts(self):
        return [
            ("<b>", '<script>alert("x")</script> & more\n\x1b[31m', "m"),
            ("long", "word " * 100, ""),
            ("x", 1.0, "N"),
        ]


def test_texts_from_files_are_escaped_and_truncated():
    line, page = repr(Fault()), Fault()._repr_html_()
    assert line.isprintable()
    assert len(line) <= MAX_LINE_CHARACTERS
    assert line.endswith("...)")
    assert "<script>" not in page
    rows = list(ElementTree.fromstring(page).iter("tr"))
    assert rows[0][0].text == "<b>"
    assert rows[0][1].text.startswith('<script>alert("x")</script> & more')


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.005, "m", "5 mm"),
        (0.99999e-3, "m", "1 mm"),
        (1060.0, "kg/m^3", "1060 kg/m^3"),
        (61.2345e3, "Pa", "61.2 kPa"),
        (8e-5, "m^3", "80 cm^3"),
        (0.0, "J", "0 J"),
        (float("nan"), "s", "nan s"),
        (float("inf"), "Pa", "inf Pa"),
        (-0.25, "N", "-250 mN"),
        (1234567, "", "1,234,567"),
        (True, "", "yes"),
        ((0.2, 0.02), "m", "(200, 20) mm"),
        (np.zeros((3, 4)), "", "array of shape (3, 4)"),
        (np.arange(9.0), "", "array of shape (9,)"),
        ((), "", "none"),
        (["a", "b"], "", "a, b"),
        ({"a": np.zeros(3)}, "", "a"),
        (len, "N", "a function [N]"),
    ],
)  # fmt: skip
def test_values_have_three_digits_and_the_nearest_prefix(value, unit, text):
    assert format_quantity(value, unit) == text


def test_printing_imports_no_plotting_package():
    code = (
        "import sys, palpate as pt\n"
        "cloud = pt.box((0.03, 0.015, 0.015), 0.005)\n"
        "repr(cloud), cloud._repr_html_(), repr(pt.materials.NeoHookean(C1=5e3, density=1000, poisson=0.4))\n"
        "import palpate.dynamics.run.trajectory, palpate.reduction.basis.pod\n"
        "print(sorted({'matplotlib', 'pyvista', 'vtk'} & {name.partition('.')[0] for name in sys.modules}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ)
    assert done.stdout.strip() == "[]"
