"""Label maps against nibabel, SimpleITK and highdicom, which must agree on values and positions of all voxels.

    python validation/label_maps.py [FOLDER] [--surfaces]

FOLDER is ../shared/data/labels by default. Needs nibabel, SimpleITK, pydicom and highdicom. A NIfTI file is compared
with nibabel, others with SimpleITK, DICOM SEG with highdicom. Known differences are named in `DIFFERENT`. With
``--surfaces`` every label of at least 200 voxels becomes a surface: closed, and with the volume of its voxels.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import palpate as pt
from palpate.surface.labels.label_map import LabelMap, mask_of
from palpate.surface.labels.reading import is_label_map, read_label_map

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data" / "labels"
RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
MIN_VOXELS = 200
DIFFERENT = {
    "liver_metres.nii.gz": "nibabel does not use the unit of length",
    "liver_no_codes.nii.gz": "without codes every library has its own frame",
    "bladder_old_slicer.seg.nrrd": "of four axes, with the origin of the image before it was cropped",
}


def of_nibabel(path: Path) -> tuple[list[np.ndarray], np.ndarray]:
    """Return values and affine [mm, LPS] by nibabel."""
    import nibabel

    image: Any = nibabel.load(path)
    values = np.asarray(image.dataobj)
    return [np.rint(values.reshape(values.shape[:3]))], RAS_TO_LPS @ image.affine


def of_simpleitk(path: Path) -> tuple[list[np.ndarray], np.ndarray]:
    """Return values and affine [mm, LPS] by SimpleITK."""
    import SimpleITK

    image = SimpleITK.ReadImage(str(path))
    affine = np.eye(4)
    affine[:3, :3] = np.reshape(image.GetDirection(), (3, 3)) * image.GetSpacing()
    affine[:3, 3] = image.GetOrigin()
    values = SimpleITK.GetArrayFromImage(image)
    layers = [values] if values.ndim == 3 else [values[..., k] for k in range(values.shape[-1])]
    return [each.transpose(2, 1, 0) for each in layers], affine


def of_highdicom(path: Path) -> tuple[list[np.ndarray], np.ndarray]:
    """Return a mask by segment, and affine [mm, LPS] by highdicom."""
    import highdicom

    file: Any = highdicom.seg.segread(path)
    volume = file.get_volume(combine_segments=False, rescale_fractional=True)
    masks = [volume.array[..., k] >= 0.5 for k in range(volume.array.shape[-1])]
    return masks, volume.affine


def segment_mask(labels: LabelMap, k: int) -> np.ndarray:
    """Return the voxels of the k-th segment in the whole image."""
    segment = labels.segments[k]
    return labels.layers[segment.layer] == segment.value


def difference(path: Path) -> str:
    """Return in what a file differs from its oracle; empty if in nothing."""
    labels = read_label_map(path)
    if path.suffix == ".dcm":
        masks, affine = of_highdicom(path)
        masks = [each for each in masks if each.any()]
        ours = [np.argwhere(segment_mask(labels, k)) for k in range(len(labels.segments))]
        for mine, theirs in zip(ours, masks, strict=True):
            places = mine @ labels.affine[:3, :3].T * 1e3 + labels.affine[:3, 3] * 1e3
            oracle = np.argwhere(theirs) @ affine[:3, :3].T + affine[:3, 3]
            if len(places) != len(oracle):
                return f"{len(places)} voxels, oracle {len(oracle)}"
            distance = cKDTree(oracle).query(places)[0].max()
            if distance > 2e-3:
                return f"positions of voxels by {distance:.3g} mm"
        return ""
    layers, affine = of_nibabel(path) if ".nii" in path.name else of_simpleitk(path)
    scaled = labels.affine.copy()
    scaled[:3] *= 1e3
    if not np.allclose(scaled, affine, atol=1e-4):
        return f"affine by {np.abs(scaled - affine).max():.3g}"
    same = all(np.array_equal(mine, theirs) for mine, theirs in zip(labels.layers, layers, strict=True))
    return "" if same else "values"


def surface_faults(path: Path) -> list[str]:
    """Return the faults of the surfaces of all labels of a file, by the label's name."""
    from palpate.surface.labels.mask_surface import largest_piece, mask_surface

    labels, faults = read_label_map(path), []
    for segment in labels.segments:
        if segment.count < MIN_VOXELS:
            continue
        mask = largest_piece(mask_of(labels, str(segment.number)), 1)
        if np.count_nonzero(mask.voxels) < MIN_VOXELS:
            continue
        begin = perf_counter()
        surface = mask_surface(mask)
        seconds = perf_counter() - begin
        report = pt.io.check_surface(surface)
        error = surface.volume / mask.volume - 1
        if report.errors or abs(error) > 5e-3 or not surface.closed:
            faults.append(f"{segment.name}: volume {error:+.2%}, {[each.name for each in report.errors]}")
        print(f"    {segment.name}: {len(surface.triangles)} triangles, volume {error:+.3%}, {seconds:.2f} s")
    return faults


def main() -> int:
    """Compare all files of a folder; return 1 if one differs where none is known to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=DATA)
    parser.add_argument("--surfaces", action="store_true")
    options, failed = parser.parse_args(), 0
    for path in sorted(each for each in options.folder.iterdir() if is_label_map(each)):
        try:
            read_label_map(path)
        except pt.InputError as error:
            print(f"{path.name}: refused, {error}")
            continue
        found = surface_faults(path) if options.surfaces else [each for each in [_difference(path)] if each]
        known = DIFFERENT.get(path.name, "") if not options.surfaces else ""
        print(f"{path.name}: {'; '.join(found) or 'equal'}{f' ({known})' if known else ''}", flush=True)
        failed += bool(found) and not known
    return int(failed > 0)


def _difference(path: Path) -> str:
    try:
        return difference(path)
    except Exception as error:  # of the oracle
        return f"{type(error).__name__}: {error}"


if __name__ == "__main__":
    sys.exit(main())
