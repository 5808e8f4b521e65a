"""The other labels around a body of a label map, made in the background and shown on the page."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from palpate.surface.labels.reading import is_label_map, read_label_map
from palpate.surface.labels.surroundings import surrounding_surfaces

if TYPE_CHECKING:
    from palpate.app.view.server.host import Host
    from palpate.scenes.scene import Scene
    from palpate.surface.surface import Surface


def surroundings_of(scene: Scene) -> tuple[Surface, ...]:
    """Return the surfaces around the body of a scene, in its frame; none unless its surface is of a label map."""
    shape = scene.description.surface
    if not shape.file or not is_label_map(shape.file):
        return ()
    names = scene.folder / shape.labels if shape.labels else None
    labels = read_label_map(scene.folder / shape.file, names).scaled(shape.scale)
    return surrounding_surfaces(labels, list(shape.parts) or None)


def show_surroundings(host: Host, scene: Scene) -> None:
    """Show the surroundings of a body on the page as soon as they are made, without waiting for them."""

    def show() -> None:
        host.surround(surroundings_of(scene))

    threading.Thread(target=show, name="palpate surroundings", daemon=True).start()
