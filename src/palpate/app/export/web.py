"""A page without a server: the page of ``palpate view`` with a model in WebAssembly that the browser steps."""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.models.force_error import nodes_error
from palpate.app.recordings.snapshot import scalar_descriptions, training_errors
from palpate.app.session.messages import describe_tools
from palpate.app.session.session import MAX_TOOL_SPEED, material_sliders, trained_speed
from palpate.app.view.server.page import PAGE_FOLDER
from palpate.core.faults import InputError
from palpate.core.files import write_bytes
from palpate.export.folder import complete_folder
from palpate.export.library import Library
from palpate.export.targets import WEB_TARGETS
from palpate.export.wasm import module_of_object
from palpate.realtime.bodies.display_surface import Surface
from palpate.realtime.record import HEADER_DTYPE, HEADER_SIZE, TOOL_DTYPE, TOOL_SIZE, field_offset
from palpate.reduction.hyper.model import ReducedModel

MODEL_NAME, MODEL_FOLDER = "model", "model"  # the beginning of the functions' names, and the folder of the files
PAGE_MARK, HIDDEN_DISCLAIMER = '<meta charset="utf-8" />', '<p id="disclaimer" hidden>'
RATE = 1000.0  # [Hz] of the periods
WEB_TOOLS = ("sphere", "capsule", "grasp")  # whose sizes page/src/localSession.js computes


def check_page() -> None:
    """Raise `InputError` unless the page is built."""
    if not (PAGE_FOLDER / "index.html").is_file():
        raise InputError(f"the page must be built, got no {PAGE_FOLDER / 'index.html'}; see docs/howto/view.md")


def export_web(library: Library, folder: Path, title: str) -> dict[str, str]:
    """Write a page for any web server, on which a browser steps a model; as `palpate.export.folder.export_c`."""
    check_page()
    about, library = _describe(library.model, title), library._replace(name=MODEL_NAME)
    modules = {name: module_of_object(library.emit(target), library.symbols) for name, target in WEB_TARGETS.items()}
    about["memory_size"], about["data_end"] = library.memory.size, max(each.data_end for each in modules.values())
    with complete_folder(folder) as part:
        shutil.copytree(PAGE_FOLDER, part, dirs_exist_ok=True)
        page = (part / "index.html").read_text(encoding="utf-8")
        page = page.replace(PAGE_MARK, f'{PAGE_MARK}\n    <meta name="palpate-model" content="{MODEL_FOLDER}" />')
        write_bytes(part / "index.html", page.replace(HIDDEN_DISCLAIMER, '<p id="disclaimer">').encode())
        data = part / MODEL_FOLDER
        data.mkdir(exist_ok=True)
        write_bytes(data / "model.json", json.dumps(about).encode())
        write_bytes(data / "model.gz", gzip.compress(library.image, mtime=0))
        for name, module in modules.items():
            write_bytes(data / f"{name}.wasm", module.content)
    return {
        "index.html": "the page; any web server can serve the folder",
        f"{MODEL_FOLDER}/simd.wasm": "the functions; scalar.wasm for browsers without vectors",
        f"{MODEL_FOLDER}/model.gz": "the constants of the model",
    }


def _describe(model: ReducedModel, title: str) -> dict[str, Any]:
    """Return the constants of ``hello`` (docs/reference/protocol.md), and the places of the record's fields."""
    surface, prescribed = Surface(model), model.data.prescribed
    about: dict[str, Any] = {
        "title": title, "vertices": len(surface.rest), "triangles": len(surface.triangles),
        "spacing": model.cloud.spacing, "rate": RATE,
        "bounds": [surface.rest.min(axis=0).tolist(), surface.rest.max(axis=0).tolist()],
        "tools": [] if prescribed else list(WEB_TOOLS), **describe_tools([] if prescribed else WEB_TOOLS),
        "scalars": [scalar for scalar in scalar_descriptions(surface) if scalar["name"] == "displacement"],
        "materials": material_sliders(model, 1.0), "tool_speed": trained_speed(model),
        "max_tool_speed": MAX_TOOL_SPEED,
        "training_errors": training_errors(model),
        "nodes_error": nodes_error(model),
        "record": {name: field_offset(name) for name in HEADER_DTYPE.names or ()},
        "tool_record": {"start": HEADER_SIZE, "size": TOOL_SIZE} | {
            name: field_offset(name, TOOL_DTYPE) for name in TOOL_DTYPE.names or ()
        },
    }  # fmt: skip
    if prescribed:
        centre = np.zeros(3)
        points = model.cloud.points[model.cloud.group(prescribed[0])]
        centre[: points.shape[1]] = points.mean(axis=0)
        about["group_centre"] = centre.tolist()
    return about
