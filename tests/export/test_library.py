"""An exported library: the engine's numbers in C, C# and for another processor, and what it refuses."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from exported import (
    BALL,
    FORCE,
    SIZE,
    SPACING,
    TOOL_FORCE,
    Engine,
    Library,
    coordinates_part,
    pose_at,
    set_tool,
    step_through,
    tool_record,
)

import palpate as pt
from palpate.dynamics.contact import kinds
from palpate.realtime.record import HEADER_SIZE, TOOL_DTYPE, field_offset

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler"),
]
PERIODS, PLACE, OTHER = 400, (0.024, 0.038, SIZE[2] + BALL + 0.001), (0.052, 0.012, SIZE[2] + 0.007)
STRICT_WARNINGS = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]


def needs(program):
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


@pytest.fixture
def library(exported_folder):
    return Library(exported_folder, "organ")


def press(model, periods=200):
    set_tool(model, 0, (BALL, 0.0, 0.0), PLACE, 0.3)
    return [step(model, pose_at(k / periods, True)) for k in range(periods)]


def step(model, pose):
    model.arrays["pose"][0] = pose
    assert model("step") == 0
    return model.arrays["record"].copy()


def run(*command, cwd=None):
    done = subprocess.run([str(part) for part in command], capture_output=True, cwd=cwd, check=False)
    assert done.returncode == 0, (done.stdout[-1000:], done.stderr[-3000:])
    return done.stdout


# numbers


def test_presses_and_grasps_are_those_of_the_engine(library, model_file):
    records, vertices, _ = step_through(library, PERIODS, True)
    model = pt.load(model_file)
    expected, expected_vertices, _ = step_through(Engine(model), PERIODS, True)
    force, coordinates = slice(FORCE, FORCE + 3), coordinates_part(library, model.count)
    for part in (force, coordinates):
        scale = np.abs(expected[:, part]).max()
        assert scale > 0
        np.testing.assert_allclose(records[:, part], expected[:, part], rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(vertices, expected_vertices, rtol=0, atol=1e-8)
    assert np.abs(records[:, FORCE + 2]).max() > 0.5  # of a press and of a pull
    assert records[: PERIODS // 2, FORCE + 2].max() > 0 > records[PERIODS // 2 :, FORCE + 2].min()


def test_two_tools_have_the_records_of_the_engine(library, model_file):
    model, records = pt.load(model_file), []
    for each in (library, Engine(model)):
        set_tool(each, 0, (BALL, 0.0, 0.0), PLACE, 0.3)
        set_tool(each, 0, (0.006, 0.0, 0.0), OTHER, 0.3, 1)
        for k in range(PERIODS):
            s = k / PERIODS
            each.arrays["pose"][:] = pose_at(s, True), pose_at(1.0 - s, True)
            assert each("step") == 0
            parts = [tool_record(each, index) for index in (0, 1)]
            record = each.arrays["record"]
            records.append(np.concatenate([record[coordinates_part(library, model.count)], *parts]))
    numbers, expected = np.array(records).reshape(2, PERIODS, -1)
    sizes = np.linalg.norm(numbers[:, model.count :].reshape(PERIODS, 2, -1)[..., TOOL_FORCE : TOOL_FORCE + 3], axis=2)
    assert (sizes.max(axis=0) > 0.3).all()
    assert (sizes > 0.0).all(axis=1).sum() > PERIODS // 4  # both press at the same time
    scale = np.maximum(np.abs(expected).max(axis=(0, 1)), 1e-12)
    np.testing.assert_allclose(numbers / scale, expected / scale, rtol=0, atol=1e-9)


def test_forceps_on_nodes_that_others_hold_are_refused(library):
    set_tool(library, kinds.BONDED, (0.012, 0.0, 0.0), (0.03, 0.03, SIZE[2]), 0.0)
    with pytest.raises(RuntimeError, match="is refused"):
        set_tool(library, kinds.BONDED, (0.012, 0.0, 0.0), (0.04, 0.03, SIZE[2]), 0.0, 1)
    set_tool(library, kinds.BONDED, (0.007, 0.0, 0.0), (0.0525, 0.0525, SIZE[2]), 0.0, 1)
    set_tool(library, kinds.BONDED, (0.012, 0.0, 0.0), (0.04, 0.03, SIZE[2]), 0.0)  # in place of itself


@pytest.mark.parametrize(
    ("kind", "sizes", "height"),
    [
        (kinds.CAPSULE, (0.008, 0.01, 0.0), 0.018),
        (kinds.PLANE, (0.0, 0.0, 0.0), 0.0),
        (kinds.PUNCH, (0.012, 0.0, 6e-4), 0.0),
    ],
)
def test_other_tools_press_as_in_the_engine(library, model_file, kind, sizes, height):
    engine, records = Engine(pt.load(model_file)), []
    turn = (0.0, 1.0, 0.0, 0.0) if kind == kinds.PLANE else (1.0, 0.0, 0.0, 0.0)  # its tissue side is up
    for model in (library, engine):
        arrays = model.arrays
        arrays["tool_kind"][0], arrays["tool_sizes"][:], arrays["tool_friction"][0] = kind, sizes, 0.2
        arrays["tool_pose"][:] = (0.03, 0.03, SIZE[2] + height + 0.001, *turn)
        assert model("set_tool") == 0
        records.append([step(model, (0.0, 0.0, -0.003 * min(1.0, k / 80), 1, 0, 0, 0)) for k in range(120)])
    forces = np.array(records)[:, :, FORCE : FORCE + 3]
    assert forces[0, -1, 2] > 0.1
    np.testing.assert_allclose(forces[0], forces[1], rtol=0, atol=1e-12 * np.abs(forces).max())


def test_a_small_ball_is_held_and_not_trusted_where_it_would_pass_between_the_nodes(library):
    radius = 1.02 * SPACING
    set_tool(library, 0, (radius, 0.0, 0.0), (0.025, 0.035, SIZE[2] + radius + 0.001), 0.0)
    deep = 0.025
    records = [step(library, (0.0, 0.0, -deep * min(1.0, k / 800), 1, 0, 0, 0)) for k in range(1000)]
    assert records[-1][field_offset("trust")] > 1.0
    assert records[-1][FORCE + 2] > 0.5  # on the ball, which has not passed


def test_vertices_are_those_that_the_page_draws(library, model_file):
    from palpate.realtime.bodies.display_surface import Surface
    from palpate.reduction.contact.surface import PAIRS

    model = pt.load(model_file)
    engine, surface = Engine(model), Surface(model)
    data, work = engine._functions["step"][1][:2]
    for drawn in (library, engine):
        set_tool(drawn, kinds.BONDED, (0.008, 0.0, 0.0), (0.0525, 0.015, SIZE[2]), 0.0, 1)
        drawn.arrays["pose"][1, 2] = 0.001  # forceps pull while the ball presses
        press(drawn, 100)
        drawn("vertices")
    contact = data.inner.contact_work
    count = contact.numbers[PAIRS]
    assert count > 0
    tools = contact.tool[:count]
    bonded = data.inner.tools.kind[tools] == kinds.BONDED
    assert bonded.any()
    assert not bonded.all()
    moved = surface.displacements(work.q, contact.node[:count], contact.push[:count], bonded, tools)
    for drawn in (library, engine):
        np.testing.assert_allclose(drawn.arrays["vertices"], surface.rest + moved, rtol=0, atol=1e-8)


def test_a_copy_of_the_memory_is_another_model_in_the_same_state(library):
    press(library, 100)
    memory = library.memory.copy()
    after = [step(library, pose_at(0.5 + k / 200, True)) for k in range(50)]
    library.memory[:] = memory
    again = [step(library, pose_at(0.5 + k / 200, True)) for k in range(50)]
    np.testing.assert_array_equal(after, again)


def test_a_coupled_tool_begins_at_rest_where_it_is_put(library):
    library.arrays["coupling"][0] = (300.0, 2 * np.sqrt(300 * 0.05), 0.05, np.inf)
    press(library, 100)
    assert library.arrays["tool_position"][0, 2] < 0.0
    set_tool(library, 0, (BALL, 0.0, 0.0), PLACE, 0.3)
    assert not library.arrays["tool_position"].any()
    assert not library.arrays["record"][field_offset("position") : field_offset("position") + 3].any()
    record = step(library, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    assert not record[FORCE : FORCE + 3].any()
    assert not library.arrays["tool_position"].any()  # no force of the tool before moves it


def test_a_reset_returns_to_rest(library):
    first = press(library)
    assert library("reset") == 0
    assert not library.arrays["record"][FORCE : FORCE + 3].any()
    again, of_tool = press(library), HEADER_SIZE + field_offset("stiffness", TOOL_DTYPE)
    for record in (*first, *again):  # the stiffness follows from the tangents of the periods before
        for place in (field_offset("stiffness"), of_tool):
            record[place : place + 9] = 0.0
    np.testing.assert_array_equal(again, first)


def test_a_clamped_tool_stays_where_the_model_is_trusted(library):
    library.arrays["options"][5] = 1.0  # PALPATE_CLAMP
    set_tool(library, 0, (BALL, 0.0, 0.0), PLACE, 0.3)
    for k in range(400):
        record = step(library, (0.0, 0.0, -0.02 * min(1.0, k / 200), 1.0, 0.0, 0.0, 0.0))
    height = record[field_offset("position") + 2]
    assert record[field_offset("clamped")] == 1.0
    assert -0.015 < height < 0.0
    assert record[field_offset("trust")] < 1.5


def test_the_force_limit_and_the_moduli_are_those_of_the_options(library):
    free = press(library)[-1]
    library("reset")
    library.arrays["options"][1] = 0.2
    limited = press(library)[-1]
    assert np.linalg.norm(limited[FORCE : FORCE + 3]) == pytest.approx(0.2)
    assert limited[field_offset("limited")] == 1.0
    library("reset")
    library.arrays["options"][1] = np.inf
    library.arrays["modulus_ratio"][:] = 2.0
    stiff = press(library)[-1]
    assert stiff[FORCE + 2] == pytest.approx(2.0 * free[FORCE + 2], rel=0.1)


def test_the_force_of_a_model_that_has_diverged_is_zero(library):
    assert np.any(press(library)[-1][FORCE : FORCE + 3])
    library.arrays["modulus_ratio"][:] = np.nan
    assert 2 in [library("step") for _ in range(20)]  # PALPATE_DIVERGED
    assert not library.arrays["record"][FORCE : FORCE + 15].any()  # with moment and stiffness
    assert library("step") == 2


# the object file


@needs("nm")
def test_no_kernel_of_a_period_allocates_or_calls_python(library, exported_folder):
    """The object has the functions of the header alone, and needs no function of Python, of Numba or of memory."""
    symbols = [line.split()[:2] for line in run("nm", "-g", "-P", exported_folder / "organ.o").decode().splitlines()]
    defined = sorted(name for name, kind in symbols if kind != "U")
    functions = ("check", "file_size", "memory_size", "reset", "set_tool", "step", "vertices")
    assert defined == [f"organ_{name}" for name in functions]
    needed = {name for name, kind in symbols if kind == "U"}
    assert not [name for name in needed if re.match("_?Py|NRT|_?numba|malloc|calloc|realloc|free", name)], needed
    assert library._number("file_size") < library._number("memory_size")


# bad input


@pytest.mark.parametrize("pose", [(np.nan, 0, 0, 1, 0, 0, 0), (0, 0, 0, 0, 0, 0, 0), (5, 0, 0, 1, 0, 0, 0)])
def test_a_pose_that_is_not_finite_or_jumps_keeps_the_last(library, pose):
    press(library, 50)
    before = library.arrays["record"][:HEADER_SIZE].copy()
    library.arrays["pose"][0] = pose
    assert library("step") == 1
    after, place = library.arrays["record"], field_offset("position")
    assert after[0] > before[0]  # the period was taken
    np.testing.assert_array_equal(after[place : place + 7], before[place : place + 7])


@pytest.mark.parametrize(
    ("name", "value"), [("period", 0.0), ("period", np.nan), ("force_limit", -1.0), ("out_of_training", 2.0)]
)
def test_options_out_of_range_are_refused(library, name, value):
    from palpate.export.entries import OPTION_NAMES

    library.arrays["options"][OPTION_NAMES.index(name)] = value
    assert library("step") == 3


@pytest.mark.parametrize("sizes", [(0.0, 0.0, 0.0), (np.nan, 0.0, 0.0), (0.01, -1.0, 0.0)])
def test_a_tool_out_of_range_is_refused(library, sizes):
    library.arrays["tool_kind"][0], library.arrays["tool_sizes"][:] = 0, sizes
    assert library("set_tool") == 3


def test_a_library_refuses_every_file_but_its_own(library, exported_folder):
    assert library("check") == 0
    size, random = library._number("file_size"), np.random.default_rng(0)
    for place in [*random.integers(64, size, 200), 0, 8, 12, 16, 24, size - 1]:
        library.memory[place] ^= 1 << int(random.integers(8))
        assert library("check") != 0, place
        library.memory[:size] = np.frombuffer((exported_folder / "organ.palpate").read_bytes(), np.uint8)
    assert library("check") == 0


# programs


@pytest.fixture
def poses(tmp_path):
    rows = [pose_at(k / 200, True) for k in range(200)]
    path = tmp_path / "poses"
    path.write_bytes(np.array([*PLACE, 1, 0, 0, 0, BALL, 0, 0, *np.ravel(rows)], dtype=float).tobytes())
    return path


@pytest.mark.each_kind(compiler=["gcc"])
@pytest.mark.parametrize("compiler", [pytest.param(name, marks=needs(name)) for name in ("gcc", "clang", "g++")])
def test_a_c_program_takes_the_same_periods(library, exported_folder, poses, tmp_path, compiler):
    source, program = Path(__file__).with_name("steps.c"), tmp_path / "steps"
    language = ["-x", "c++"] if compiler == "g++" else ["-std=c99", "-pedantic"]
    command = [compiler, *language, *STRICT_WARNINGS, f"-I{exported_folder}", source, "-x", "none"]
    run(*command, exported_folder / "organ.o", "-lm", "-o", program)
    records = np.frombuffer(run(program, exported_folder / "organ.palpate", poses)).reshape(200, -1)
    np.testing.assert_array_equal(records, press(library))


TWO_TOOLS = """
#include "organ.h"
int main(int argc, char **argv) {
    void *block, *memory;
    double pose[7] = {0, 0, -0.001, 1, 0, 0, 0}, *poses;
    const double *record;
    if (argc < 2 || organ_open(argv[1], &block, &memory)) return 1;
    poses = (double *)palpate_array(memory, "pose");
    record = (const double *)palpate_array(memory, "record");
    if (palpate_set_pose(memory, 2, pose) != PALPATE_BAD_VALUE || palpate_tool(memory, 2)) return 2;
    if (palpate_set_pose(memory, 1, pose) || poses[2] != 0 || poses[7 + 2] != -0.001) return 3;
    if (organ_step(memory)) return 4;
    if (palpate_tool(memory, 0) != record + PALPATE_HEADER_SIZE) return 5;
    if (palpate_tool(memory, 1)[PALPATE_TOOL_POSITION + 2] >= 0 || record[PALPATE_POSITION + 2] != 0) return 6;
    free(block);
    return 0;
}
"""


def test_the_header_moves_the_second_tool_and_refuses_a_third(exported_folder, tmp_path):
    (tmp_path / "two.c").write_text(TWO_TOOLS)
    sources = [f"-I{exported_folder}", tmp_path / "two.c", exported_folder / "organ.o"]
    run("cc", "-std=c99", "-pedantic", *STRICT_WARNINGS, *sources, "-lm", "-o", tmp_path / "two")
    run(tmp_path / "two", exported_folder / "organ.palpate")


def test_damaged_and_missing_files_end_a_program_with_a_line(exported_folder, tmp_path):
    run("cc", "-O1", *STRICT_WARNINGS, "main.c", "organ.o", "-lm", "-o", tmp_path / "press", cwd=exported_folder)
    content = (exported_folder / "organ.palpate").read_bytes()
    short, long = tmp_path / "short", tmp_path / "long"
    short.write_bytes(content[:-100])
    long.write_bytes(content + b"\0")
    for path in (short, long, tmp_path / "none", tmp_path):
        done = subprocess.run([tmp_path / "press", path, "0.1"], capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert len(done.stderr.splitlines()) == 1
    output = run(tmp_path / "press", exported_folder / "organ.palpate", "0.3").decode()
    assert "deadlines missed" in output
    assert "force" in output


def test_damaged_files_are_refused_under_the_address_sanitizer(exported_folder, tmp_path):
    source, program = Path(__file__).with_name("damaged.c"), tmp_path / "damaged"
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover"]
    run("cc", "-O1", *sanitizers, f"-I{exported_folder}", source, exported_folder / "organ.o", "-lm", "-o", program)
    output = run(program, exported_folder / "organ.palpate", tmp_path / "scratch", 210, 1)
    assert output == b"210 of 210\n"


@pytest.mark.release
@needs("cmake")
def test_the_cmake_file_builds_the_example(exported_folder, tmp_path):
    run("cmake", "-S", exported_folder, "-B", tmp_path / "build")
    run("cmake", "--build", tmp_path / "build")
    assert b"of 100 deadlines missed" in run("./press", "organ.palpate", "0.1", cwd=tmp_path / "build")


@pytest.mark.release
@needs("aarch64-linux-gnu-gcc")
@needs("qemu-aarch64")
def test_another_processor_computes_the_same(library, folder_for_arm, poses, tmp_path):
    source, program = Path(__file__).with_name("steps.c"), tmp_path / "steps"
    objects = folder_for_arm / "organ.linux-aarch64.o"
    run("aarch64-linux-gnu-gcc", "-static", f"-I{folder_for_arm}", source, objects, "-lm", "-o", program)
    records = np.frombuffer(run("qemu-aarch64", program, folder_for_arm / "organ.palpate", poses)).reshape(200, -1)
    expected = np.array(press(library))
    scale = np.maximum(np.abs(expected).max(axis=0), 1e-30)
    finite = np.isfinite(expected).all(axis=0)
    assert np.abs((records - expected)[:, finite] / scale[finite]).max() < 1e-12


@pytest.mark.release
@needs("mcs")
@needs("mono")
def test_csharp_takes_the_same_periods(library, exported_folder, tmp_path):
    for name in ("liborgan.so", "organ.palpate"):
        shutil.copy(exported_folder / name, tmp_path)
    (tmp_path / "other").write_bytes(b"PALPATE")
    run("mcs", f"-out:{tmp_path / 'steps.exe'}", exported_folder / "Organ.cs", Path(__file__).with_name("Steps.cs"))
    lines = run("mono", "steps.exe", "organ.palpate", "other", cwd=tmp_path).decode().splitlines()
    set_tool(library, 0, (BALL, 0.0, 0.0), PLACE, 0.3)
    for k in range(200):
        record = step(library, (0.0, 0.0, -0.005 * min(1.0, k / 100), 1.0, 0.0, 0.0, 0.0))
    np.testing.assert_array_equal([float(part) for part in lines[0].split()], record[FORCE : FORCE + 3])
    numbers = [3 * len(library.arrays["vertices"]), library.arrays["triangles"].size]
    assert lines[1].split() == [str(number) for number in numbers]
    assert lines[2] == "10 of 10"  # calls after Dispose()
    assert lines[3] == "True"
