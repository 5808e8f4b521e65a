"""Scenes: a body with its supports, tools and training, as a file or a name states them.

`description.py` declares the sections and keys of a scene file, each with unit, range, choices and help; messages, the
schema and the docs follow from them. `scene_text.py` reads TOML and places faults by line. A `Scene` is a description
in a folder. It imports `body.py` and `scene_paths.py` at their first use, so that a page shows the surface before
mechanics. These take sections, never a scene. `beam.py` and `membrane.py` are the paper's load cases.
"""
