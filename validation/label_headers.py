"""Label maps whose header states something twice, against nibabel, SimpleITK and highdicom.

    python validation/label_headers.py

Needs nibabel, SimpleITK, pydicom and highdicom. Each file is written from its specification, and read by palpate and by
the reader that palpate follows for it. Both must put voxels at the same places. Palpate must say a note where
statements differ, and none where they agree. Where another reader takes the other statement, its distance is printed.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from palpate.core.faults import InputError
from palpate.surface.labels.reading import read_label_map

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "surface" / "labels"))
from label_files import AFFINE, blocks, dicom, metaimage, nifti, nrrd  # noqa: E402

RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
UPRIGHT = np.array([[2.0, 0, 0, -39], [0, 2, 0, -39], [0, 0, 3, -39], [0, 0, 0, 1]])
EDGES, OFFSET = (2.0, 2.0, 3.0), (-39.0, -39.0, -39.0)
TURNED = "0 1 0 -1 0 0 0 0 1"
STRAIGHT = [(0, 0, 5 * k) for k in range(8)]
SLICES = blocks().transpose(2, 1, 0) == 1


class Case(NamedTuple):
    """A file, the reader that palpate follows, and whether statements differ."""

    name: str
    data: bytes
    follows: str
    differs: bool


def cases() -> list[Case]:
    """Return files in which statements agree and differ."""
    return [*nifti_cases(), *nrrd_cases(), *metaimage_cases(), *dicom_cases()]


def nifti_cases() -> list[Case]:
    """Return NIfTI files: of those with both forms nibabel takes the sform."""
    forms = {
        "agree": (EDGES, (0, 0, 0), OFFSET, 1), "turned": (EDGES, (0, 0, 1), OFFSET, 1),
        "moved": (EDGES, (0, 0, 0), (-29, -39, -39), 1), "size": ((2.2, 2, 3), (0, 0, 0), OFFSET, 1),
        "mirrored": (EDGES, (0, 0, 0), OFFSET, -1),
    }  # fmt: skip
    both = [Case(f"{key}.nii", nifti(blocks(), sform=UPRIGHT, qform=form), "nibabel", key != "agree")
            for key, form in forms.items()]  # fmt: skip
    return [
        *both,
        Case("sheared.nii", nifti(blocks(), sform=AFFINE), "nibabel", differs=False),
        Case("sizes.nii", nifti(blocks(), sform=UPRIGHT, pixdim=[1, 3, 2, 3, 1, 1, 1, 1]), "nibabel", differs=True),
        Case("negative.nii", nifti(blocks(), sform=None, qform=((-2, 2, 3), (0, 0, 0), OFFSET, 1)), "nibabel",
             differs=True),
        Case("qfac.nii", nifti(blocks(), sform=None, qform=(EDGES, (0, 0, 0), OFFSET, -0.5)), "ITK", differs=True),
        Case("long.nii", nifti(blocks(), sform=None, qform=(EDGES, (0, 0, 1.5), OFFSET, 1)), "ITK", differs=True),
        Case("oblique.nii", nifti(blocks(), sform=None, qform=(EDGES, (0.3, 0.2, 0.1), OFFSET, -1)), "nibabel",
             differs=False),
    ]  # fmt: skip


def nrrd_cases() -> list[Case]:
    """Return NRRD files; teem, and so ITK, refuses those that state directions and spacings."""
    lines = {"agree": [], "thicknesses": ["thicknesses: nan nan 5"]}
    return [Case(f"{key}.nrrd", nrrd(blocks(), lines=text), "ITK", bool(text)) for key, text in lines.items()]


def metaimage_cases() -> list[Case]:
    """Return MetaImage files, as ITK reads them."""
    lines = {
        "agree": ["ElementSize = 2 2 3", "Position = -39 -39 -39", "AnatomicalOrientation = RAI"],
        "size": ["ElementSize = 2 2 5"], "turned": [f"Rotation = {TURNED}"], "position": ["Position = 1 2 3"],
        "origin": ["Origin = 1 2 3"], "letters": ["AnatomicalOrientation = LPI"], "unit": ["DistanceUnits = cm"],
        "middle": ["CenterOfRotation = 5 5 5"],
    }  # fmt: skip
    instead = {
        "negative": ("ElementSpacing", "-2 2 3"), "scaled": ("TransformMatrix", "2 0 0 0 1 0 0 0 1"),
        "sheared": ("TransformMatrix", "1 0 0 0.3 0.954 0 0 0 1"),
    }  # fmt: skip
    return [
        *(Case(f"{key}.mha", metaimage(blocks(), affine=UPRIGHT, lines=text), "ITK", key != "agree")
          for key, text in lines.items()),
        *(Case(f"{key}.mha", metaimage(blocks(), affine=UPRIGHT, lines=[f"{word} = {text}"], without=[word]), "ITK",
               key != "sheared") for key, (word, text) in instead.items()),
    ]  # fmt: skip


def dicom_cases() -> list[Case]:
    """Return DICOM SEG files; highdicom takes a stated distance that fits, and refuses sheared images."""
    wide = [(0, 0, 10 * k) for k in range(8)]
    return [
        Case("straight.dcm", dicom(SLICES, STRAIGHT, thickness=5.0, between=5.0), "highdicom", differs=False),
        Case("sparse.dcm", dicom(SLICES, wide, thickness=5.0, between=5.0), "highdicom", differs=True),
        Case("between.dcm", dicom(SLICES, STRAIGHT, thickness=5.0, between=4.0), "places", differs=True),
        Case("overlapping.dcm", dicom(SLICES, STRAIGHT, thickness=9.0, between=5.0), "highdicom", differs=False),
        Case("tilted.dcm", dicom(SLICES, [(0, 2 * k, 5 * k) for k in range(8)], thickness=5.0), "places", differs=True),
    ]


def of_nibabel(path: Path) -> np.ndarray:
    """Return the affine map [mm, LPS] of nibabel."""
    import nibabel

    image = nibabel.load(path)
    return RAS_TO_LPS @ image.affine


def of_itk(path: Path) -> np.ndarray:
    """Return the affine map [mm, LPS] of SimpleITK."""
    import SimpleITK

    image, affine = SimpleITK.ReadImage(str(path)), np.eye(4)
    affine[:3, :3] = np.reshape(image.GetDirection(), (3, 3)) * image.GetSpacing()
    affine[:3, 3] = image.GetOrigin()
    return affine


def of_highdicom(path: Path) -> np.ndarray:
    """Return the map [mm, LPS] of frames, whose distance highdicom finds with the stated one as a hint."""
    import pydicom
    from highdicom.spatial import get_volume_positions

    groups = pydicom.dcmread(path).PerFrameFunctionalGroupsSequence
    places = [[float(x) for x in g.PlanePositionSequence[0].ImagePositionPatient] for g in groups]
    hint = groups[0].PixelMeasuresSequence[0].get("SpacingBetweenSlices")
    distance, _ = get_volume_positions(
        places, [1, 0, 0, 0, 1, 0], allow_missing_positions=True, spacing_hint=None if hint is None else float(hint)
    )
    if distance is None:
        raise ValueError("no regular distance of slices")
    affine = np.eye(4)
    affine[2, 2], affine[:3, 3] = distance, places[0]
    return affine


def of_places(path: Path) -> np.ndarray:
    """Return the map [mm, LPS] by the places of the first two frames of a DICOM file."""
    import pydicom

    groups = pydicom.dcmread(path).PerFrameFunctionalGroupsSequence
    first, second = (np.array(g.PlanePositionSequence[0].ImagePositionPatient, float) for g in groups[:2])
    affine = np.eye(4)
    affine[:3, 2], affine[:3, 3] = second - first, first
    return affine


READERS: dict[str, Callable[[Path], np.ndarray]] = {
    "nibabel": of_nibabel, "ITK": of_itk, "highdicom": of_highdicom, "places": of_places,
}  # fmt: skip
OTHERS = {".nii": ("nibabel", "ITK"), ".nrrd": ("ITK",), ".mha": ("ITK",), ".dcm": ("highdicom", "places")}


def apart(taken: np.ndarray, other: np.ndarray, shape: tuple[int, ...]) -> float:
    """Return the largest distance [mm] of a corner of the image between two maps."""
    corners = np.array([(*each, 1) for each in product(*((0, size - 1) for size in shape))])
    return float(np.linalg.norm(corners @ (other - taken).T, axis=1).max())


def main() -> int:
    """Compare all files; return 1 if one is not as the reader that palpate follows, or a note is missing."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for case in cases():
            path = Path(folder) / case.name
            path.write_bytes(case.data)
            labels = read_label_map(path)
            taken = np.diag([1e3, 1e3, 1e3, 1.0]) @ labels.affine
            texts, bad = list[str](), bool(labels.notes) != case.differs
            for name in OTHERS[path.suffix]:
                try:
                    distance = apart(taken, READERS[name](path), labels.shape)
                except Exception as error:  # of the other reader
                    texts.append(f"{name} refuses ({str(error).strip().splitlines()[-1][:70]})")
                    bad |= name == case.follows
                    continue
                texts.append(f"{name} {distance:.3g} mm")
                bad |= name == case.follows and not distance < 1e-3
            failed += bad
            print(f"{'FAILED ' * bad}{case.name}: {', '.join(texts)}; {'; '.join(labels.notes) or 'no note'}")
    return int(failed > 0)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as error:
        sys.exit(f"refused: {error}")
