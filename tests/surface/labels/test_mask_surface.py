"""Surface of a mask: closed, with the volume of the voxels, in the right place, whatever the grid."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from label_files import RAS_TO_LPS, ball, blocks, nifti, nrrd

import palpate as pt
from palpate.core.faults import InputError
from palpate.surface.labels.label_map import mask_of
from palpate.surface.labels.mask_surface import label_surface, largest_piece, mask_surface
from palpate.surface.labels.nifti import read_nifti
from palpate.surface.labels.nrrd import read_nrrd
from palpate.surface.labels.reading import is_label_map, read_label_map

DATA = Path(__file__).parents[4] / "shared" / "data" / "labels"
REFUSED = re.compile(r"x_|liver_cut_short" if find_spec("pydicom") else r"x_|liver_cut_short|.*\.dcm")
EXAMPLE = Path(__file__).parents[3] / "examples" / "trunk.nii.gz"
# none in a clone alone
READABLE = [each for each in sorted(DATA.glob("*")) if is_label_map(each) and not REFUSED.match(each.name)]
MILLIMETRES = np.diag([2.0, 2.0, 2.0, 1.0])


def surface_of(values, affine=MILLIMETRES, part=None):
    return label_surface(read_nifti(nifti(values, sform=affine)), part)


def assert_sound(surface, volume, tolerance=2e-3):
    assert pt.io.check_surface(surface).errors == ()
    assert surface.volume == pytest.approx(volume, rel=tolerance)


def test_a_ball_has_its_volume_its_middle_and_almost_its_area():
    surface = surface_of(ball(9.4))
    radius = 9.4 * 2e-3
    assert_sound(surface, np.count_nonzero(ball(9.4)) * 8e-9)
    middle = RAS_TO_LPS[:3, :3] @ np.full(3, 23.0) * 1e-3
    distance = np.linalg.norm(surface.vertices - middle, axis=1)
    assert np.abs(distance - radius).max() < 0.5 * 2e-3
    assert surface.area == pytest.approx(4 * np.pi * radius**2, rel=0.02)
    assert (surface.space, surface.unit, surface.warnings) == ("LPS", 1e-3, ())


@pytest.mark.parametrize(
    "axes",
    [
        [[-2, 0, 0], [0, 2, 0], [0, 0, 2]],  # a mirror
        [[0, 2, 0], [0, 0, 2], [2, 0, 0]],  # other order
        [[0.7, 0, 0], [0, 0.7, 0], [0, 0, 6]],  # thick slices
        [[2, 0.5, 0], [0, 2, 0.7], [0, 0, 2]],  # sheared
        [[0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3]],  # fine
    ],
)
def test_any_axes_give_a_surface_that_is_closed_and_outwards(axes):
    affine = np.eye(4)
    affine[:3, :3] = axes
    surface = surface_of(ball(), affine)
    assert_sound(surface, np.count_nonzero(ball()) * abs(np.linalg.det(affine)) * 1e-9)
    assert surface.volume > 0


def test_voxels_that_touch_along_an_edge_or_in_a_corner_give_no_branching_edges():
    rng = np.random.default_rng(2)
    values = ((rng.random((12, 12, 12)) < 0.7) * np.pad(np.ones((10, 10, 10)), 1)).astype("u1")
    assert pt.io.check_surface(surface_of(values, part="1#1")).errors == ()


def test_a_label_that_fills_the_image_is_closed_and_says_that_it_is_cut():
    surface = surface_of(np.ones((15, 15, 15), dtype="u1"))
    assert_sound(surface, 15**3 * 8e-9)
    assert any("touches the edge of the image" in each for each in surface.warnings)


def test_specks_are_left_out_with_their_share_and_pores_are_filled():
    values = ball()
    values[0, 0, :3] = 1
    values[12, 12, 12] = 0
    surface = surface_of(values)
    assert_sound(surface, np.count_nonzero(ball()) * 8e-9)
    assert any("has 2 pieces" in each for each in surface.warnings)
    assert any("small cavities of 1 voxel in all filled" in each for each in surface.warnings)


def test_cavities_of_another_organ_stay():
    values = ball()
    values[ball(4.0) > 0] = 3
    surface = surface_of(values, part="1")
    assert surface.volume == pytest.approx(np.count_nonzero(values == 1) * 8e-9, rel=2e-3)
    assert any(each.name == "cavities" for each in pt.io.check_surface(surface).problems)
    assert_sound(surface_of(values, part=["1", "3"]), np.count_nonzero(ball()) * 8e-9)


def test_a_label_of_several_pieces_asks_for_one_of_them():
    values = np.concatenate([ball(8.0), ball(7.0)])
    with pytest.raises(InputError, match=r"part must be one piece, got .* of 2 pieces, the largest with 60% .*'1#1'"):
        surface_of(values)
    for piece, radius in ((1, 8.0), (2, 7.0)):
        assert_sound(surface_of(values, part=f"1#{piece}"), np.count_nonzero(ball(radius)) * 8e-9)
    with pytest.raises(InputError, match="one of 2 pieces"):
        surface_of(values, part="1#3")
    with pytest.raises(InputError, match="one label where a piece is chosen"):
        surface_of(values, part=["1#1", "1"])


def test_the_largest_of_hundreds_of_pieces_is_the_organ_unless_it_is_a_texture():
    values = np.zeros((60, 60, 60), dtype="u1")
    values[4:56, 4:56, 4:30] = 1
    values[::4, ::4, 40::8] = 1
    surface = surface_of(values)
    assert_sound(surface, 52 * 52 * 26 * 8e-9)
    assert any("has 676 pieces: the largest chosen, 0.95 % of its volume left out" in each for each in surface.warnings)
    noise = (np.random.default_rng(0).random((40, 40, 40)) < 0.5).astype("u1")
    with pytest.raises(InputError, match="of 613 pieces, the largest with 97% of the voxels"):
        surface_of(noise)


def test_too_few_voxels_and_units_that_cannot_be_are_refused():
    values = np.zeros((9, 9, 9), dtype="u1")
    values[4, 4, 3:6] = 1
    with pytest.raises(InputError, match="at least 30 voxels in one piece, got 3"):
        surface_of(values)
    with pytest.raises(InputError, match=r"edges of 0.001 to 100 mm, got 2e\+03 x .*scale=0.001"):
        label_surface(read_nifti(nifti(ball(), sform=MILLIMETRES, units=1)))
    with pytest.raises(InputError, match="scale=1000"):
        label_surface(read_nifti(nifti(ball(), sform=np.diag([1e-4, 1e-4, 1e-4, 1.0]))))
    few = surface_of(blocks("u1"), part="1")
    assert any("80 voxels only" in each for each in few.warnings)


def test_layers_that_overlap_have_surfaces_of_their_own():
    layers = np.stack([ball(9.0), 2 * ball(6.0)])
    lines = [f"Segment{k}_{key}:={value}" for k in (0, 1) for key, value in (("Layer", k), ("LabelValue", k + 1))]
    labels = read_nrrd(nrrd(layers, kinds="list domain domain domain", lines=lines, affine=MILLIMETRES))
    for part, radius in (("1", 9.0), ("2", 6.0), (["1", "2"], 9.0)):
        assert_sound(label_surface(labels, part), np.count_nonzero(ball(radius)) * 8e-9)


@pytest.mark.slow
@pytest.mark.parametrize("path", [EXAMPLE, *READABLE], ids=lambda path: path.name)
def test_every_label_of_200_voxels_has_a_closed_surface_of_its_volume(path):
    labels = read_label_map(path)
    for segment in labels.segments:
        mask = mask_of(labels, str(segment.number))
        if segment.count < 200:
            continue
        piece = largest_piece(mask, 1)
        if np.count_nonzero(piece.voxels) >= 200:
            assert_sound(mask_surface(piece), piece.volume)
