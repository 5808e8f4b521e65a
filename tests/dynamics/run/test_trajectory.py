"""Trajectories come back from files as they went in, or not at all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import fields, replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.run.model import Outputs
from palpate.dynamics.run.recorder import Recorder
from palpate.dynamics.run.trajectory import FORMAT, VERSION, StoredTrajectory


@pytest.fixture
def disk(monkeypatch):
    """A disk that is full after some looks at what is left of it."""

    def fills_up_after(looks):
        left = iter([10**12] * looks)
        monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=next(left, 0)))

    return fills_up_after


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.h5"


def test_a_loaded_trajectory_equals_the_saved_one(run, path):
    run.save(path)
    again = pt.Trajectory.load(path)
    for field in fields(pt.Trajectory):
        if field.name == "reactions":
            assert again.reactions.keys() == run.reactions.keys()
            np.testing.assert_array_equal(again.reactions["x-"], run.reactions["x-"])
        else:
            np.testing.assert_array_equal(getattr(again, field.name), getattr(run, field.name))
    assert os.listdir(path.parent) == ["run.h5"]


def test_a_free_body_has_no_reactions_to_save(free, path):
    run = pt.rollout(free, [pt.Gravity()], duration=1e-3, every=1e-3)
    run.save(path)
    assert pt.Trajectory.load(path).reactions == {}


def test_an_incomplete_run_stays_incomplete(run, path):
    replace(run, complete=False).save(path)
    assert not pt.Trajectory.load(path).complete


def test_saving_again_replaces_the_file(run, path):
    run.save(path)
    replace(run, model="other").save(path)
    assert pt.Trajectory.load(path).model == "other"


def test_a_missing_file_is_named(path):
    with pytest.raises(FileNotFoundError, match=r"run\.h5"):
        pt.Trajectory.load(path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_file_is_refused(run, path, share):
    run.save(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(pt.FileFormatError, match=r"run\.h5"):
        pt.Trajectory.load(path)


def test_a_file_of_another_kind_is_refused(path):
    path.write_text("times, displacements\n0, 0\n")
    with pytest.raises(pt.FileFormatError, match=r"run\.h5"):
        pt.Trajectory.load(path)


def test_an_hdf5_file_of_another_kind_is_refused(path):
    with h5py.File(path, "w") as file:
        file["times"] = np.zeros(3)
    with pytest.raises(pt.FileFormatError, match=r"run\.h5: this is not a palpate trajectory"):
        pt.Trajectory.load(path)


def test_other_programs_read_the_arrays(run, path):
    run.save(path)
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["displacements"], run.displacements)
        np.testing.assert_array_equal(file["reactions/x-"], run.reactions["x-"])
        assert (file.attrs["format"], file.attrs["model"]) == ("palpate trajectory", run.model)


@pytest.mark.parametrize("load", [pt.Trajectory.load, StoredTrajectory])
@pytest.mark.parametrize("name", ["displacements", "times", "steps", "points", "contact_forces", "bonded"])
def test_a_file_without_one_of_its_parts_is_refused(run, path, forge, name, load):
    run.save(path)
    forge(path, lambda header, arrays: arrays.pop(name), FORMAT, VERSION)
    with pytest.raises(pt.FileFormatError, match=r"run\.h5"):
        load(path)


@pytest.mark.parametrize("name", ["displacements", "velocities", "times", "strain", "reactions/x-", "points"])
def test_a_file_with_values_that_are_not_finite_is_refused(run, path, forge, name):
    run.save(path)
    forge(path, lambda header, arrays: arrays[name].__setitem__(3, np.nan), FORMAT, VERSION)
    with pytest.raises(pt.FileFormatError, match=f"{name} must be finite"):
        pt.Trajectory.load(path)


def test_a_frame_that_is_not_finite_is_refused_when_it_is_read(run, path, forge):
    run.save(path)
    forge(path, lambda header, arrays: arrays["displacements"].__setitem__(3, np.inf), FORMAT, VERSION)
    stored = StoredTrajectory(path)
    np.testing.assert_array_equal(stored.displacements[:3], run.displacements[:3])
    with pytest.raises(pt.FileFormatError, match=r"run\.h5: frame 3"):
        stored.displacements[2:5]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("model", 5, "model must be text"),
        ("complete", "yes", "complete must be true or false"),
        ("wall_seconds", "5", "wall_seconds"),
        ("stiffness_damping", -1.0, "stiffness_damping must be .*, got -1.0"),
        ("stiffness_damping", None, "stiffness_damping must be a number"),
        ("reactions", "x-", "reactions must be a list of names"),
        ("reactions", ["x-", "x-"], "reactions must be a list of names"),
        ("reactions", [["x-"]], "reactions must be a list of names"),
        ("reactions", ["y-"], "array reactions/x- is not one of"),
        ("another", 1, "header must have"),
    ],
)
def test_forged_headers_are_refused(run, path, forge, name, value, message):
    run.save(path)
    forge(path, lambda header, arrays: header.update({name: value}), FORMAT, VERSION)
    with pytest.raises(pt.FileFormatError, match=rf"run\.h5.*{message}"):
        pt.Trajectory.load(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("contact_forces", np.array([[0.0, -1.0, 0, 0, 0]])),
        ("contact_forces", np.array([[0.5, 1.0, 0, 0, 0]])),
        ("contact_forces", np.array([[10**6, 1.0, 0, 0, 0]])),
        ("contact_forces", np.array([[0.0, 10**6, 0, 0, 0]])),
        ("times", np.array([0.0, -1.0, 1.0])),
        ("points", np.zeros((0, 3))),
        ("points", np.zeros(3)),
        ("kinetic", np.zeros((2, 2))),
        ("kinetic", np.zeros(2, dtype="<f4")),
    ],
)
def test_forged_arrays_are_refused(run, path, forge, name, value):
    run.save(path)

    def change(header, arrays):
        arrays[name] = value
        if name == "contact_forces":
            arrays["bonded"] = np.zeros(len(value), dtype=bool)

    forge(path, change, FORMAT, VERSION)
    with pytest.raises(pt.FileFormatError, match=r"run\.h5"):
        pt.Trajectory.load(path)


@pytest.mark.parametrize("load", [pt.Trajectory.load, lambda path: StoredTrajectory(path).displacements[:]])
def test_a_flipped_bit_is_refused_wherever_it_is(run, path, load):
    run.save(path)
    data, generator = path.read_bytes(), np.random.default_rng(5)
    own, refused = load(path), 0
    for place in [0, 20, 100, 511, 512, 600, *generator.integers(len(data), size=100)]:
        changed = bytearray(data)
        changed[place] ^= 1 << int(generator.integers(8))
        path.write_bytes(changed)
        try:
            again = load(path)
        except pt.FileFormatError:
            refused += 1
        else:  # a part that is not read
            assert load is not pt.Trajectory.load
            np.testing.assert_array_equal(own, again)
    assert refused > 30


# journals


def cut(path, run, label="", blade=()):
    """Leave the journal of a run that was stopped at once; return where its records end."""
    recorder, ends = Recorder(path, run.model, run, run.stiffness_damping, label), [0]
    for k in range(len(run.times)):
        own = run.contact_forces[:, 0] == k
        energies = {name: float(getattr(run, name)[k]) for name in ("kinetic", "strain", "external", "dissipated")}
        forces = {name: force[k] for name, force in run.reactions.items()}
        frame = Outputs(run.displacements[k], run.velocities[k], forces, **energies, moments={},
                        contact_forces=run.contact_forces[own, 1:], bonded=run.bonded[own],
                        blade=np.array(blade if k else ()))  # fmt: skip
        recorder.add(float(run.times[k]), int(run.steps[k]), frame)
        ends.append(path.stat().st_size)
    recorder._journal.close()
    return ends


def test_a_truncated_run_keeps_its_frames(run, path):
    ends = cut(path, run, "mine")
    loaded, stored = pt.Trajectory.load(path), StoredTrajectory(path)
    assert (loaded.complete, loaded.label, stored.label) == (False, "mine", "mine")
    for field in ("times", "displacements", "velocities", "steps", "kinetic", "contact_forces", "points"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(run, field))
    np.testing.assert_array_equal(loaded.reactions["x-"], run.reactions["x-"])
    np.testing.assert_array_equal(stored.displacements[::7], run.displacements[::7])
    for place in (ends[5], ends[5] + 3, ends[6] - 1):  # in the middle of the record of the sixth frame
        path.write_bytes(path.read_bytes()[:place])
        np.testing.assert_array_equal(pt.Trajectory.load(path).times, run.times[:5])
        assert len(StoredTrajectory(path).displacements) == 5
        cut(path, run, "mine")


def test_a_journal_of_an_earlier_version_lacks_the_release_rate_of_a_blade(run, path):
    cut(path, run, blade=[1.0, 2.0, 3.0, 4.0])
    loaded = pt.Trajectory.load(path)
    np.testing.assert_array_equal(loaded.friction_work, [0.0] + [4.0] * (len(run.times) - 1))
    assert len(loaded.release_rate) == 0
    cut(path, run, blade=[1.0, 2.0, 3.0, 4.0, 5.0])
    assert pt.Trajectory.load(path).release_rate[-1] == 5.0


def test_a_damaged_journal_is_refused_and_not_truncated(run, path):
    ends = cut(path, run)
    data, generator = path.read_bytes(), np.random.default_rng(6)
    for place in [*range(0, 30, 5), ends[4], ends[4] + 9, *generator.integers(len(data), size=60)]:
        changed = bytearray(data)
        changed[place] ^= 1 << int(generator.integers(8))
        path.write_bytes(changed)
        with pytest.raises(pt.FileFormatError, match=r"run\.h5"):
            pt.Trajectory.load(path)
        with pytest.raises(pt.FileFormatError, match=r"run\.h5"):
            StoredTrajectory(path)


def test_a_run_that_diverges_at_once_leaves_a_file_that_is_loaded(held, path):
    recorder = Recorder(path, held.name, held.cloud, held.stiffness_damping)
    recorder.close(0.1, complete=False)
    loaded = pt.Trajectory.load(path)
    assert (len(loaded.times), loaded.complete) == (0, False)
    assert loaded.displacements.shape == (0, len(held.cloud), 3)


@pytest.mark.slow
def test_a_killed_run_keeps_its_frames(tmp_path):
    """The process is killed in the middle of its run, as by the system."""
    path = tmp_path / "run.h5"
    program = f"""
import os, signal
import palpate as pt
model = pt.Solid(pt.box((0.015, 0.015, 0.015), spacing=0.005),
    pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000.0, poisson=0.45), fixed="x-", stiffness_damping=6e-5)
def stop(time, wall):
    if time > 2.5e-3:
        os.kill(os.getpid(), signal.SIGKILL)
pt.rollout(model, [pt.Gravity()], duration=0.01, every=1e-3, file={str(path)!r}, progress=stop)
"""
    done = subprocess.run([sys.executable, "-c", program], check=False)
    assert done.returncode == -signal.SIGKILL
    loaded = pt.Trajectory.load(path)
    np.testing.assert_allclose(loaded.times, [0.0, 1e-3, 2e-3, 3e-3], atol=1e-12)
    assert not loaded.complete
    assert os.listdir(tmp_path) == ["run.h5"]


def test_an_unwritable_place_is_named(run, held, tmp_path):
    path = tmp_path / "missing" / "run.h5"
    with pytest.raises(OSError, match=r"cannot write .*run\.h5.*choose another folder"):
        run.save(path)
    with pytest.raises(OSError, match=r"cannot write .*run\.h5.*choose another folder"):
        pt.rollout(held, duration=1e-3, every=1e-3, file=path)


@pytest.mark.parametrize("name", ["run.vtk", "run.vtkhdf", "run.xyz", "run.rom"])
def test_another_ending_is_refused_before_a_run(run, held, tmp_path, name):
    with pytest.raises(pt.InputError, match=r"file must end in \.h5 \(the trajectory\), got 'run\."):
        pt.rollout(held, duration=1.0, every=1e-3, file=tmp_path / name)
    if name != "run.vtkhdf":
        with pytest.raises(pt.InputError, match=r"must end in \.h5 \(.*\) or \.vtkhdf \(.* for ParaView\), got 'run\."):
            run.save(tmp_path / name)
    assert not os.listdir(tmp_path)


def test_a_trajectory_keeps_its_surface(run, bar, path):
    run.save(path)
    np.testing.assert_array_equal(run.triangles, bar.triangles)
    np.testing.assert_array_equal(pt.Trajectory.load(path).triangles, bar.triangles)


def test_a_file_without_a_surface_is_one_of_an_earlier_version(run, path, forge):
    run.save(path)
    forge(path, lambda header, arrays: arrays.pop("triangles"), FORMAT, VERSION)
    assert pt.Trajectory.load(path).triangles.shape == (0, 3)


def test_paraview_and_pyvista_take_the_frames(run, tmp_path):
    import pyvista
    from vtkmodules.vtkIOHDF import vtkHDFReader

    run.save(tmp_path / "run.vtkhdf")
    reader = vtkHDFReader()
    reader.SetFileName(str(tmp_path / "run.vtkhdf"))
    reader.UpdateInformation()
    reader.UpdateTimeStep(run.times[7])
    for mesh in (pyvista.wrap(reader.GetOutputDataObject(0)), run.to_pyvista(run.times[7] + 1e-5)):
        np.testing.assert_array_equal(mesh["displacement"], run.displacements[7])
        np.testing.assert_array_equal(mesh["velocity"], run.velocities[7])
    np.testing.assert_array_equal(run.to_pyvista()["displacement"], run.displacements[-1])


def test_a_folder_in_place_of_a_file_is_refused(run, tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        run.save(tmp_path / "folder")
    assert os.listdir(tmp_path) == ["folder"]


def test_a_full_disk_leaves_only_the_old_file(run, path, disk):
    replace(run, model="old").save(path)
    disk(0)
    with pytest.raises(OSError, match=f"cannot write {path}.*the disk is full"):
        run.save(path)
    assert os.listdir(path.parent) == ["run.h5"]
    assert pt.Trajectory.load(path).model == "old"


@pytest.mark.slow
def test_a_disk_that_fills_up_during_a_run_is_named_and_keeps_frames(tmp_path):
    """Files of this process cannot grow beyond a limit, as on a full disk."""
    path = tmp_path / "run.h5"
    program = f"""
import resource
import palpate as pt
model = pt.Solid(pt.box((0.015, 0.015, 0.015), spacing=0.005),
    pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000.0, poisson=0.45), fixed="x-", stiffness_damping=6e-5)
pt.rollout(model, [pt.Gravity()], duration=1e-3, every=1e-3)  # compiles
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    pt.rollout(model, [pt.Gravity()], duration=0.02, every=1e-3, file={str(path)!r})
except OSError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert f"cannot write {path}" in done.stdout
    loaded = pt.Trajectory.load(path)
    assert 2 <= len(loaded.times) < 10
    assert not loaded.complete


def test_the_balance_is_kinetic_and_strain_and_dissipated_less_external(run):
    energies = run.kinetic + run.strain + run.dissipated - run.external
    np.testing.assert_allclose(run.balance, energies - energies[0], rtol=1e-12)


@pytest.mark.parametrize(
    "names",
    [["a", "a/b"], ["a/b", "a"], ["."], [".."], ["", "%"], ["a//b", "a/b"], ["a", "./a", "/a", "a/"], ["a\0b", "a"],
     ["a%2Fb", "a/b"], ["Leber \u4e2d"], ["x" * 70_000]],
)  # fmt: skip
def test_forces_of_groups_of_any_name_are_stored(run, path, names):
    forces = {name: np.full((len(run.times), 3), float(k)) for k, name in enumerate(names)}
    replace(run, reactions=forces, moments=forces, label="\0").save(path)
    loaded = pt.Trajectory.load(path)
    assert list(loaded.reactions) == list(loaded.moments) == names
    for name, force in forces.items():
        np.testing.assert_array_equal(loaded.reactions[name], force)
        np.testing.assert_array_equal(loaded.moments[name], force)


def test_a_label_that_cannot_be_stored_is_refused_before_the_run(run, held, path):
    with pytest.raises(pt.InputError, match="surrogate"):
        replace(run, label="\ud800").save(path)
    with pytest.raises(pt.InputError, match="surrogate"):
        pt.rollout(held, duration=1e-3, every=1e-3, file=path, label="\ud800")
    assert not list(path.parent.iterdir())


def test_a_signal_during_a_frame_loses_no_other_frame(held, path, monkeypatch):
    class Interrupted(list):
        def append(self, frame):
            if len(self) == 2:
                raise KeyboardInterrupt
            super().append(frame)

    real = Recorder.__init__

    def begin(self, *arguments, **options):
        real(self, *arguments, **options)
        self.frames = Interrupted()

    monkeypatch.setattr(Recorder, "__init__", begin)
    with pytest.raises(KeyboardInterrupt):
        pt.rollout(held, duration=4e-3, every=1e-3, file=path)
    loaded = pt.Trajectory.load(path)
    assert len(loaded.times) == len(loaded.displacements) == 2
    assert not loaded.complete


@pytest.mark.parametrize("name", ["", ".", "a\0b.h5"])
def test_names_that_are_not_file_names_are_refused(run, name):
    with pytest.raises(OSError, match="not a file name"):
        run.save(name)


def test_forged_displacements_are_refused(run, path, forge):
    run.save(path)
    forge(path, lambda header, arrays: arrays["displacements"].__setitem__(3, 1e160), FORMAT, VERSION)
    with pytest.raises(pt.FileFormatError, match="displacements must be finite, from"):
        pt.Trajectory.load(path)
    with pytest.raises(pt.FileFormatError, match="frame 3 of the displacements"):
        StoredTrajectory(path).displacements[3]
