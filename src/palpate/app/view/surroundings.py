"""What a label map has around a body: its other labels, and where the image ends; made in the background."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from palpate.surface.labels.reading import is_label_map, read_label_map
from palpate.surface.labels.surroundings import NO_SURROUNDINGS, Surroundings, surroundings_in

if TYPE_CHECKING:
    from palpate.app.view.server.host import Host
    from palpate.scenes.scene import Scene


def surroundings_of(scene: Scene) -> Surroundings:
    """Return what is around the body of a scene; nothing unless its surface is of a label map."""
    shape = scene.description.surface
    if not shape.file or not is_label_map(shape.file):
        return NO_SURROUNDINGS
    names = scene.folder / shape.labels if shape.labels else None
    labels = read_label_map(scene.folder / shape.file, names).scaled(shape.scale)
    return surroundings_in(labels, list(shape.parts) or None)


def show_surroundings(host: Host, scene: Scene) -> None:
    """Show the surroundings of a body on the page as soon as they are made, without waiting for them."""

    def show() -> None:
        host.surround(surroundings_of(scene))

    threading.Thread(target=show, name="palpate surroundings", daemon=True).start()
