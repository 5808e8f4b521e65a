"""Scene files: what they hold, what is refused and where, and the bodies that come of them."""

from __future__ import annotations

import dataclasses
import time
import types
import typing
from dataclasses import MISSING, is_dataclass

import numpy as np
import pytest

import palpate as pt
from palpate.core.parameters import (
    FACTORS_BY_UNIT,
    fields_of,
    parameter,
    read_section,
    read_values,
    written_section,
    written_value,
)  # fmt: skip
from palpate.dynamics.loads.supports import Clamp, Rail, Roller
from palpate.meshfree.cloud import BORDER_MARGIN, MOVED_MARGIN
from palpate.scenes import description
from palpate.scenes.description import (
    Description,
    Place,
    Training,
    with_settings,
)
from palpate.scenes.names import PACKAGE_SCENES, listed_scenes
from palpate.scenes.open_scene import open_scene
from palpate.scenes.scene_text import parse_description
from palpate.scenes.training import open_training, training_of

BOX = """
[surface]
generated = "box"
size = ["60 mm", "40 mm", "30 mm"]

[body]
spacing = "10 mm"

[tissue]
parameters = { C1 = "1.5 kPa" }
mass_damping = 0

[[support]]
place = { group = "x-" }
"""
FULL = """
title = "All sections"

[surface]
file = "organ.obj"
parts = ["*lobe*", "left"]
labels = "names.json"
units = "cm"
scale = 1.5
repair = false

[body]
spacing = "4.5 mm"
form = "strong"
seed = 3
thickness = "0.2 mm"
prestretch = 1.1
under_loads = true

[tissue]
law = "MooneyRivlin"
parameters = { C1 = "2.2 kPa", C2 = 100 }
density = "1.05 g/cm^3"
poisson = "49 %"
volumetric = "logarithmic"
split = "isochoric"
mass_damping = "4 1/s"
relaxation = { shares = [0.3, "20 %"], times = ["20 ms", 1], bulk_shares = [0.1, 0] }

[tissue.fibres]
law = "Guccione"
directions = [[1, 0, 0], [0.5, 1, 0]]
parameters = { C = "1 kPa" }

[[region]]
name = "tumour"
place = { ball = { centre = ["1 cm", 0, "-2 mm"], radius = "8 mm" } }
parameters = { C1 = "9 kPa" }

[[region]]
place = { part = "lobe 2" }
stiffness = 3

[[support]]
name = "bed"
kind = "springs"
place = { side = "lowest 15%" }
surface_only = true
stiffness = "12 kPa/cm"
damping = "2 kPa s/m"

[[support]]
kind = "rail"
place = { box = { low = [0, 0, 0], high = ["1 in", 0.1, 0.1] } }
direction = [0, 0, 2]

[[support]]
kind = "roller"
place = { near = { file = "bone.stl", distance = "2 mm", parts = ["rib*"] } }
direction = [1, 0, 0]

[[support]]
place = { painted = { file = "paint.vtp", field = "held", least = 0.25 } }

[tool]
radius = "12 mm"
friction = 0.4
holds = "bed"
hold_radius = "3 mm"

[[load]]
name = "push"
kind = "force"
place = { plane = { point = [0, 0, "1 mm"], normal = [0, 0, 1] } }
force = ["100 mN", 0, -2]
times = [0, "500 ms"]
factors = [0, 1]

[[load]]
kind = "pressure"
place = { group = "x+" }
pressure = "-1.2 kPa"

[[load]]
kind = "gravity"
acceleration = [0, 0, -9.81]

[[load]]
kind = "motion"
place = { side = "z+" }
displacement = [0, 0, "2 mm"]

[run]
duration = "1 min"
every = "20 ms"

[training]
paths = 7
held_out = 2
modes = 13
tolerance = "5 %"
cubature = 0.02
seed = 11
depth = "9 mm"
slide = "1 cm"
grasps = 0.5
pairs = 0.25
every = "5 ms"
duration = "0.3 s"
low = [0, 0, "-1 mm"]
high = [0, 0, "1 mm"]
low_turn = [0, 0, "-10 deg"]
high_turn = [0, 0, 0.2]
"""
SECTIONS = [
    kind for kind in vars(description).values() if is_dataclass(kind) and kind.__module__ == description.__name__
    and kind is not Description
]  # fmt: skip


@pytest.fixture
def write(tmp_path):
    """A function that writes a scene file and returns its path."""

    def written(text, name="organ.toml"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return written


@pytest.fixture
def opened(write):
    """A function that opens a scene from the text of its file."""

    def scene(text, settings=None):
        return open_scene(write(text), settings)

    return scene


# reading


def sample(kind, about):
    """Return a value of a declaration, as a file has it."""
    origin, inner = typing.get_origin(kind), [each for each in typing.get_args(kind) if each is not type(None)]
    if origin in (typing.Union, types.UnionType):
        return sample(inner[0], about)
    if origin is tuple:
        length = len(inner) if inner[-1] is not Ellipsis else about["length"] or 2
        return [sample(inner[0], {**about, "length": None})] * length
    if origin is dict:
        return {"C1": "2 kPa"}
    if kind is Place:
        return {"side": "x-"}
    if is_dataclass(kind):
        required = {name: each for name, each in fields_of(kind).items() if each[0].default is MISSING}
        return {name: sample(hint, field.metadata) for name, (field, hint) in required.items()}
    if kind is str:
        return about["choices"][-1] if about["choices"] else "text"
    if kind is bool:
        return True
    low = about["low"] if np.isfinite(about["low"]) else 0.0
    return kind(low + min(1.0, 0.5 * (about["high"] - low)))


@pytest.mark.parametrize("section", SECTIONS)
def test_every_key_reads_a_value_of_its_declaration_and_writes_it(section):
    for name, (field, kind) in fields_of(section).items():
        value = read_values(section, {name: sample(kind, field.metadata)}, ())[name]
        assert read_values(section, {name: written_value(value)}, ())[name] == value


def test_a_file_with_most_keys_round_trips():
    about = parse_description(FULL, "full")
    assert read_section(Description, written_section(about)) == about
    assert about.training == Training(
        paths=7, held_out=2, modes=13, tolerance=0.05, cubature=0.02, seed=11, depth=0.009, slide=0.01, grasps=0.5,
        pairs=0.25, every=0.005, duration=0.3, low=(0.0, 0.0, -0.001), high=(0.0, 0.0, 0.001),
        low_turn=(0.0, 0.0, pytest.approx(np.deg2rad(-10))), high_turn=(0.0, 0.0, 0.2),
    )  # fmt: skip


def test_lengths_in_millimetres_are_those_in_metres_to_the_last_bit():
    for k in range(1, 200):
        assert parse_description(BOX.replace("10 mm", f"{k / 10} mm"), "box").body.spacing == float(f"{k / 10}e-3")
    assert parse_description(BOX.replace("10 mm", "1e-300 mm"), "box").body.spacing == 1e-303


def test_texts_with_units_are_read_in_si_units():
    about = parse_description(FULL, "full")
    assert about.body.spacing == pytest.approx(0.0045)
    assert about.tissue.density == pytest.approx(1050.0)
    assert about.tissue.poisson == pytest.approx(0.49)
    assert about.tissue.relaxation.times == pytest.approx((0.02, 1.0))
    assert about.support[0].stiffness == pytest.approx(1.2e6)
    assert about.support[0].damping == pytest.approx(2000.0)
    assert about.load[0].force == pytest.approx((0.1, 0.0, -2.0))
    assert about.load[1].pressure == pytest.approx(-1200.0)
    assert about.run.duration == pytest.approx(60.0)


@pytest.mark.parametrize("unit", FACTORS_BY_UNIT)
def test_every_unit_is_a_factor_of_the_si_unit(unit):
    @dataclasses.dataclass(frozen=True)
    class One:
        size: float = parameter(unit, 0.0, "a size")

    for name, factor in FACTORS_BY_UNIT[unit].items():
        assert read_section(One, {"size": f"2.5 {name}"}).size == pytest.approx(2.5 * factor)
        assert read_section(One, {"size": f"-.25e+0  {name} "}).size == pytest.approx(-0.25 * factor)


@pytest.mark.parametrize("name", PACKAGE_SCENES)
def test_the_scenes_of_the_package_open(name):
    scene = open_scene(name)
    assert scene.title == name.capitalize()
    assert "Scene" in repr(scene)
    assert scene.name == name


def test_the_package_has_a_file_for_each_scene():
    from importlib.resources import files

    found = {each.name for each in (files("palpate.scenes") / "data").iterdir() if each.name.endswith(".toml")}
    assert found == {f"{name}.toml" for name in PACKAGE_SCENES}


# refusals

EXTRA = "\n[[load]]\nkind = 'gravity'\nacceleration = [0, 0, 1]\n"
WRONG = [  # replaced, by what, line, what is said
    ("spacing =", "spacng =", 7, "body.spacng is not a key of [body]; did you mean spacing?"),
    ("[body]", "[bod]", 6, "bod is not a key of the file; did you mean body?"),
    ('"10 mm"', "true", 7, "body.spacing must be a number [m] or a text such as \"12 m\", got True"),
    ('"10 mm"', '"10 kg"', 7, "body.spacing must have one of the units m, cm, mm, um, in, got 'kg'"),
    ('"10 mm"', '"ten mm"', 7, "body.spacing must be a number [m]"),
    ('"10 mm"', "2", 7, "body.spacing must be in (0, 1] m, got 2; give distance between nodes [m]"),
    ('"10 mm"', "nan", 7, "body.spacing must be in (0, 1] m, got nan"),
    ('"10 mm"', "1" + "0" * 400, 7, "body.spacing must be in (0, 1] m, got 1000"),
    ('"10 mm"', '"1e999 mm"', 7, "body.spacing must be in (0, 1] m, got '1e999 mm'"),
    ('"box"', '"bax"', 3, "surface.generated must be one of liver, box, disc, got 'bax'; did you mean 'box'?"),
    ('"box"', "3", 3, "surface.generated must be a text in quotes, got 3"),
    ('"30 mm"]', '"30 mm", 1]', 4, "surface.size must be a list of 3, got"),
    ('"30 mm"]', '"3 s"]', 4, "surface.size[3] must have one of the units m,"),
    ('size = ["60 mm", "40 mm", "30 mm"]', "", 2, "surface must have size for a box"),
    ('generated = "box"', 'generated = "box"\nfile = "a.stl"', 2, "surface must have file or generated, and not both"),
    ('[surface]\ngenerated = "box"\nsize = ["60 mm", "40 mm", "30 mm"]', "", 1, "surface must be given in the file"),
    ('[body]\nspacing = "10 mm"', "body = 3", 6, "surface.body is not a key of [surface]"),
    ('parameters = { C1 = "1.5 kPa" }', "parameters = 3", 10, "tissue.parameters must be a table such as"),
    ('"1.5 kPa" }', "[[1]] }", 10, "tissue.parameters.C1 must be a number, or a text with a unit, got [[1]]"),
    ('"1.5 kPa" }', "1979-05-27 }", 10, "tissue.parameters.C1 must be a number, or a text with a unit, got"),
    ('spacing = "10 mm"', 'spacing = "10,5 mm"', 7, "body.spacing must have a decimal point, got '10,5 mm'; write"),
    ("mass_damping = 0", "mass_damping = -1", 11, "tissue.mass_damping must be in [0, 1000] 1/s, got -1"),
    ("mass_damping = 0", "relaxation = { shares = [0.1] }", 11, "tissue.relaxation.times must be given in [tissue"),
    ('group = "x-" }', 'group = "x-", side = "x-" }', 14, "support[1].place must be one of side, group,"),
    ('group = "x-" }', 'group = "x-", side = "x-" }', 14, "got side and group"),
    ('{ group = "x-" }', "{}", 14, "support[1].place must be one of side, group"),
    ('{ group = "x-" }', '"x-"', 14, "support[1].place must be a table, got 'x-'"),
    ('{ group = "x-" }', "{ ball = { centre = [0, 0, 0], radius = 0 } }", 14, "place.ball.radius must be in"),
    ('place = { group = "x-" }', "surface_only = true", 13, "support[1].place must be given in [support]"),
    ("[[support]]", "[[support]]\nkind = 'springs'", 13, "support[1] must have a stiffness if it is of springs"),
    ("[[support]]", "[[support]]\nkind = 'fixed'\nstiffness = 3", 13, "support[1] must have a stiffness if"),
    ("[[support]]", "[[support]]\nkind = 'rail'", 13, "support[1] must have a direction if it is a rail"),
    ("[[support]]", "[[support]]\ndirection = [1, 0, 0]", 13, "support[1] must have no direction unless"),
    ("[[support]]", "[[support]]\nkind = 'glued'", 14, "support[1].kind must be one of fixed, roller, rail, springs"),
    ("[[support]]", "[support]", 13, "support must be a list"),
    ('{ group = "x-" }', '{ group = "x-" }' + EXTRA + "[[load]]\nkind = 'force'", 18, "load[2] must have force"),
    ('{ group = "x-" }', '{ group = "x-" }' + EXTRA + "pressure = 1", 15, "load[1] must have acceleration"),
    ('{ group = "x-" }', '{ group = "x-" }' + EXTRA + "times = [0, 1]", 15, "load[1] must have increasing times"),
    ('{ group = "x-" }', '{ group = "x-" }' + EXTRA + "place = { side = 'x+' }", 15, "must have a place unless"),
    ('{ group = "x-" }', '{ group = "x-" }\n[run]\nevery = 1\nduration = 0.5', 15, "run must have every of at most"),
    ('{ group = "x-" }', '{ group = "x-" }\n[training]\npaths = 2.5', 16, "training.paths must be a whole number"),
    ('{ group = "x-" }', '{ group = "x-" }\n[training]\nmodes = 0', 16, "training.modes must be in [1, 1000], got 0"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "line", "said"), WRONG)
def test_what_is_wrong_is_refused_with_file_line_key_and_remedy(write, old, new, line, said):
    assert old in BOX
    path = write(BOX.replace(old, new, 1))
    with pytest.raises(pt.InputError) as caught:
        open_scene(path)
    message = str(caught.value)
    assert message.startswith(f"{path}, line {line}: "), message
    assert said in message
    assert len(message) < 500


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"title = ", "must be a scene file in TOML"),
        (b"\x89HDF\r\n\x1a\n" + bytes(range(256)), "is not text in UTF-8"),
        (b"a = " + b"[" * 100_000, "more than 32 nested levels"),
        (b"a = " + b"9" * 5000, "must be a scene file in TOML"),
        (b"title = 'a'\ntitle = 'b'", "must be a scene file in TOML"),
        (b"#" * (1 << 20) + b"\n", "a scene file has at most 1048576"),
    ],
    ids=["cut", "binary", "deep", "digits", "twice", "large"],
)
def test_files_that_are_not_scenes_are_refused(write, content, said):
    path = write(content)
    with pytest.raises(pt.FileFormatError, match=said) as caught:
        open_scene(path)
    assert str(path) in str(caught.value)


def test_folders_and_missing_files_are_refused(tmp_path):
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(pt.FileFormatError, match="is not a regular file"):
        open_scene(tmp_path / "folder.toml")
    with pytest.raises(FileNotFoundError, match="no scene file at"):
        open_scene(tmp_path / "none.toml")
    with pytest.raises(
        pt.InputError, match=rf"source must be {listed_scenes()}, a file that ends in \.toml, or a surface"
    ):
        open_scene("lever")


@pytest.mark.parametrize(
    "line",
    [
        "[" + " " * 900_000 + "x]",
        "a." * 300_000 + "a = 1",
        "x = {" + "a . " * 200_000 + "a = 1}",
        "['1'" + ".'1'" * 200_000 + "]",
        "x" * 900_000 + " = 1",
        '"' + "]" * 900_000 + '" = 1',
    ],
)
def test_long_lines_are_refused_without_a_wait(write, line):
    path = write("title = 3\n" + line + "\n")
    start = time.process_time()
    with pytest.raises(pt.InputError):
        open_scene(path)
    assert time.process_time() - start < 5.0


# bodies


def box_scene(**more):
    """The text of the box with other parts."""
    text = BOX
    for old, new in more.pop("replace", {}).items():
        assert old in text
        text = text.replace(old, new)
    return text + "\n".join(more.pop("add", []))


def assert_same_body(scene, body):
    """Require the supports, masses and forces of a body that was made by hand."""
    u = 2e-4 * np.random.default_rng(0).standard_normal((len(body.cloud), 3))
    np.testing.assert_array_equal(scene.cloud.points, body.cloud.points)
    free = np.zeros(len(body.cloud), dtype=bool)
    u = body.constrain(free)(u)
    np.testing.assert_allclose(scene.body.constrain(free)(u.copy()), u, atol=1e-18)
    np.testing.assert_allclose(scene.body.force(u), body.force(u), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(scene.body.masses, body.masses)


CLOUD = pt.box((0.06, 0.04, 0.03), spacing=0.01)
SOFT = pt.materials.NeoHookean(C1=1500.0, density=1060.0, poisson=0.45)
X, Y, Z = CLOUD.points.T
PLACES = {
    "side = 'x-'": X <= 0.12 * 0.06,
    "side = 'lowest 40%'": Z <= 0.4 * 0.03,
    "side = 'near 60, 40,30,15'": np.linalg.norm(CLOUD.points - [0.06, 0.04, 0.03], axis=1) <= 0.015,
    "group = 'y+'": np.isclose(Y, 0.04),
    "plane = { point = ['30 mm', 0, 0], normal = [2, 0, 0] }": X <= 0.03 + 1e-9,
    "box = { low = [0, 0, 0], high = ['2 cm', '2 cm', '3 cm'] }": (X <= 0.02 + 1e-9) & (Y <= 0.02 + 1e-9),
    "ball = { centre = [0, 0, 0], radius = '25 mm' }": np.linalg.norm(CLOUD.points, axis=1) <= 0.025,
}


@pytest.mark.parametrize("place", PLACES)
def test_every_place_of_a_box_holds_its_nodes(opened, place):
    scene = opened(box_scene(add=[f"[[region]]\nname = 'here'\nplace = {{ {place} }}\nstiffness = 2"]))
    np.testing.assert_array_equal(scene.cloud.group("here"), np.flatnonzero(PLACES[place]))


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("group = 'top'", r"region\[1\]: .*'top'"),
        ("side = 'top'", r"region\[1\]: fixed must be x-, x\+"),
        ("side = 'near 1.2.3,0,0,1'", r"region\[1\]: fixed must be x-, x\+"),
        ("side = 'near 1,0,0,e'", r"region\[1\]: fixed must be x-, x\+"),
        ("side = 'lowest 1.2.3%'", r"region\[1\]: fixed must be x-, x\+"),
        ("side = 'lowest 150%'", r"region\[1\]: fixed must be in \(0, 100\] %"),
        ("part = 'lobe'", r"region\[1\]: part must be of a surface file, got 'lobe' of a generated shape; use a box"),
        (
            "ball = { centre = [1, 1, 1], radius = '1 mm' }",
            r"region\[1\]: place must hold a node, got none at its ball",
        ),
        ("plane = { point = [0, 0, 0], normal = [0, 0, 0] }", r"region\[1\]: normal of a plane must not be zero"),
    ],
)
def test_places_without_nodes_are_refused_by_their_entry(opened, place, said):
    with pytest.raises(pt.InputError, match=said):
        _ = opened(box_scene(add=[f"[[region]]\nplace = {{ {place} }}\nstiffness = 2"])).cloud


def test_the_body_is_that_of_the_library(opened):
    text = 'law = "MooneyRivlin"\nparameters = { C1 = "3 kPa", C2 = "200 Pa" }'
    scene = opened(box_scene(replace={'parameters = { C1 = "1.5 kPa" }': text}))
    tissue = pt.materials.MooneyRivlin(C1=3000.0, C2=200.0, density=1060.0, poisson=0.45)
    assert_same_body(scene, pt.Solid(CLOUD, tissue, "x-"))


@pytest.mark.slow
def test_regions_have_their_own_parameters_or_a_factor(opened):
    mask = PLACES["ball = { centre = [0, 0, 0], radius = '25 mm' }"]
    place = "place = { ball = { centre = [0, 0, 0], radius = '25 mm' } }"
    cloud = CLOUD.with_group("tumour", mask)
    parameters = opened(box_scene(add=[f"[[region]]\nname = 'tumour'\n{place}\nparameters = {{ C1 = '6 kPa' }}"]))
    hard = pt.materials.NeoHookean(C1=6000.0, density=1060.0, poisson=0.45)
    share = pt.cell_fractions(CLOUD, lambda points: np.linalg.norm(points, axis=1) <= 0.025)
    ratio = hard.shear_modulus / SOFT.shear_modulus
    mean = 1 / (1 - share + share / ratio)  # of the compliances of a node's cell
    stiffness = mean / np.where(np.isin(np.arange(len(CLOUD)), cloud.group("tumour")), ratio, 1.0)
    assert_same_body(parameters, pt.Solid(cloud, {"": SOFT, "tumour": hard}, "x-", stiffness=stiffness))
    factor = opened(box_scene(add=[f"[[region]]\nname = 'tumour'\n{place}\nstiffness = 4"]))
    assert_same_body(factor, pt.Solid(cloud, SOFT, "x-", stiffness=1 / (1 - share + share / 4)))


def test_two_entries_of_one_name_in_different_places_are_refused(opened):
    entry = "[[region]]\nname = 'a'\nplace = {{ side = '{}' }}\nstiffness = 2"
    with pytest.raises(pt.InputError, match=r"region\[2\]: group must be a new name, got 'a'"):
        _ = opened(box_scene(add=[entry.format("x-"), "\n" + entry.format("x+")])).cloud


@pytest.mark.slow
def test_rollers_rails_and_springs_are_those_of_the_library(opened):
    text = box_scene(
        add=[
            "[[support]]\nkind = 'roller'\nplace = { group = 'y-' }\n",
            "[[support]]\nkind = 'rail'\nplace = { group = 'z-' }\ndirection = [2, 0, 0]\n",
            "[[support]]\nname = 'bed'\nkind = 'springs'\nplace = { group = 'z+' }\nstiffness = '3 kPa/cm'\n",
            "damping = '1 kPa s/m'",
        ]
    )
    scene = opened(text)
    supports = [Clamp("x-"), Roller("y-"), Rail("z-", (2.0, 0.0, 0.0))]
    assert_same_body(scene, pt.Solid(CLOUD, SOFT, supports))
    assert scene.foundations == (pt.Foundation("bed", 3e5, 1000.0),)
    assert scene.loads == scene.foundations
    np.testing.assert_array_equal(scene.cloud.group("bed"), CLOUD.group("z+"))
    assert scene.paths(0)[0][0] is scene.foundations[0]


def test_a_body_that_is_not_held_is_refused(opened):
    rail = {"[[support]]": "[[support]]\nkind = 'rail'\ndirection = [1, 0, 0]"}
    with pytest.raises(pt.InputError, match="supports must hold the body, got 3 rigid motions left free; fix a part"):
        _ = opened(box_scene(replace=rail)).body
    roller = {"[[support]]": "[[support]]\nkind = 'roller'"}
    with pytest.raises(pt.InputError, match="supports must hold the body, got 3 rigid motions left free"):
        _ = opened(box_scene(replace=roller)).body
    roller['{ group = "x-" }'] = "{ ball = { centre = [0, 0, 0], radius = 0.03 } }"
    with pytest.raises(pt.InputError, match=r"support\[1\]: direction must be given for a roller .*direction = \[0, 0"):
        _ = opened(box_scene(replace=roller)).body


def test_surface_only_leaves_inner_nodes_free(opened):
    text = box_scene(replace={'{ group = "x-" }': "{ side = 'lowest 40%' }\nsurface_only = true\nname = 'bed'"})
    held = opened(text).cloud.group("bed")
    np.testing.assert_array_equal(held, np.intersect1d(np.flatnonzero(Z < 0.012), CLOUD.face_nodes))
    assert len(held) < np.count_nonzero(Z < 0.012)


def test_supports_that_hold_all_or_next_to_nothing_are_refused(opened):
    for place, said in (
        ("ball = { centre = [0, 0, 0], radius = 1 }", "fixed must leave tissue free, got 100%"),
        ("ball = { centre = [0, 0, 0], radius = '1 mm' }", "fixed must hold at least 3 nodes, got 1"),
    ):
        with pytest.raises(pt.InputError, match=said):
            _ = opened(box_scene(replace={'group = "x-"': place})).cloud


def test_without_supports_the_side_away_from_the_first_view_is_held(opened):
    text = box_scene(replace={'[[support]]\nplace = { group = "x-" }': ""})
    scene = opened(text)
    held = CLOUD.points[scene.cloud.group(scene.body.supports[0].group)]
    assert held[:, 1].mean() > 0.03


@pytest.mark.slow
def test_every_kind_of_load_is_that_of_the_library(opened):
    ramp = "times = [0, '100 ms']\nfactors = [0, 2]\n"
    text = box_scene(
        add=[
            "[[load]]\nkind = 'force'\nplace = { group = 'x+' }\nforce = [0, 0, '3 mN']\n" + ramp,
            "[[load]]\nname = 'top'\nkind = 'pressure'\nplace = { side = 'z+' }\npressure = '20 Pa'\n" + ramp,
            "[[load]]\nkind = 'gravity'\nacceleration = [0, 0, -9.81]\n" + ramp,
            "[[load]]\nname = 'pin'\nkind = 'motion'\n"
            "place = { ball = { centre = [0.03, 0.02, 0.03], radius = 0.008 } }\ndisplacement = [0, 0, '-1 mm']\n"
            + ramp,
        ]
    )
    scene = opened(text)
    pin = scene.cloud.group("pin")
    np.testing.assert_array_equal(
        pin,
        np.flatnonzero(
            np.linalg.norm(CLOUD.points - [0.03, 0.02, 0.03], axis=1) < 0.008 + MOVED_MARGIN * CLOUD.spacing
        ),
    )
    cloud = CLOUD.with_group("top", np.isclose(Z, 0.03)).with_group("pin", pin)
    loads = [
        pt.SurfaceForce("x+", lambda t: (0.0, 0.0, 0.003 * 20 * t)), pt.Pressure("top", lambda t: 400.0 * t),
        pt.Gravity(lambda t: (0.0, 0.0, -196.2 * t)), pt.PrescribedMotion("pin", lambda x, t: (0.0, 0.0, -0.02 * t)),
    ]  # fmt: skip
    ours = pt.rollout(scene.body, scene.loads, duration=0.02, every=0.01, progress=False)
    theirs = pt.rollout(pt.Solid(cloud, SOFT, "x-"), loads, duration=0.02, every=0.01, progress=False)
    np.testing.assert_allclose(ours.displacements, theirs.displacements, atol=1e-12)
    assert np.abs(ours.displacements).max() > 1e-5
    assert (scene.duration, scene.every) == (1.0, 0.01)


@pytest.mark.slow
def test_fibres_relaxation_and_laws_as_texts_are_those_of_the_library(opened):
    tissue = """[tissue]
energy = "a*(I1 - 3 - 2*log(J))"
relaxation = { shares = [0.4], times = ["50 ms"] }
volumetric = "logarithmic"
fibres = { directions = [[3, 0, 0]], parameters = { k1 = "2 kPa", k2 = 1.5 } }
"""
    scene = opened(box_scene(replace={"[tissue]\n": tissue, 'C1 = "1.5 kPa"': 'a = "1.5 kPa"'}))
    law = pt.materials.Hyperelastic(
        "a*(I1 - 3 - 2*log(J))", a=1500.0, density=1060.0, poisson=0.45, volumetric="logarithmic",
        prony=pt.materials.Prony(shares=[0.4], times=[0.05]),
    )  # fmt: skip
    fibres = pt.materials.Fibres(directions=[[1.0, 0.0, 0.0]], k1=2000.0, k2=1.5)
    assert_same_body(scene, pt.Solid(CLOUD, law, "x-", fibres=fibres))
    assert scene.body.material == law


@pytest.mark.parametrize(
    ("tissue", "said"),
    [
        ("law = 'NeoHooke'", "law must be one of .*did you mean NeoHookean"),
        ("law = 'MooneyRivlin'\npoisson = 0.5", "got poisson = 0.5; use at most 0.499"),
        ("energy = 'exp('", "energy"),
        ("energy = 'I1 - 3 + undefined'", "undefined"),
        ("fibres = { directions = [], parameters = { k1 = 1 } }", "directions of fibres must hold a direction"),
        ("fibres = { directions = [[0, 0, 0]], parameters = { k1 = 1 } }", "directions of fibres must not be zero"),
        (
            "fibres = { directions = [[1, 0, 0]], parameters = { k7 = 1 } }",
            "parameters must be .* for Fibres, got 'k7'",
        ),
        ("relaxation = { shares = [], times = [] }", "shares"),
    ],
)
def test_wrong_tissue_is_refused_by_name(opened, tissue, said):
    scene = opened(box_scene(replace={"[tissue]\n": f"[tissue]\n{tissue}\n"}))
    with pytest.raises(pt.InputError, match=said):
        _ = scene.body


def test_wrong_parameters_of_laws_are_refused_by_name(opened):
    for value, said in (
        ('C1 = "1.5 kg"', "C1 must have one of the units Pa, kPa"),
        ("C1 = -1", "C1 must be"),
        ("C1 = nan", "C1 must be"),
        ("C1 = [1, 2]", "C1 must be"),
        ("K1 = 1", "parameters must be C1 for NeoHookean, got 'K1'; palpate laws lists them"),
    ):
        with pytest.raises(pt.InputError, match=said):
            _ = opened(box_scene(replace={'C1 = "1.5 kPa"': value})).material


def test_faults_that_show_later_name_file_line_and_key(opened):
    small = opened(box_scene(add=["[tool]", 'radius = "1 mm"']))
    with pytest.raises(pt.InputError, match=r"\.toml, line 16: tool\.radius: .* at least 2 spacings"):
        _ = small.paths
    assert "body" not in vars(small)  # before the body is made
    scene = opened(box_scene(), {"tool.radius": "1 mm"})
    with pytest.raises(pt.InputError, match=r"^tool\.radius: "):
        _ = scene.paths
    nowhere = "[[load]]\nkind = 'pressure'\npressure = 1\nplace = { ball = { centre = [9, 9, 9], radius = 0.01 } }"
    with pytest.raises(pt.InputError, match=r"\.toml, line 16: load\[1\]: "):
        _ = opened(box_scene(add=["", nowhere])).body


GRAVITY = '[[load]]\nkind = "gravity"\nacceleration = [0, 0, -9.81]\n'


@pytest.mark.slow
def test_a_shape_under_loads_is_that_at_the_start_of_a_run(opened):
    text = box_scene(replace={"[body]\n": "[body]\nunder_loads = true\n", 'C1 = "1.5 kPa"': 'C1 = "6 kPa"'}) + GRAVITY
    scene = opened(text)
    sag = np.linalg.norm(scene.start, axis=1).max()
    assert sag > 1e-4
    np.testing.assert_allclose(scene.body.cloud.points + scene.start, scene.cloud.points, atol=1e-3 * sag)
    assert any("stress-free shape is up to" in note for note in scene.notes)
    assert opened(text.replace("under_loads = true", "under_loads = false")).start is None


def test_a_shape_under_loads_requires_loads(opened):
    text = box_scene(replace={"[body]\n": "[body]\nunder_loads = true\n"})
    with pytest.raises(pt.InputError, match="under_loads must be false without loads at time 0"):
        _ = opened(text).body
    with pytest.raises(pt.InputError, match="under_loads must be false without loads at time 0"):
        _ = opened(text + GRAVITY + "times = [0, 1]\nfactors = [0, 1]\n").body
    with pytest.raises(pt.InputError, match="must be false for a disc"):
        _ = opened(DISC.replace("[body]", "[body]\nunder_loads = true") + GRAVITY).body


DISC = """
[surface]
generated = "disc"
disc_radius = "50 mm"
[body]
spacing = "10 mm"
thickness = "0.1 mm"
prestretch = 1.05
[tissue]
poisson = 0.5
[[support]]
place = { group = "rim" }
"""


@pytest.mark.parametrize(
    "place",
    ["ball = { centre = [0, 0, 0], radius = '10.1 mm' }", "box = { low = [-0.02, -0.02, 0], high = [0.02, 0.02, 0] }",
     "plane = { point = [0, 0, 0], normal = [1, 0, 0] }", "side = 'x+'", "side = 'near 0,0,0,20'"],
)  # fmt: skip
def test_places_of_a_disc_are_in_the_plane_of_zero_height(opened, place):
    scene = opened(DISC + f"[[load]]\nname = 'here'\nkind = 'motion'\nplace = {{ {place} }}\ndisplacement = [0, 0, 1]")
    count = len(scene.cloud.group("here"))
    assert 3 <= count < len(scene.cloud)
    assert isinstance(scene.body, pt.Membrane)


def test_what_a_disc_cannot_have_is_refused(opened):
    region = "[[region]]\nplace = { ball = { centre = [0, 0, 0], radius = 0.02 } }\nstiffness = 2"
    with pytest.raises(pt.InputError, match="region must be left out for a disc, got 1"):
        _ = opened(DISC + region).body
    with pytest.raises(pt.InputError, match=r"form of \[body\] must be energy for a disc, got strong"):
        _ = opened(DISC.replace("thickness =", 'form = "strong"\nthickness =')).body
    with pytest.raises(pt.InputError, match=r"thickness of \[body\] must be given for a disc"):
        _ = opened(DISC.replace('thickness = "0.1 mm"', "")).body
    with pytest.raises(pt.InputError, match="support must be given for a disc"):
        _ = opened(DISC.partition("[[support]]")[0]).body
    with pytest.raises(pt.InputError, match=r"holds of \[tool\] must be given for a membrane"):
        _ = opened(DISC).paths


# surfaces


def ellipsoid():
    """A closed surface of half axes 30, 20 and 15 mm."""
    import pyvista

    made = pyvista.Icosphere(radius=1.0, nsub=3)
    return pt.Surface(np.array(made.points) * [0.03, 0.02, 0.015], made.faces.reshape(-1, 4)[:, 1:])


def off(path, surface, unit=1e-3):
    path.write_text(
        f"OFF\n{len(surface.vertices)} {len(surface.triangles)} 0\n"
        + "".join(f"{x} {y} {z}\n" for x, y, z in surface.vertices / unit)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in surface.triangles)
    )


ORGAN = """
[surface]
file = "meshes/organ.off"
units = "mm"
[body]
spacing = "6 mm"
seed = 2
[[support]]
name = "held"
place = { near = { file = "meshes/bone.off", distance = "5 mm" } }
"""


@pytest.fixture
def organ(tmp_path, monkeypatch):
    """The path of a scene file whose surfaces are in another folder than the current one."""
    pytest.importorskip("pyvista")
    (tmp_path / "scene" / "meshes").mkdir(parents=True)
    surface = ellipsoid()
    off(tmp_path / "scene" / "meshes" / "organ.off", surface)
    sheet = pt.Surface(
        np.array([[-0.05, -0.05, -0.016], [0.05, -0.05, -0.016], [0, 0.08, -0.016]]), np.array([[0, 1, 2]])
    )
    off(tmp_path / "scene" / "meshes" / "bone.off", sheet)
    (tmp_path / "scene" / "organ.toml").write_text(ORGAN)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "scene" / "organ.toml"


def test_files_are_searched_from_the_folder_of_the_scene_file(organ):
    scene = open_scene(organ)
    assert scene.title == "Organ"
    surface = pt.io.read_surface(organ.parent / "meshes" / "organ.off", units="mm")
    np.testing.assert_allclose(scene.surface.vertices, surface.vertices)
    points = scene.cloud.points
    held = scene.cloud.group("held")
    assert points[held, 2].max() <= -0.011 + BORDER_MARGIN * scene.cloud.spacing + 1e-9
    assert not np.setdiff1d(np.flatnonzero(points[:, 2] <= -0.0112), held).size  # the samples of the bone are coarse
    assert isinstance(scene.body, pt.Solid)


def test_painted_places_of_a_surface_are_in_its_unit(organ):
    pyvista = pytest.importorskip("pyvista")
    cloud = open_scene(organ).cloud
    mesh = pyvista.PolyData(1e3 * cloud.points)
    mesh["held"] = (cloud.points[:, 0] > 0.01).astype(float)
    mesh.save(organ.parent / "paint.vtp")
    text = ORGAN.partition("place")[0] + "place = { painted = { file = 'paint.vtp' } }"
    organ.write_text(text)
    expected = np.intersect1d(np.flatnonzero(cloud.points[:, 0] > 0.01), cloud.face_nodes)
    np.testing.assert_array_equal(open_scene(organ).cloud.group("held"), expected)


def test_missing_surfaces_and_spacings_are_refused(organ):
    (organ.parent / "meshes" / "bone.off").unlink()
    with pytest.raises(FileNotFoundError, match=r"bone\.off"):
        _ = open_scene(organ).cloud
    with pytest.raises(FileNotFoundError, match=r"bone\.off"):
        _ = open_scene(organ).digest
    organ.write_text(ORGAN.replace('spacing = "6 mm"', ""))
    with pytest.raises(pt.InputError, match=r"spacing of \[body\] must be given"):
        _ = open_scene(organ).cloud


def test_the_digest_changes_with_what_a_model_depends_on_only(organ):
    before = open_scene(organ).digest
    assert open_scene(organ).digest == before
    for settings in (
        {"paths": 3}, {"held_out": 1}, {"modes": 5}, {"tolerance": 0.1}, {"cubature": 0.1}, {"training.seed": 4},
        {"run.duration": 3.0},
    ):  # fmt: skip
        assert open_scene(organ, settings).digest == before, settings
    for settings in ({"spacing": 0.005}, {"poisson": 0.3}, {"C1": 900}, {"depth": 0.01}, {"grasps": 0}, {"scale": 1.1}):
        assert open_scene(organ, settings).digest != before, settings
    organ.write_text(ORGAN.replace('"5 mm"', '"6 mm"'))
    assert open_scene(organ).digest != before
    organ.write_text("title = 'Another'\n" + ORGAN)
    assert open_scene(organ).digest == before
    surface = ellipsoid()
    off(organ.parent / "meshes" / "organ.off", pt.Surface(1.01 * surface.vertices, surface.triangles))
    assert open_scene(organ).digest != before


# settings


def test_settings_replace_values_of_the_file():
    about = parse_description(BOX, "box")
    changed = with_settings(about, {"spacing": "5 mm", "tissue.poisson": 0.3, "C1": "2 kPa", "training.every": 0.02})
    assert changed.body.spacing == pytest.approx(0.005)
    assert changed.tissue == dataclasses.replace(about.tissue, poisson=0.3, parameters={"C1": "2 kPa"})
    assert changed.training.every == 0.02
    assert dataclasses.replace(changed, body=about.body, tissue=about.tissue, training=about.training) == about


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"every": 0.1}, "settings must name one key, got 'every'; give run.every or training.every"),
        ({"spacng": 0.1}, r"settings must be keys of the scene, got 'spacng'; did you mean spacing\?"),
        ({"spacing": 5}, r"^spacing must be in \(0, 1\] m, got 5"),
        ({"tissue.poisson": 3}, r"^tissue\.poisson must be in"),
        ({"low": [0, 0, "1 s"]}, r"^low\.2 must have one of the units"),
        ({"spacing": "5 kg"}, r"^spacing must have one of the units"),
        ({"generated": "disc"}, "surface must have size for a box, and only for a box"),
        ({"run.every": 1.0, "run.duration": 0.5}, "run must have every of at most the duration"),
        ({"C9": 1}, "settings must be keys of the scene, got 'C9'"),
        ({"": 1}, "settings must be keys of the scene, got ''"),
    ],
)
def test_wrong_settings_are_refused_by_key(settings, said):
    with pytest.raises(pt.InputError, match=said):
        with_settings(parse_description(BOX, "box"), settings)


def test_a_scene_of_a_campaign_is_opened_again_with_its_settings(write):
    path = write(BOX + "[tool]\nholds = 'x+'\n[training]\nhigh = ['1 mm', 0, 0]\n")
    scene = open_scene(path, {"spacing": "7.5 mm", "training.duration": 0.2})
    made = training_of(scene, scene.settings)
    again = open_training(str(path), made.parameters)
    np.testing.assert_array_equal(again.model.cloud.points, made.model.cloud.points)
    assert again.path(0)[1] == made.path(0)[1] == 0.2
    assert again.tools == ("x+",)
    finer = scene.with_body(spacing=0.006)
    assert finer.settings == {"body.spacing": 0.006, "training.duration": 0.2}
    again = open_training(str(path), training_of(finer, finer.settings).parameters)
    np.testing.assert_array_equal(again.model.cloud.points, finer.cloud.points)
    path.write_text(path.read_text().replace("1 mm", "2 mm"))
    with pytest.raises(pt.InputError, match="or a file that it names, has changed; open the changed scene in another"):
        open_training(str(path), made.parameters)
    with pytest.raises(pt.InputError, match="low must be a number or a text to train with, got"):
        open_training(str(path), {"low": [0, 0, 0]})


def test_a_scene_without_supports_says_what_is_held(tmp_path):
    text = (
        '[surface]\ngenerated = "box"\nsize = ["60 mm", "60 mm", "40 mm"]\n'
        '[body]\nspacing = "10 mm"\n[tissue]\nlaw = "NeoHookean"\n'
    )
    path = tmp_path / "free.toml"
    path.write_text(text + 'parameters = { C1 = "1100 Pa" }\n', encoding="utf-8")
    scene = pt.open_scene(path)
    assert scene.cloud is not None
    assert [note for note in scene.notes if "the scene has none, so the side 'back' of the body is held" in note]
