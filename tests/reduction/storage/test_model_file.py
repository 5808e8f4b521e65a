"""A reduced model comes back from its file as it went in, or not at all."""

from __future__ import annotations

import errno
import json
import os
import re
import zlib
from dataclasses import fields, replace
from hashlib import sha256
from pathlib import Path

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.core.sealed import HEAD_BYTES, ArrayEntry, _digest_of_rest, open_sealed, write_sealed
from palpate.dynamics.loads.supports import supports_of
from palpate.dynamics.material.fibres import prepare_fibres
from palpate.dynamics.material.tissue import TissueField
from palpate.realtime.bodies.display_surface import Surface
from palpate.reduction.contact.compliance import SurfaceCompliance
from palpate.reduction.contact.interior import Interior
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.data import (
    UNLIMITED_SCALE,
    ReducedData,
    SampledBasis,
    Scales,
    TrainedRange,
    TrialAndTestBasis,
)
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage import model_file as storage
from palpate.reduction.storage.body import BODY_ARRAYS
from palpate.reduction.storage.compliance import pack_flexibilities, unpack_flexibilities
from palpate.reduction.storage.model_file import CURVE_KEYS, MODEL_ARRAYS


def flat(data):
    """The fields of parts and of what they are made of, by name."""
    result = {}
    parts = (data.cloud, data.cubature, data.tissue, data.basis, data.sampled, data.trained)
    for owner in (data, *parts):
        result |= {f"{type(owner).__name__}.{f.name}": getattr(owner, f.name) for f in fields(owner)}
    fibres = data.tissue.fibres
    if fibres is not None:  # compared by what they are made of
        result |= {"law": type(fibres), "directions": fibres.directions, "c": fibres.coefficients}
    inner = (*parts, fibres)
    return {name: value for name, value in result.items() if value is None or all(value is not each for each in inner)}


def assert_equal(found, expected):
    for name, value in flat(expected).items():
        np.testing.assert_equal(flat(found)[name], value, err_msg=name)


def rounded(data):
    """The parts with the columns that their file holds."""
    vectors = data.basis.vectors.astype(np.float32).astype(float)
    return replace(data, basis=replace(data.basis, vectors=vectors))


def made_up(cloud, material, *, modes, samples=5, fixed=(), prescribed=(), lifting_count=0):
    """Parts with random numbers in them: none of a body, but of the right shapes."""
    draw = np.random.default_rng(7).normal
    count = modes + lifting_count + 3 * len(fixed)
    columns = draw(size=(count, len(cloud), 3))
    for k in range(modes, count):  # of lifting functions and test fields only one component is not zero
        columns[k, :, np.arange(3) != k % 3] = 0.0
    nodes = np.sort(np.random.default_rng(8).choice(len(cloud), samples, replace=False))
    rule = Cubature(nodes, 1e-8 * (1 + draw(size=samples) ** 2), draw(size=(max(1, modes // 4), samples)), 1e-3)
    return ReducedData(
        cloud, TissueField(material, None, np.zeros(0), None, len(cloud)), supports_of(fixed), prescribed,
        cloud.volumes, 1e-4, 20.0, TrialAndTestBasis(columns, modes, lifting_count),
        SampledBasis(rule, draw(size=(samples, count, 9)), np.eye(count)),
        TrainedRange(draw(size=(240, modes + lifting_count)), Scales(1e-3)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def push():
    """A motion of the bar's tip, and gravity."""
    way = np.array([1e-3, 5e-4, 2e-4])
    motion = pt.PrescribedMotion("tip", displacement=lambda points, t: np.sin(300 * t) ** 2 * way)
    return [motion, pt.Gravity((0.0, 2.0, -9.81))]


@pytest.fixture(scope="module")
def trained(bar, tissue, push):
    """A bar that a tool moves, trained and tried on one run; fibres are added to its file, which no step needs."""
    full = pt.Solid(bar, tissue, fixed="x-", form="energy")
    run = pt.rollout(full, push, duration=0.01, every=0.0005)
    model = pt.hyper_reduce(full, run, modes=4, prescribed="tip", held_out=[(push, run)])
    touched, made_up = np.unique(bar.face_nodes), np.random.default_rng(0)
    compliance = SurfaceCompliance(
        touched, made_up.integers(0, 4, (len(touched), 2)),
        np.full((len(touched), 2), 0.5), np.eye(12, dtype=np.float32),
        made_up.integers(0, len(touched), (len(touched), 4)), np.full((len(touched), 4, 3, 3), 1e-3, dtype=np.float32),
        made_up.integers(0, len(touched), (len(touched), 3)), np.full((len(touched), 3), 1 / 3), np.array([0.2, 1.5]),
        1.2,
        Interior(
            np.setdiff1d(np.arange(len(bar)), touched), made_up.standard_normal((12, 15)).astype(np.float32),
            made_up.integers(0, 5, (len(bar) - len(touched), 2)), np.full((len(bar) - len(touched), 2), 0.5),
            0.7,
        ),
    )  # fmt: skip
    slanted = pt.materials.Fibres(k1=5e3, k2=2.0, dispersion=0.1, directions=(0.6, 0.8, 0.0))
    fibres = prepare_fibres(slanted, tissue, "energy", bar.points)
    return pt.ReducedModel(replace(model.data, compliance=compliance, tissue=replace(model.data.tissue, fibres=fibres)))


@pytest.fixture(scope="module")
def saved(trained, tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "bar.rom"
    pt.save(trained, path)
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "some.rom"


@pytest.fixture
def altered(saved, path, forge):
    """Change a copy of the file and renew its checksums, so that the change itself has to be noticed."""

    def alter(change):
        return forge(saved, change, storage.FORMAT, storage.VERSION, path)

    return alter


# there and back


def test_a_loaded_model_has_the_arrays_of_the_saved_one(trained, saved):
    assert trained.data.lifting_count > 0
    assert trained.report["held_out"]["mean"]["displacement"] > 0
    assert_equal(pt.load(saved).data, rounded(trained.data))
    assert os.listdir(saved.parent) == ["bar.rom"]


@pytest.mark.slow
@pytest.mark.parametrize("step", [None, 2.5e-4])
@pytest.mark.parametrize("single", [True, False])
def test_a_model_is_loaded_with_its_step_rule_and_precision(trained, path, push, step, single):
    model = ReducedModel(rounded(trained.data), step=step, single=single)
    pt.save(model, path)
    loaded = pt.load(path)
    assert (loaded.step, loaded.single) == (step, single)
    expected, found = (pt.rollout(m, push, duration=0.003, every=0.001, progress=False) for m in (model, loaded))
    np.testing.assert_array_equal(found.displacements, expected.displacements)
    assert found.steps[-1] == expected.steps[-1]


@pytest.mark.parametrize("step", [-1e-3, np.nan, np.inf])
def test_invalid_steps_are_not_saved(trained, path, step):
    with pytest.raises(pt.InputError, match=r"step must be .*, got .*"):
        pt.save(ReducedModel(trained.data, step=step), path)
    assert not path.exists()


@pytest.mark.slow
def test_the_trust_of_a_loaded_model_is_that_of_the_saved_one(trained, saved, push):
    assert trained.data.residual_fields > 0
    loaded, prepared = pt.load(saved), trained.prepare(push)
    state = replace(trained.state(prepared, time=0.004), coordinates=trained.data.training_states[15])
    expected = trained.trust(state, prepared)
    assert loaded.trust(state, loaded.prepare(push)) == pytest.approx(expected, rel=1e-6)
    with pytest.raises(pt.InputError, match="of the same reduced model"):
        loaded.trust(state, prepared)
    assert loaded.expected_error(0.5) == trained.expected_error(0.5)


def test_a_file_without_interior_gives_a_model_with_compliance_at_its_surface_only(trained, altered):

    def drop(header, arrays):
        for name in [name for name in arrays if name.startswith("interior/")]:
            arrays.pop(name)

    found = pt.load(altered(drop)).data
    assert found.compliance.interior is None
    np.testing.assert_equal(found.compliance, trained.data.compliance._replace(interior=None))


def test_a_file_without_a_number_of_tools_is_of_a_model_that_met_one(trained, altered):
    two = pt.ReducedModel(trained.data.with_scales(trained_tools=2))
    assert pt.load(altered(lambda header, _: header.update(trained_tools=2))).data.scales.trained_tools == 2
    assert_equal(pt.load(altered(lambda header, _: header.pop("trained_tools"))).data, rounded(trained.data))
    with pytest.raises(pt.FileFormatError, match="trained_tools must be"):
        pt.load(altered(lambda header, _: header.update(trained_tools=0)))
    assert storage.contents(two)[0]["trained_tools"] == 2


@pytest.mark.parametrize("version", [12, 13])
def test_a_file_of_a_version_before_is_loaded(trained, saved, path, version):
    """Such files limit neither speed nor nearness to supports, and their error bounds mean something else."""
    file = open_sealed(saved, storage.FORMAT, storage.VERSION)
    arrays = {name: file.read(name) for name in file.arrays}
    if version == 12:
        del arrays["compliance/steps"]
        arrays["compliance/flexibility"] = trained.data.compliance.flexibility
    header = {name: value for name, value in file.header.items() if name not in storage.NEW_ATTRIBUTES}
    del header["trained_tools"]
    older = {"held_out": {"mean": {"displacement": 0.1}, "expected_error": {"level": 0.95, "displacement": {}}}}
    write_sealed(path, storage.FORMAT, version, header | {"report": json.dumps(older)}, arrays)
    found = pt.load(path).data
    assert found.scales.speed_scale == found.scales.nearness_scale == UNLIMITED_SCALE
    assert found.report == {"held_out": {"mean": {"displacement": 0.1}}}
    scales = {name: getattr(trained.data.scales, name) for name in storage.NEW_ATTRIBUTES}
    assert_equal(replace(found, report=trained.report).with_scales(**scales), rounded(trained.data))


@pytest.mark.parametrize("largest", [1, 100, 32_639, 32_640])
@pytest.mark.parametrize("step", [2.0**-13, 3.0, 2.0**-90, 2.0**-130])
def test_flexibilities_keep_every_bit(largest, step):
    draw, half = np.random.default_rng(largest), largest // 2
    numbers = draw.integers(-half, half + 1, (30, 30))
    numbers[3, 3] = largest
    symmetric = (step * np.tril(numbers) + step * np.tril(numbers, -1).T).astype(np.float32)
    arrays = {
        "compliance/flexibility": symmetric,
        "compliance/near_field": np.zeros((4, 2, 3, 3), np.float32),
        "interior/flexibility": (step * numbers).astype(np.float32),
    }
    packed = pack_flexibilities(arrays)
    small = largest <= 32_639 and step in (2.0**-13, 2.0**-90)
    assert packed["interior/flexibility"].dtype == ("<u2" if small else "<f4") or step == 3.0
    found = unpack_flexibilities(packed)
    assert found.keys() == arrays.keys()
    for name, values in arrays.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)


def test_a_file_of_a_loaded_model_is_the_same_file(saved, path):
    pt.save(pt.load(saved), path)
    assert path.read_bytes() == saved.read_bytes()


@pytest.mark.slow
def test_a_loaded_model_runs_as_the_saved_one_to_the_last_bit(trained, saved, push):
    models = ReducedModel(rounded(trained.data)), pt.load(saved)
    for step in (None, 2e-4):
        expected, found = (pt.rollout(m.with_step(step), push, duration=0.005, every=0.001) for m in models)
        assert np.abs(expected.displacements).max() > 1e-4
        for name in ("displacements", "velocities", "kinetic", "strain", "external", "dissipated"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        for name, force in expected.reactions.items():
            np.testing.assert_array_equal(found.reactions[name], force)


@pytest.mark.slow
def test_single_precision_of_the_columns_changes_forces_and_displacements_negligibly(trained, saved, push):
    loaded = pt.load(saved)
    state, prepared = trained.state(trained.prepare(push), time=0.004), trained.prepare(push)
    for coordinates in trained.data.training_states[::7]:
        np.testing.assert_array_equal(loaded.body.force(coordinates), trained.body.force(coordinates))
        assert loaded.body.energy(coordinates) == trained.body.energy(coordinates)
        moved = replace(state, coordinates=coordinates)
        expected = trained.displacement(moved, prepared)
        np.testing.assert_allclose(loaded.displacement(moved, prepared), expected, atol=1e-6 * np.abs(expected).max())
    expected, found = (pt.rollout(m, push, duration=0.005, every=0.001) for m in (trained, loaded))
    for name in ("displacements", "velocities"):
        size = np.abs(getattr(expected, name)).max()
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-5 * size)


def test_a_free_body_without_tools_and_groups_is_loaded(small_cloud, tissue, path):
    data = made_up(replace(small_cloud, groups={}), tissue, modes=3)
    pt.save(ReducedModel(data), path)
    assert_equal(pt.load(path).data, rounded(data))


@pytest.mark.parametrize("name", ["a/b", "..", "größe µ", "with space"])
def test_groups_may_have_any_name(small_cloud, tissue, path, name):
    cloud = replace(small_cloud, groups={name: np.array([3, 5]), "z": np.array([7])})
    data = made_up(cloud, tissue, modes=2, fixed=(name,))
    pt.save(ReducedModel(data), path)
    assert_equal(pt.load(path).data, rounded(data))


@pytest.mark.parametrize("given", ["poisson", "bulk"])
def test_a_material_keeps_every_bit_whichever_modulus_it_was_made_from(small_cloud, path, given):
    values = np.linspace(0, 0.499, 20) if given == "poisson" else np.linspace(1e3, 2e5, 20)
    for law in [pt.materials.MooneyRivlin(C1=7e2 / 3, C2=0.3e3, density=1000.1, **{given: value}) for value in values]:
        pt.save(ReducedModel(made_up(small_cloud, law, modes=2)), path)
        assert pt.load(path).material == law


def test_the_law_of_a_material_is_kept(small_cloud, path):
    for law in (
        pt.materials.NeoHookean(C1=123.4, density=999, bulk=12345.7),
        pt.materials.MooneyRivlin(C1=1, C2=0, density=1e3, poisson=0),
    ):
        pt.save(ReducedModel(made_up(small_cloud, law, modes=2)), path)
        assert pt.load(path).material == law


def test_a_stored_report_has_finite_numbers_of_any_type_and_length(small_cloud, tissue, path):
    report = {"whole": np.int64(3), "number": np.float32(0.5), "array": np.arange(3), "lost": float("inf")}
    data = replace(made_up(small_cloud, tissue, modes=2), report=report | {"runs": [{"x": 1 / 3}] * 20_000})
    pt.save(ReducedModel(data), path)
    found = pt.load(path).report
    assert found.pop("runs") == [{"x": 1 / 3}] * 20_000
    assert found == {"whole": 3, "number": 0.5, "array": [0, 1, 2], "lost": None}


def test_a_file_is_at_most_as_large_as_the_columns_in_single_precision_and_the_other_arrays(tissue, path):
    cloud = pt.box((0.039, 0.024, 0.019), spacing=0.001)
    data = made_up(cloud, tissue, modes=64, samples=400, fixed=("x-",), prescribed=("x+",), lifting_count=9)
    pt.save(ReducedModel(data), path)
    sizes, stored = {}, {}
    with h5py.File(path) as file:
        arrays = []
        file.visititems(lambda name, entry: arrays.append(entry) if isinstance(entry, h5py.Dataset) else None)
        for entry in arrays:
            sizes[entry.name], stored[entry.name] = entry.nbytes, entry.id.get_storage_size()
    assert sizes["/basis_vectors"] == 4 * data.trial_and_test_basis.size
    assert sum(stored.values()) <= path.stat().st_size < 1.01 * sum(stored.values())
    assert all(0.9 * sizes[name] >= stored[name] or sizes[name] == stored[name] for name in sizes)
    assert stored["/cloud/points"] < 0.2 * sizes["/cloud/points"]  # of a lattice
    assert_equal(pt.load(path).data, rounded(data))


def test_other_programs_can_read_units_parameters_and_arrays(trained, saved):
    with h5py.File(saved) as file:
        assert file.attrs["format"] == "palpate reduced model"
        assert (file.attrs["version"], file.attrs["units"], file.attrs["material"]) == (14, "SI", "MooneyRivlin")
        assert '"C1": 20000.0' in file.attrs["parameters"]
        assert file["basis_vectors"].dtype == np.float32
        np.testing.assert_array_equal(file["cubature/weights"], trained.data.cubature.weights)
        compliance, step = trained.data.compliance, file["compliance/steps"][0]
        lower = step * (file["compliance/flexibility"][:].astype(float) - 32896)
        np.testing.assert_array_equal(lower + np.tril(lower, -1).T, compliance.flexibility)
        assert file["interior/flexibility"].dtype == np.float32  # its values have no common step


# what is refused


def test_a_missing_file_is_named(path):
    with pytest.raises(FileNotFoundError, match=r"some\.rom"):
        pt.load(path)


@pytest.mark.parametrize("share", [0.03, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(saved, path, share):
    data = saved.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(
        pt.FileFormatError,
        match=r"some\.rom: the f(ile is truncated|irst bytes are).*train the model",
    ):
        pt.load(path)


@pytest.mark.parametrize("content", [b"", b"palpate", b"\x80\x04]q\x00." * 200, b"\x89HDF\r\n\x1a\n"])
def test_a_file_of_another_format_is_refused(path, content):
    path.write_bytes(content)
    with pytest.raises(pt.FileFormatError, match=r"some\.rom: this is not a palpate reduced model"):
        pt.load(path)


@pytest.mark.parametrize("name", ["bar.vtk", "bar.xyz", "bar.lti", "bar.rom.txt"])
def test_another_ending_is_refused_with_those_allowed(trained, tmp_path, name):
    for save in (trained.save, lambda path: pt.save(trained, path)):
        with pytest.raises(pt.InputError, match=r"must end in \.rom \(.*\) or \.h5 \(.*\) or \.vtkhdf .*, got 'bar\."):
            save(tmp_path / name)
    assert not os.listdir(tmp_path)
    with pytest.raises(pt.InputError, match=r"path of a reduced model must end in \.rom"):
        pt.load(tmp_path / name.replace(".lti", ".vtu"))


def test_bodies_equilibria_and_reduced_models_are_saved_by_one_rule(trained, bar, tissue, tmp_path):
    import pyvista

    solid = pt.Solid(bar, tissue, fixed="x-")
    rest = pt.equilibrium(solid, pt.SurfaceForce("x+", force=(0.1, 0, 0)))
    for k, thing in enumerate((trained, solid, rest)):
        path = tmp_path / f"{k}.vtkhdf"
        thing.save(path)
        content = pyvista.read(path)
        pt.save(thing, path)
        assert pyvista.read(path) == content
    np.testing.assert_array_equal(content["displacement"], rest.displacements)
    np.testing.assert_array_equal(content["stress"], rest.to_pyvista()["stress"])
    assert content["stress"].max() > 100.0
    pt.save(model=trained, path=tmp_path / "trained.rom")
    assert pt.load(tmp_path / "trained.rom").count == trained.count
    for thing in (solid, rest):
        with pytest.raises(pt.InputError, match=r"must end in \.vtkhdf \(.* for ParaView\), got 'x\.rom'"):
            thing.save(tmp_path / "x.rom")
    pt.rollout(solid, duration=1e-3, every=1e-3, file=tmp_path / "run.h5", progress=False)
    with pytest.raises(pt.FileFormatError, match=r"must be of a reduced model, got .*, a trajectory; use Trajectory"):
        pt.load(tmp_path / "run.h5")
    with pytest.raises(pt.InputError, match=r"model must be a body, a reduced model, a .*, got 3"):
        pt.save(3, tmp_path / "x.rom")


def test_a_trajectory_is_refused(path):
    none, vectors = np.zeros(0), np.zeros((0, 4, 3))
    run = path.with_suffix(".h5")
    pt.Trajectory("full", none, vectors, vectors, {}, none, none, none, none, none, np.zeros((4, 3))).save(run)
    run.rename(path)
    with pytest.raises(pt.FileFormatError, match=r"must be of a reduced model, got .*some\.rom, a trajectory"):
        pt.load(path)


def test_the_documentation_shows_the_version_of_files():
    text = (Path(__file__).parents[3] / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
    assert re.search(rf"{storage.FORMAT}\n +version (\d+)\n", text)[1] == str(storage.VERSION)


def test_another_version_is_refused_even_in_a_truncated_file(saved, path):
    path.write_bytes(saved.read_bytes().replace(b"version 14", b"version 11", 1)[:-7])
    with pytest.raises(pt.FileFormatError, match=r"some\.rom: this is of version 11, and version 14 is the one"):
        pt.load(path)


def test_a_flipped_bit_is_refused_wherever_it_is(saved, path):
    data, generator = saved.read_bytes(), np.random.default_rng(5)
    for place in [0, 30, 50, 511, 512, *generator.integers(len(data), size=60)]:
        changed = bytearray(data)
        changed[place] ^= 1 << int(generator.integers(8))
        path.write_bytes(changed)
        with pytest.raises(pt.FileFormatError, match=r"some\.rom"):
            pt.load(path)


def forged_bytes(saved, path, content, about):
    """Write a copy with other compressed bytes of an array, as many or fewer, and a right table."""
    data, name = saved.read_bytes(), "basis_vectors"
    at = int(data[:HEAD_BYTES].split(b"\n")[2].split()[1])
    table = json.loads(data[at:])
    entry = table["arrays"][name]
    start, size = entry["offset"], entry["deflated"]
    old = data[start : start + size]
    new = content(old)
    assert len(new) <= size
    entry |= {"sha256": sha256(new).hexdigest(), "deflated": len(new)}
    # the rest of the place belongs to no array
    data = data[:start] + new.ljust(size, b"\0") + data[start + size : at]
    path.write_bytes(data)
    entries = {k: ArrayEntry(e["type"], e["shape"], e["offset"], (), False, e.get("deflated"))
            for k, e in table["arrays"].items()}  # fmt: skip
    table["rest"] = _digest_of_rest(path, entries, at)
    entry |= about
    text = json.dumps(table).encode()
    head = f"{storage.FORMAT}\nversion {storage.VERSION}\ntable {at} {len(text)} {sha256(text).hexdigest()}\n".encode()
    path.write_bytes(head.ljust(HEAD_BYTES, b"\0") + data[HEAD_BYTES:] + text)


DEFLATED = {
    "other bytes": (lambda old: b"\0" * len(old), {}, "basis_vectors cannot be decompressed"),
    "bytes that end early": (lambda old: old[:-9], {}, "does not have the bytes that it is decompressed to"),
    "more bytes after the end": (
        lambda old: zlib.compress(zlib.decompress(old), 9) + b"1",
        {},
        "does not have the bytes",
    ),
    "fewer values": (lambda old: zlib.compress(bytes(32256)), {}, "beyond|does not have the bytes|fit into"),
    "far more values": (lambda old: zlib.compress(bytes(10**7)), {}, "does not have the bytes|fit into"),
    "a larger shape": (lambda old: old, {"shape": [24, 1000, 3]}, "does not have the bytes that it is decompressed to"),
    "a shape beyond the limit": (lambda old: old, {"shape": [24, 10**6, 3]}, "which does not fit into"),
    "no bytes": (lambda old: old, {"deflated": 0}, "has 0 compressed bytes"),
    "a number of bytes that is true": (lambda old: old, {"deflated": True}, "has True compressed bytes"),
    "more bytes than the file": (lambda old: old, {"deflated": 10**9}, "compressed bytes, which the file does not"),
    "negative bytes": (lambda old: old, {"deflated": -5}, "has -5 compressed bytes"),
}


@pytest.mark.parametrize("case", DEFLATED)
def test_forged_compressed_arrays_are_refused(saved, path, case):
    content, about, message = DEFLATED[case]
    forged_bytes(saved, path, content, about)
    with pytest.raises(pt.FileFormatError, match=rf"some\.rom: .*({message})"):
        pt.load(path)


def test_compressed_arrays_sealed_again_are_read(saved, path, trained):
    forged_bytes(saved, path, lambda old: old, {})
    assert_equal(pt.load(path).data, rounded(trained.data))


def put(name, values):
    """Replace an array by others' values, given the old ones."""

    def change(header, arrays):
        new = values(arrays[name])
        arrays[name] = np.array(new, arrays[name].dtype) if isinstance(new, list) else new

    return change


def entry(name, where, value):
    def change(header, arrays):
        arrays[name][where] = value

    return change


def attribute(name, value):
    def change(header, arrays):
        header[name] = value

    return change


def expected(curves):
    return attribute("report", json.dumps({"held_out": {"mean": {}, "expected_error": curves}}))


def supports(*groups):
    return attribute("supports", json.dumps([{"kind": "Clamp", "group": group} for group in groups]))


def parameters(old, new):
    def change(header, arrays):
        header["parameters"] = header["parameters"].replace(old, new)

    return change


ARRAYS = BODY_ARRAYS | MODEL_ARRAYS
LEVELS = {"level": 0.9, "least_level": 0.8}
CASES = {
    "an attribute missing": (lambda header, arrays: header.pop("distance_scale"), "header distance_scale is missing"),
    "an attribute of another type": (attribute("modes", "four"), "header modes must be of type int, got 'four'"),
    "a precision that is not a bool": (attribute("single", 2), "header single must be of type bool, got 2"),
    "a residual field too many": (attribute("residual_fields", 9), "array basis_vectors must have shape"),
    "no modes": (attribute("modes", 0), "modes must be .*, got 0"),
    "a basis vector too few": (
        put("basis_vectors", lambda a: a[1:]),
        r"basis_vectors must have shape \(24, 112, 3\) of <f4, got \(23, 112, 3\)",
    ),
    "basis vectors of fewer nodes": (
        put("basis_vectors", lambda a: a[:, 1:]),
        r"shape \(24, 112, 3\) of <f4, got \(24, 111, 3\)",
    ),
    "columns in double precision": (put("basis_vectors", lambda a: a.astype(float)), "of <f4, got .* of <f8"),
    "points in the plane": (put("cloud/points", lambda a: a[:, :2]), r"\(nodes, 3\) of <f8, got \(112, 2\)"),
    "a number for an array": (put("cubature/weights", lambda a: 1.0), r"weights must have .*, got \(\)"),
    "gradients of fewer samples": (put("gradients", lambda a: a[1:]), "array gradients must have shape"),
    "a text for names": (attribute("prescribed", "tip"), "header prescribed must be of type list"),
    "numbers for names": (attribute("prescribed", [1]), "header prescribed must be a list of different names"),
    "a name twice": (supports("x-", "x-"), "fixed must name each group once, got 'x-' 2 times"),
    "an attribute too many": (attribute("colour", "red"), "header colour is not one of a model"),
    "an array too many": (lambda header, arrays: arrays.update(colour=np.zeros(3)), "array colour is not one of"),
    "numbers beyond all sizes": (entry("basis_vectors", (0, 0, 0), 3e38), "basis_vectors must be finite, from"),
    "errors that are text": (attribute("report", '{"held_out": {"mean": {"force": "5"}}}'), "errors under held_out"),
    "errors that are nothing": (attribute("report", '{"held_out": 5}'), "errors under held_out"),
    "expected errors without a level": (expected({"displacement": {}}), "without levels and displacement"),
    "expected errors of another kind": (expected(LEVELS | {"moment": {}}), "without levels and displacement"),
    "expected errors without numbers": (expected(LEVELS | {"force": {"bound": 1}}), "of the force without bound"),
    "an expected error that is text": (
        expected(LEVELS | {"force": dict.fromkeys(CURVE_KEYS, "1")}), "bound must be a number, got '1'"
    ),
    "advice that is a number": (attribute("report", '{"advice": 5}'), "advice that is not a text"),
    "advice without end": (attribute("report", json.dumps({"advice": "a" * 2000})), "advice that is not a text"),
    "a scene that is a number": (attribute("report", '{"scene": 5}'), "a scene without name and parameters"),
    "a scene with a list": (attribute("report", '{"scene": {"name": "a", "parameters": {"b": []}}}'), "parameters of"),
    "a scene that is null": (attribute("report", '{"scene": null}'), "a scene without name and parameters"),
    "expected errors that are null": (expected(None), "without levels and displacement"),
    "lifting functions without tools": (attribute("prescribed", []), "lifting_count must be positive for models"),
    "no training state": (put("training_states", lambda a: a[:0]), "training_states must hold at least one state"),
    "shares of other patches": (put("compliance/shares", lambda a: 2 * a), "compliance/shares must have rows of sum 1"),
    "weights of other carriers": (put("compliance/weights", lambda a: -a), "compliance/weights must have rows of sum"),
    "a report nested deeply": (attribute("report", "[" * 100_000), "nested levels"),
    "a report without end": (attribute("report", '{"a": 1e999}'), "not valid JSON"),
    "fewer groups": (attribute("groups", ["x-", "tip"]), r"group_sizes must have shape \(2\) of <i8, got \(7,\)"),
    "an unknown material": (attribute("material", "Jelly"), "unknown material 'Jelly': the laws are "),
    "no material": (attribute("material", "Material"), "unknown material 'Material'"),
    "a module's name": (attribute("material", "np"), "unknown material 'np'"),
    "another law": (attribute("material", "NeoHookean"), "NeoHookean has the parameters"),
    "a parameter out of range": (
        parameters("20000.0", "-1.0"),
        "C1 must be .*, got -1.0",
    ),
    "a bulk modulus of another Poisson's ratio": (
        parameters("0.45", "0.44"),
        "bulk must be 200000 Pa with poisson = 0.44, got 241667",
    ),
    "a parameter that is not a number": (
        parameters("20000.0", '"a"'),
        "C1 must be a number",
    ),
    "parameters that are code": (attribute("parameters", "__import__('os')"), "parameters: this is not valid JSON"),
    "a report that is a list": (attribute("report", "[]"), "report is not a mapping"),
    "weights that are negative": (entry("cubature/weights", 0, -1e-9), "weights must be finite, from 0 to"),
    "samples out of range": (entry("cubature/nodes", -1, 112), "cubature/nodes must have indices from 0 to 111"),
    "faces out of range": (entry("cloud/face_nodes", 0, -1), "face_nodes must have indices"),
    "group nodes out of range": (entry("cloud/group_nodes", 0, 112), "group_nodes must have indices"),
    "triangles out of range": (entry("cloud/triangles", (0, 1), 10**9), "triangles must have indices"),
    "groups that overlap": (entry("cloud/group_sizes", 0, 1), "group_sizes does not share out"),
    "an empty group": (put("cloud/group_sizes", lambda a: [0, a[0] + a[1], *a[2:]]), "group_sizes must be .* from 1"),
    "a support of no kind": (attribute("supports", '[{"kind": "Wheel", "group": "x-"}]'), "support must be one of"),
    "a support without a group": (attribute("supports", '[{"kind": "Clamp", "group": 3}]'), "support must be one of"),
    "a roller without a normal": (
        attribute("supports", '[{"kind": "Roller", "group": "x-", "normal": [0, 0, 0]}]'),
        "normal of Roller on 'x-' must be three finite numbers",
    ),
    "supports that are not a list": (attribute("supports", "{}"), "header supports is not a list of mappings"),
    "a support that is not a group": (supports("w-"), "group must be one of .*, got 'w-'"),
    "fibres of an unknown law": (attribute("fibres", '{"law": "Hair"}'), "unknown law of fibres 'Hair'"),
    "fibres that are code": (attribute("fibres", "exit()"), "header fibres: this is not valid JSON"),
    "fibres without a parameter": (attribute("fibres", '{"law": "Fibres", "k1": 1.0}'), "fibres of Fibres have"),
    "fibres without a law": (attribute("fibres", "{}"), "directions of fibres, but no law"),
    "directions of no length": (entry("fibres/directions", (0, 3), 0.0), "unit vectors, got a length of 0 at nodes 3"),
    "directions for fewer nodes": (put("fibres/directions", lambda a: a[:, 1:]), r"shape .*, got \(1, 111, 3\)"),
    "no directions": (put("fibres/directions", lambda a: a[:0]), r"must have shape .*, got \(0, 112, 3\)"),
    "a touched node twice": (put("compliance/nodes", lambda a: [a[0], *a[:-1]]), "compliance/nodes names a node twice"),
    "inner nodes out of range": (entry("interior/nodes", -1, 112), "interior/nodes must have indices from 0 to 111"),
    "sources out of range": (entry("interior/sources", (0, 0), 5000), "sources names more than 5 nodes inside"),
    "half a node": (put("interior/flexibility", lambda a: a[:, 1:]), "holds 14 columns, not 3 a node"),
    "steps that are not powers of two": (entry("compliance/steps", 0, 3.0), "steps must hold powers of two"),
    "steps that are negative": (entry("compliance/steps", 0, -2.0), "steps must hold powers of two"),
    "steps that are not finite": (entry("compliance/steps", 0, np.nan), "steps must be finite"),
    "steps beyond single precision": (entry("compliance/steps", 0, 2.0**120), "steps must hold powers of two"),
    "more steps": (put("compliance/steps", lambda a: np.ones(4)), r"shape \(3\) of <f8, got \(4,\)"),
    "a step of numbers that have none": (entry("compliance/steps", 2, 1.0), "values of <f4 with a step"),
    "integers without a step": (entry("compliance/steps", 0, 0.0), "compliance/flexibility must .*, got .* of <u2"),
    "integers without steps": (lambda header, arrays: arrays.pop("compliance/steps"), "of <f4, got .* of <u2"),
    "a compliance that is not symmetric": (
        entry("compliance/flexibility", (0, 1), 0), "flexibility must be symmetric, or zero above its diagonal"
    ),
    "forces of other carriers": (put("interior/flexibility", lambda a: a[1:]), r"\(12, moved\) of <f4, got \(11, 15\)"),
    "a surface that tells nothing": (entry("interior/factor", 0, 0.0), "interior/factor must be .*, got 0.*"),
    "inner nodes alone": (lambda header, arrays: arrays.pop("interior/shares"), "array interior/shares is missing"),
    "a tool that is not a group": (attribute("prescribed", ["w+"]), "group must be one of .*, got 'w\\+'"),
    "volumes that are not positive": (entry("volumes", 3, 0.0), "volumes must be finite, positive"),
    "a node without volume": (entry("cloud/volumes", 3, 0.0), "volumes must be positive"),
    "columns that are all zero": (entry("basis_vectors", slice(None), 0.0), "Singular matrix"),
    **{
        f"{name} out of range": (attribute(name, value), f"{name} must be .*, got .*")
        for name, value in {"distance_scale": 0.0, "spacing": 0.0, "stiffness_damping": -1.0, "wave_speed": -0.1,
                            "residual": -1.0, "residual_scale": 0.0, "load_scale": 0.0, "step": -1e-3,
                            "residual_fields": -1}.items()
    },
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_forged_models_are_refused_even_with_a_right_checksum(altered, case):
    change, message = CASES[case]
    with pytest.raises(pt.FileFormatError, match=rf"some\.rom: .*{message}"):
        pt.load(altered(change))


def test_a_body_without_triangles_is_loaded_and_not_shown(altered):
    found = pt.load(altered(put("cloud/triangles", lambda a: a[:0])))
    with pytest.raises(pt.InputError, match="cloud must have triangles to be shown, got none"):
        Surface(found)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", [name for name, each in ARRAYS.items() if "f" in each.type])
def test_numbers_that_are_not_finite_are_refused(altered, name, value):
    def change(header, arrays):
        if name == "compliance/flexibility":  # integers with a step, which are finite
            arrays[name], arrays["compliance/steps"][0] = arrays[name].astype("<f4"), 0.0
        arrays[name][0] = value

    with pytest.raises(pt.FileFormatError, match=rf"some\.rom: array {name} must be finite"):
        pt.load(altered(change))


@pytest.mark.parametrize("name", ARRAYS)
def test_a_missing_dataset_is_named(altered, name):
    with pytest.raises(pt.FileFormatError, match=rf"some\.rom: array {name} is missing"):
        pt.load(altered(lambda header, arrays: arrays.pop(name)))


@pytest.mark.parametrize("name", ARRAYS)
def test_a_changed_entry_of_any_array_does_not_match_its_checksum(saved, path, name):
    array = open_sealed(saved, storage.FORMAT, storage.VERSION).arrays[name]
    content = bytearray(saved.read_bytes())
    content[array.offset] ^= 1
    path.write_bytes(content)
    with pytest.raises(pt.FileFormatError, match=rf"some\.rom: array {name} does not match its checksum"):
        pt.load(path)


@pytest.mark.parametrize("other", ["stiffness_damping", "prescribed", "report", "rest", "sha256"])
def test_a_changed_header_does_not_match_the_checksum(saved, path, other):
    content = saved.read_bytes()
    place = content.rindex(f'"{other}"'.encode()) + 1
    path.write_bytes(content[:place] + b"X" + content[place + 1 :])
    with pytest.raises(pt.FileFormatError, match=r"some\.rom: the table does not match its checksum"):
        pt.load(path)


def test_a_file_sealed_again_is_read(altered, trained):
    assert_equal(
        pt.load(altered(attribute("distance_scale", 0.5))).data, rounded(trained.data).with_scales(distance_scale=0.5)
    )


# whole or not at all


@pytest.mark.parametrize(
    ("record", "field", "name"),
    [
        ("basis", "vectors", "basis_vectors"),
        ("sampled", "gradients", "gradients"),
        ("trained", "states", "training_states"),
    ],
)
def test_models_that_could_not_be_loaded_are_not_saved(trained, saved, path, record, field, name):
    part = getattr(trained.data, record)
    values = getattr(part, field).copy()
    values.flat[0] = np.nan
    path.write_bytes(saved.read_bytes())
    with pytest.raises(pt.InputError, match=f"{name} must be finite"):
        pt.save(trained.with_data(**{record: replace(part, **{field: values})}), path)
    assert path.read_bytes() == saved.read_bytes()
    assert os.listdir(path.parent) == ["some.rom"]


def test_a_user_defined_material_is_not_saved(small_cloud, path):
    class Jelly(pt.materials.NeoHookean):
        pass

    class Impostor(pt.materials.NeoHookean):
        pass

    Impostor.__name__ = "NeoHookean"
    for law, message in ((Jelly, "is not one of palpate's"), (Impostor, "is not one of palpate's")):
        with pytest.raises(pt.InputError, match=message):
            pt.save(ReducedModel(made_up(small_cloud, law(C1=1e3, density=1000, poisson=0.4), modes=2)), path)
    assert os.listdir(path.parent) == []


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), r"cannot write .*some\.rom.*No space left"),
        (KeyboardInterrupt("stopped"), "stopped"),
    ],
)
@pytest.mark.parametrize("old", [True, False])
@pytest.mark.parametrize("stage", ["fsync", "replace"])
def test_a_failed_save_leaves_only_the_old_file(trained, saved, path, monkeypatch, stage, old, error, message):
    if old:
        path.write_bytes(saved.read_bytes())

    def fail(*_):
        assert [*path.parent.glob(".some.*.partial.rom")]  # it fails half way, not at once
        raise error

    monkeypatch.setattr(os, stage, fail)
    with pytest.raises(type(error), match=message):
        pt.save(ReducedModel(trained.data.with_scales(distance_scale=1.0)), path)
    monkeypatch.undo()
    assert os.listdir(path.parent) == (["some.rom"] if old else [])
    if old:
        assert pt.load(path).data.scales.distance_scale == trained.data.scales.distance_scale


def test_saving_again_replaces_the_file(trained, path):
    pt.save(ReducedModel(trained.data.with_scales(distance_scale=1.0)), path)
    pt.save(trained, path)
    assert pt.load(path).data.scales.distance_scale == trained.data.scales.distance_scale


def test_an_unwritable_place_is_named(trained, tmp_path):
    with pytest.raises(OSError, match=r"cannot write .*bar\.rom.*choose another folder"):
        pt.save(trained, tmp_path / "missing" / "bar.rom")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match=r"cannot write .*folder"):
        pt.save(trained, tmp_path / "folder")
    assert os.listdir(tmp_path) == ["folder"]


def test_a_surface_with_single_node_patches_is_drawn(altered):
    model = pt.load(altered(put("compliance/patches", np.zeros_like)))
    surface = Surface(model)
    assert np.isfinite(
        surface.displacements(np.ones(model.count), np.array([0]), np.ones((1, 3)), np.zeros(1, bool), np.zeros(1, int))
    ).all()
