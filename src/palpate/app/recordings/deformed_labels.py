"""The label map of a recorded body at one moment, and the field that resamples an image to it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.app.recordings.recording import Recording
from palpate.core.arrays import Floats
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.nodal.model import NodalModel
from palpate.realtime.bodies.display_surface import DisplaySurface
from palpate.realtime.bodies.full_surface import display_surface
from palpate.surface.labels.agreement import is_sheared
from palpate.surface.labels.deformed import body_segments, deform, resampling_field
from palpate.surface.labels.label_map import choose_segments
from palpate.surface.labels.reading import read_label_map
from palpate.surface.labels.writers import check_volume_name, write_field, write_layers


def write_deformed_labels(
    recording: Recording,
    labels_file: Path,
    *,
    out: Path | None,
    field_out: Path | None,
    time: float | None = None,
    part: Sequence[str] | None = None,
) -> list[str]:
    """Write the deformed label map of a recorded body, and what was done as lines of text.

    `labels_file` is the map from which the body was made, or another image of the same patient and frame. The map `out`
    is written in its image; the field `field_out` resamples an image to the deformed body. `time` [s] is by default
    that of the largest force, `part` the labels that lie in the body.
    """
    for path, name in ((out, "out"), (field_out, "field")):
        if path is not None:
            check_volume_name(path, name)
            if path.exists() and labels_file.exists() and path.samefile(labels_file):
                raise InputError(f"{name} must not replace the label map, got {str(path)!r}; choose another name")
    frame = _frame(recording, time)
    if any(cut.start <= frame for cut in recording.cuts):
        raise InputError("frame must be before the first cut of the recording, got a later one; choose another time")
    labels, cloud = read_label_map(labels_file), recording.model.cloud
    if cloud.points.shape[1] != 3:
        raise InputError("labels must be left out for a recording of a sheet, which fills no voxel")
    parts = choose_segments(labels, part) if part else body_segments(labels, cloud.points, cloud.triangles)
    displacements = nodal_displacements(recording, frame, display_surface(recording.model))
    field, distance = resampling_field(labels, cloud.points, displacements, cloud.spacing)
    lines = [f"{labels.name}: {note}" for note in labels.notes]
    lines.append(f"at {recording.times[frame]:.3g} s, of {', '.join(each.name for each in parts)}:")
    if out is not None:
        layers = deform(labels, parts, field, distance, cloud.spacing)
        segments = sorted(labels.segments, key=lambda each: each in parts)  # the body is on top in one layer
        notes = write_layers(out, layers, labels.affine, segments)
        count = sum(np.count_nonzero(layers[each.layer] == each.number) for each in parts)
        ratio = count / sum(each.count for each in parts)
        lines += [f"wrote {out}: the body's voxels have {ratio:.2%} of their volume at rest", *notes]
    if field_out is not None:
        write_field(field_out, field, labels.affine)
        lines.append(f"wrote {field_out}: displacements of up to {1e3 * np.linalg.norm(field, axis=3).max():.3g} mm")
    nifti = [each.name for each in (out, field_out) if each is not None and not each.name.lower().endswith(".nrrd")]
    if nifti and is_sheared(labels.affine):
        lines.append(
            f"the axes of {labels.name} are sheared, and so are those of {' and '.join(nifti)}: ITK refuses them in "
            "NIfTI, and reads names that end in .nrrd"
        )
    return lines


def nodal_displacements(recording: Recording, frame: int, surface: DisplaySurface) -> Floats:
    """Return the displacements (n, 3) [m] of all nodes of a recorded body; on its surface also under the tool."""
    snapshot, model = recording.snapshots[frame], recording.model
    if isinstance(model, NodalModel):
        return np.asarray(snapshot.coordinates, dtype=float).reshape(-1, 3)
    displacements = np.tensordot(snapshot.coordinates, model.body.vectors[: model.count], axes=1)
    displacements[surface.nodes] = snapshot.displacements(surface)
    return np.asarray(displacements)


def _frame(recording: Recording, time: float | None) -> int:
    """Return the index of the last snapshot up to a time [s], or that of the largest force."""
    if time is None:
        return int(np.argmax([each.largest_force for each in recording.snapshots]))
    number_in_range("frame", time, 0.0, float(recording.times[-1]), unit="s")
    return max(0, int(np.searchsorted(recording.times, time, side="right")) - 1)
