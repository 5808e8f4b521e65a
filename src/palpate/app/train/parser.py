"""Parser of ``palpate train``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import Command, add_command, add_output, existing_file, number, whole
from palpate.scenes.names import listed_scenes

__all__ = ["add_train"]


def _load() -> Command:
    from palpate.app.train.command import train

    return train


def add_train(commands: Any) -> None:
    """Add the command to those of a parser."""
    train = add_command(
        commands,
        "train",
        _load,
        summary="train a reduced model on many runs along random paths of a tool",
        description="Run a scene's full model along random paths of its tools, each run into a file of its own, and "
        "train a reduced model on all of them. The same command, given again, continues a campaign that was stopped. "
        "See docs/training.md.",
    )
    train.renamed["--folder"] = "--out"
    train.assignments["given"] = "--set"
    add = train.add_argument
    text = f"{listed_scenes()}, or module:function of your own, also from the current folder"
    add("scene", metavar="SCENE", help=text)
    text = "parameters of the scene, such as spacing=0.005"
    add("--set", nargs="+", action="extend", default=[], dest="given", metavar="NAME=X", help=text)
    add("--paths", type=whole, default=64, metavar="K", help="number of runs to train on; with --tolerance, the most")
    text = "number of further runs, on which errors are measured"
    add("--held-out", type=whole, default=8, metavar="K", help=text)
    add("--seed", type=whole, default=0, metavar="K", help="seed of the paths")
    text = (
        "choose paths on uncovered surface and where the model errs most, at most --paths, until its mean errors of "
        "displacement and forces on the held-out runs are at most this"
    )
    add("--tolerance", type=number, metavar="E", help=text)
    text = "recordings of sessions (palpate view): also train on their tool paths with trust numbers above 1"
    add("--more", type=existing_file, nargs="+", action="extend", default=[], metavar="FILE.h5", help=text)
    add("--modes", type=whole, default=24, metavar="M", help="number of modes of the reduced model")
    text = (
        "largest relative error of the sampled forces in training: the larger it is, the fewer nodes are sampled and "
        "the faster a step is; 0 samples every node (default: 0.01 for the liver, 0.001 for others)"
    )
    add("--cubature", type=number, metavar="TOLERANCE", help=text)
    text = "number of processes on this machine, of one thread each (default: 1)"
    add("--workers", type=whole, metavar="N", help=text)
    text = "address of a Dask scheduler, or its file: use its workers instead of processes on this machine"
    add("--cluster", metavar="ADDRESS", help=text)
    add_output(train, "out/train")
