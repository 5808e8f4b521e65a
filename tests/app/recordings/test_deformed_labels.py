"""Deformed label maps of recordings: of a stretched full body, and of a reduced one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import palpate as pt
from palpate.app.recordings.deformed_labels import nodal_displacements, write_deformed_labels
from palpate.app.recordings.recording import Cut, Recording
from palpate.app.recordings.snapshot import Snapshot, ToolSnapshot
from palpate.core.faults import InputError
from palpate.surface.labels.label_map import Segment
from palpate.surface.labels.reading import read_label_map
from palpate.surface.labels.writers import write_labels, write_layers

EDGE = 0.002  # [m] of the voxels
SPACING = 0.006
GRADIENT = np.array([[1.12, 0.2, 0.1], [0.05, 0.93, 0.15], [-0.1, 0.08, 0.97]])  # no face stays along voxels


def snapshot(coordinates: np.ndarray, force: float) -> Snapshot:
    tool = ToolSnapshot(
        force=np.array([0, 0, force]), moment=np.zeros(3), stiffness=np.eye(3), position=np.zeros(3),
        quaternion=np.array([1.0, 0.0, 0.0, 0.0]), sequence=0, device_force=np.zeros(3), kind="none",
    )  # fmt: skip
    return Snapshot(
        time=0.0, steps=0, trust=1.0, kinetic=0.0, strain=0.0, computing=0.0, lateness=0.0, coordinates=coordinates,
        state="running", contact_nodes=np.zeros(0, dtype=int), contact_forces=np.zeros((0, 3)), modulus_ratio=1.0,
        contact_tools=np.zeros(0, dtype=int), tools=(tool,),
    )  # fmt: skip


@pytest.fixture(scope="module")
def body():
    """Return a body that fills voxels 10 to 29 of each axis."""
    cloud = pt.box((0.04, 0.04, 0.04), spacing=SPACING)
    cloud = replace(cloud, points=cloud.points + 9.5 * EDGE)
    return pt.Solid(cloud, pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000.0, poisson=0.45), "x-")


@pytest.fixture
def recording(body):
    """Return a recording of rest, then of a stretch under the largest force, then of rest."""
    points = body.cloud.points
    stretch = (points - points.mean(axis=0)) @ (GRADIENT - np.eye(3))
    shown = [snapshot(np.float32(share * stretch).ravel(), force) for share, force in ((0, 0.0), (1, 2.0), (0, 1.0))]
    return Recording("Block", body, 0.1 * np.arange(3), shown, [], {})


@pytest.fixture
def labels_file(tmp_path):
    numbers = np.zeros((40, 40, 40), dtype=int)
    numbers[10:30, 10:30, 10:30], numbers[15:20, 15:20, 15:20], numbers[32:38, 5:20, 5:20] = 1, 2, 3
    path = tmp_path / "rest.nii.gz"
    write_labels(path, numbers, np.diag([EDGE, EDGE, EDGE, 1.0]), {1: "block", 2: "nodule", 3: "neighbour"})
    return path


def test_the_map_of_the_largest_force_has_the_volume_of_the_stretched_body(recording, labels_file, tmp_path):
    out, field = tmp_path / "deformed.nii.gz", tmp_path / "field.nrrd"
    lines = write_deformed_labels(recording, labels_file, out=out, field_out=field)
    assert lines[0] == "at 0.1 s, of block, nodule:"
    before, after = ({each.name: each for each in read_label_map(path).segments} for path in (labels_file, out))
    assert after.keys() == {"block", "nodule", "neighbour"}
    assert after["neighbour"].count == before["neighbour"].count
    ratio = (after["block"].count + after["nodule"].count) / (before["block"].count + before["nodule"].count)
    assert ratio == pytest.approx(np.linalg.det(GRADIENT), rel=0.01)
    assert f"have {ratio:.2%} of their volume at rest" in lines[1]
    assert field.stat().st_size > 1000


def test_a_frame_at_rest_has_the_map_of_rest(recording, labels_file, tmp_path):
    out = tmp_path / "rest.nrrd"
    write_deformed_labels(recording, labels_file, out=out, field_out=None, time=0.05)
    before, after = read_label_map(labels_file), read_label_map(out)
    assert np.array_equal(before.layers[0], after.layers[0])


def test_overlapping_labels_stay_in_layers_and_what_nifti_loses_is_said(recording, tmp_path):
    block, vessel = np.zeros((2, 40, 40, 40), dtype=int)
    block[10:30, 10:30, 10:30], vessel[15:20, 10:30, 15:20] = 1, 2
    segments = [Segment(1, "block", 0, 1, 8000), Segment(2, "vessel", 1, 2, 500)]
    affine = np.diag([EDGE, EDGE, EDGE, 1.0])
    affine[0, 2] = 2e-4 * EDGE  # sheared, as of a tilted gantry
    write_layers(tmp_path / "rest.seg.nrrd", [block, vessel], affine, segments)
    counts = {}
    for name in ("a.seg.nrrd", "a.nii"):
        lines = write_deformed_labels(
            recording, tmp_path / "rest.seg.nrrd", out=tmp_path / name, field_out=None, time=0.0
        )
        counts[name] = {each.name: each.count for each in read_label_map(tmp_path / name).segments}
    assert counts["a.seg.nrrd"] == {"block": 8000, "vessel": 500}
    assert counts["a.nii"] == {"block": 7500, "vessel": 500}
    assert "block lost 500 of its 8000 voxels to labels that overlap it" in lines[2]
    assert "sheared, and so are those of a.nii: ITK refuses them in NIfTI" in lines[3]


def test_a_part_can_be_chosen(recording, labels_file, tmp_path):
    lines = write_deformed_labels(recording, labels_file, out=tmp_path / "a.nii", field_out=None, part=["nodule"])
    assert lines[0] == "at 0.1 s, of nodule:"


def test_wrong_frames_names_and_cuts_are_refused(recording, labels_file, tmp_path):
    out = tmp_path / "deformed.nii"
    with pytest.raises(InputError, match="frame must be"):
        write_deformed_labels(recording, labels_file, out=out, field_out=None, time=0.3)
    with pytest.raises(InputError, match="field must end in"):
        write_deformed_labels(recording, labels_file, out=None, field_out=tmp_path / "field.mha")
    cut = replace(recording, cuts=[Cut(1, 0, np.zeros((1, 3, 3)))])
    with pytest.raises(InputError, match="frame must be before the first cut"):
        write_deformed_labels(cut, labels_file, out=out, field_out=None)
    assert not out.exists()


def test_nodes_of_a_reduced_body_move_by_its_modes():
    vectors = np.random.default_rng(2).normal(size=(3, 4, 3))
    shown = SimpleNamespace(nodes=np.array([0, 2]))
    moved = SimpleNamespace(coordinates=np.array([1.0, -2.0]), displacements=lambda surface: np.ones((2, 3)))
    model = SimpleNamespace(count=2, body=SimpleNamespace(vectors=vectors))
    found = nodal_displacements(SimpleNamespace(snapshots=[moved], model=model), 0, shown)
    np.testing.assert_allclose(found[[1, 3]], (vectors[0] - 2 * vectors[1])[[1, 3]])
    np.testing.assert_allclose(found[[0, 2]], 1.0)
