"""Parsers of ``palpate view`` and ``palpate replay``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import (
    Parser,
    add_command,
    add_parameter,
    add_yes,
    existing_file,
    number,
    path,
    whole,
)
from palpate.app.common.surface_options import add_surface_options
from palpate.app.device.options import add_device
from palpate.scenes.description import Body
from palpate.scenes.names import listed_scenes
from palpate.surface.formats.names import listed_formats


def add_view(commands: Any) -> None:
    """Add the command ``palpate view`` to those of a parser."""
    view = add_command(
        commands,
        "view",
        "palpate.app.view.command:view",
        summary="press and pull a body on a page in the browser",
        description="Show a body in real time on a page, where a tool presses, grasps and pulls it. "
        "See docs/howto/view.md.",
    )
    add = view.add_argument
    text = (
        f"a scene ({listed_scenes()}), a surface file or a label map ({listed_formats()}), whose full body is touched "
        "at once; or the file of a reduced model, such as model.rom of palpate train"
    )
    add("source", metavar="SCENE|FILE", help=text)
    group = add_surface_options(view)
    add_parameter(group, Body, "spacing", " (default: the finest that this machine steps in real time)")
    text = "parameters of the law, density and poisson, in SI units; settings of a scene"
    group.add_argument("--set", nargs="+", action="extend", default=[], dest="given", metavar="NAME=X", help=text)
    text = (
        "train a reduced model in the background, next to the file, and change over to it; continues a training that "
        "was stopped; a model that was trained before takes over without this option"
    )
    add("--refine", action="store_true", help=text)
    text = "show no full body: wait for the reduced model of the scene, which is trained if none is kept"
    add("--reduced", action="store_true", help=text)
    text = "of a reduced model: also step the full model of its training scene under the same tool, and compare forces"
    add("--compare", action="store_true", help=text)
    text = "with --compare: your own scene, which the model must name; also from the current folder"
    add("--scene", metavar="MODULE:FUNCTION", help=text)
    _add_address(view)
    text = "record the session, and write it to this file when it ends, or another body takes the place of the first"
    add("--record", type=path, metavar="FILE.h5", help=text)
    add_yes(view)
    add_device(view)
    script = "palpate run SCENE|FILE --script FILE --seconds S, with --full for the full body of a scene file"
    view.moved = dict.fromkeys(("--headless", "--seconds", "--script", "--json"), script)


def add_replay(commands: Any) -> None:
    """Add the command ``palpate replay`` to those of a parser."""
    replay = add_command(
        commands,
        "replay",
        "palpate.app.view.replay_command:replay",
        summary="show or export what palpate view has recorded",
        description="Show a recording on a page, draw it, or run its tool's path on the full model. "
        "See docs/howto/recordings.md.",
    )
    add = replay.add_argument
    add("file", type=existing_file, metavar="FILE.h5", help="the recording, or a scene file: its newest recording")
    text = "run the path on the full model, and print the error of the recorded model"
    add("--full", action="store_true", help=text)
    text = "with --full: your own scene, which the recording must name; also from the current folder"
    add("--scene", metavar="MODULE:FUNCTION", help=text)
    add("--png", type=path, metavar="FILE.png", help="draw the moment of the largest force into a PNG file")
    text = "draw the whole recording into a film: .gif, .webp or .mp4"
    add("--movie", type=path, metavar="FILE", help=text)
    text = "field that the colours of pictures show: displacement, stress or pressure"
    add("--scalar", default="displacement", metavar="NAME", help=text)
    _add_deformed_labels(replay)
    _add_address(replay)


def _add_deformed_labels(parser: Parser) -> None:
    """Add the options of the deformed label map of a recorded body."""
    group = parser.add_argument_group("of the deformed label map")
    add = group.add_argument
    add("--labels", type=existing_file, metavar="MAP", help="label map of the body at rest, from which it was made")
    text = "write the deformed label map, in the image of --labels: .nii, .nii.gz or .nrrd"
    add("-o", "--out", type=path, metavar="FILE", help=text)
    text = "write the displacement field that resamples an image of the body at rest to the deformed one"
    add("--field", type=path, metavar="FILE", help=text)
    text = "moment of the recording [s] (default: that of the largest force)"
    add("--frame", type=number, metavar="T", help=text)
    text = "label of the body, by its name or number; may be repeated (default: those that lie in it)"
    add("--part", action="append", metavar="NAME", help=text)


def _add_address(parser: Parser) -> None:
    add = parser.add_argument
    add("--port", type=whole, default=8765, metavar="N", help="port of the page; the next free one if it is taken")
    text = "address of this machine to serve the page on; any other lets other machines connect"
    add("--host", default="127.0.0.1", metavar="ADDRESS", help=text)
    text = "address of a forwarded port or a reverse proxy by which browsers reach the page; its host is allowed, too"
    add("--public-url", metavar="https://HOST/PREFIX/", help=text)
    add("--no-browser", action="store_false", dest="browser", help="open no browser, only print the address")
