"""Parser of ``palpate train``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import (
    add_command,
    add_json,
    add_parameter,
    add_parts,
    add_yes,
    existing_file,
    path,
    whole,
)
from palpate.scenes.description import Training
from palpate.scenes.names import listed_scenes


def add_train(commands: Any) -> None:
    """Add the command to those of a parser."""
    train = add_command(
        commands,
        "train",
        "palpate.app.train.command:train",
        summary="train a reduced model on many runs along random paths of a tool",
        description="Run a scene's full model along random paths of its tools, each run into a file of its own, and "
        "train a reduced model on all of them. The same command, given again, continues a campaign that was stopped. "
        "See docs/howto/training.md.",
    )
    train.renamed["--folder"] = "--out"
    train.assignments["given"] = "--set"
    add_parts(train)
    add = train.add_argument
    text = (
        f"{listed_scenes()}, a scene file (organ.toml), a surface file, or module:function of your own, also from the "
    )
    text += "current folder"
    add("scene", metavar="SCENE", help=text)
    text = "settings of the scene, such as spacing=5mm, or parameters of the function"
    add("--set", nargs="+", action="extend", default=[], dest="given", metavar="NAME=X", help=text)
    text = "; with --tolerance, the most (default: that of the scene; 64 of a function)"
    add_parameter(train, Training, "paths", text)
    add_parameter(train, Training, "held_out", " (default: that of the scene; 8 of a function)")
    add_parameter(train, Training, "seed", " (default: that of the scene; 0 of a function)")
    text = (
        "choose paths on uncovered surface and where the model errs most, at most --paths, until its mean errors of "
        "displacement and forces on the held-out runs are at most this"
    )
    add_parameter(train, Training, "tolerance", help=text)
    text = "recordings of sessions (palpate view): also train on their tool paths with error indicators above 1"
    add("--more", type=existing_file, nargs="+", action="extend", default=[], metavar="FILE.h5", help=text)
    text = " (default: that of the scene, 24 of a function; with --tolerance, up to 96 if all paths do not keep it)"
    add_parameter(train, Training, "modes", text)
    text = (
        "largest relative error of the sampled forces in training: the larger it is, the fewer nodes are sampled and "
        "the faster a step is; 0 samples every node (default: 0.01 where tools touch the body anywhere, else 0.001)"
    )
    add_parameter(train, Training, "cubature", metavar="TOLERANCE", help=text)
    text = "number of processes on this machine, of one thread each (default: 1)"
    add("--workers", type=whole, metavar="N", help=text)
    text = "address of a Dask scheduler, or its file: use its workers instead of processes on this machine"
    add("--cluster", metavar="ADDRESS", help=text)
    text = "folder for the campaign (default: next to a scene file; out/train of others)"
    add("--out", type=path, metavar="FOLDER", help=text)
    add_yes(train)
    add_json(train, "the report")
