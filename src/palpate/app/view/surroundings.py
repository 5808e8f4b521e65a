"""What a label map has around a body: its other labels, and where the image ends; made in the background."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from palpate.core.arrays import Floats
from palpate.surface.labels.mask_surface import chosen_mask
from palpate.surface.labels.neighbours import cut_faces
from palpate.surface.labels.reading import is_label_map, read_label_map
from palpate.surface.labels.surroundings import surrounding_surfaces

if TYPE_CHECKING:
    from palpate.app.view.server.host import Host
    from palpate.scenes.scene import Scene
    from palpate.surface.labels.label_map import Mask
    from palpate.surface.surface import Surface


class Surroundings(NamedTuple):
    """Surfaces around a body, and planes at which the edge of the image cuts the body off, both in its frame."""

    shapes: tuple[Surface, ...]
    edges: Floats  # (k, 2, 3) array: a point [m] and the unit normal inwards


NO_SURROUNDINGS = Surroundings((), np.zeros((0, 2, 3)))


def surroundings_of(scene: Scene) -> Surroundings:
    """Return what is around the body of a scene; nothing unless its surface is of a label map."""
    shape = scene.description.surface
    if not shape.file or not is_label_map(shape.file):
        return NO_SURROUNDINGS
    names = scene.folder / shape.labels if shape.labels else None
    labels = read_label_map(scene.folder / shape.file, names).scaled(shape.scale)
    part = list(shape.parts) or None
    return Surroundings(surrounding_surfaces(labels, part), edges_of(chosen_mask(labels, part)))


def edges_of(mask: Mask) -> Floats:
    """Return the planes (k, 2, 3) at which the edge of its image cuts a mask: a point [m] and the normal inwards."""
    planes = []
    for face in cut_faces(mask):
        voxel = np.abs(face.normal @ mask.affine[:3, :3]).max()  # along the normal
        planes.append((face.point - 0.5 * voxel * face.normal, face.normal))
    return np.reshape(planes, (-1, 2, 3))


def show_surroundings(host: Host, scene: Scene) -> None:
    """Show the surroundings of a body on the page as soon as they are made, without waiting for them."""

    def show() -> None:
        host.surround(surroundings_of(scene))

    threading.Thread(target=show, name="palpate surroundings", daemon=True).start()
