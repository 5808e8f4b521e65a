"""Trajectories come back from files as they went in, or not at all."""

from __future__ import annotations

import os
from dataclasses import fields, replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import palpate as pt


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


def test_what_is_saved_is_loaded(run, path):
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
    with pytest.raises(pt.FileFormatError, match=r"run\.h5 is not a palpate trajectory"):
        pt.Trajectory.load(path)


@pytest.mark.parametrize("name", ["displacements", "velocities", "times", "kinetic", "points", "reactions"])
def test_a_file_without_one_of_its_parts_is_refused(run, path, name):
    run.save(path)
    with h5py.File(path, "a") as file:
        del file[name]
    with pytest.raises(pt.FileFormatError, match=r"run\.h5"):
        pt.Trajectory.load(path)


@pytest.mark.parametrize("name", ["displacements", "velocities", "times", "strain"])
def test_a_file_with_values_that_are_not_finite_is_refused(run, path, name):
    run.save(path)
    with h5py.File(path, "a") as file:
        file[name][3] = np.nan
    with pytest.raises(pt.FileFormatError, match=f"{name} is not finite"):
        pt.Trajectory.load(path)


@pytest.mark.parametrize("name", ["reactions/x-", "points"])
def test_a_file_with_forces_or_points_that_are_not_finite_is_refused(run, path, name):
    run.save(path)
    with h5py.File(path, "a") as file:
        file[name][3] = np.nan
    with pytest.raises(pt.FileFormatError, match="not finite"):
        pt.Trajectory.load(path)


def test_an_unwritable_place_is_named(run, held, tmp_path):
    path = tmp_path / "missing" / "run.h5"
    with pytest.raises(OSError, match=r"cannot write .*run\.h5.*choose another folder"):
        run.save(path)
    with pytest.raises(OSError, match=r"cannot write .*run\.h5.*choose another folder"):
        pt.rollout(held, duration=1e-3, every=1e-3, file=path)


def test_a_folder_is_not_a_file(run, tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        run.save(tmp_path / "folder")
    assert os.listdir(tmp_path) == ["folder"]


def test_a_full_disk_leaves_the_old_file_and_nothing_else(run, path, disk):
    replace(run, model="old").save(path)
    disk(1)
    with pytest.raises(OSError, match=f"cannot write {path}.*the disk is full"):
        run.save(path)
    assert os.listdir(path.parent) == ["run.h5"]
    assert pt.Trajectory.load(path).model == "old"


def test_a_disk_that_fills_up_during_a_run_is_named_and_keeps_frames(held, path, disk):
    disk(3)
    with pytest.raises(OSError, match=f"cannot write {path}.*the disk is full"):
        pt.rollout(held, [pt.Gravity()], duration=2e-3, every=2e-4, file=path)
    kept = pt.Trajectory.load(path)
    assert len(kept.times) == 3
    assert not kept.complete


def test_the_balance_is_kinetic_and_strain_and_dissipated_less_external(run):
    energies = run.kinetic + run.strain + run.dissipated - run.external
    np.testing.assert_allclose(run.balance, energies - energies[0], rtol=1e-12)
