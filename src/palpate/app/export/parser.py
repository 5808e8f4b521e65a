"""Parser of ``palpate export``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import add_command, add_parts, add_yes, path
from palpate.export.targets import TARGET_NAMES


def add_export(commands: Any) -> None:
    """Add the command to those of a parser."""
    export = add_command(
        commands,
        "export",
        "palpate.app.export.command:export",
        summary="compile a trained model to a library for C, C++ and Unity, or to a page for any web server",
        description="Compile the engine's step of a reduced model to a library without Python: objects, a shared "
        "library, a file of constants, a C header, a program that presses the organ at 1 kHz, and a C# file for "
        "Unity (--c). Or to a page on which a browser steps it (--web). Both are made of one compilation. See "
        "docs/howto/export.md.",
    )
    add = export.add_argument
    text = "file of palpate train, a scene of palpate view, a scene file, or a surface file, whose model is trained"
    add("model", metavar="MODEL", help=text)
    add_parts(export)
    text = "folder for a library and its sources in C; new or empty"
    add("--c", type=path, dest="folder", metavar="FOLDER", help=text)
    text = "folder for a page without a server, on which the browser steps the model; new or empty"
    add("--web", type=path, metavar="FOLDER", help=text)
    text = "beginning of the names of files and functions (default: the name of the model)"
    add("--name", metavar="NAME", help=text)
    text = "machine that the library is for; may be repeated (default: host, this one)"
    add("--target", action="append", choices=TARGET_NAMES, metavar="TARGET", dest="targets", help=text)
    text = "allow fused and reordered sums: faster by a tenth, and targets differ in the last bits"
    add("--relaxed", action="store_true", help=text)
    text = "number of tools that can touch the model at once, 1 to 4 (default: 2)"
    add("--tools", type=int, default=2, metavar="N", help=text)
    add_yes(export)
