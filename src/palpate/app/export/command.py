"""``palpate export``: compile a model to a library, and print where its files are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from time import process_time

from palpate.app.common.console import Console
from palpate.app.common.machine import keep, kept_seconds
from palpate.app.export.web import check_page, export_web
from palpate.app.models.input import open_input
from palpate.app.train.estimate import Estimate, confirm
from palpate.core.faults import InputError
from palpate.export.folder import check_new, export_c, identifier
from palpate.export.library import Library, check_library, lower_model
from palpate.export.targets import HOST_TARGET, WEB_TARGETS
from palpate.reduction.hyper.model import ReducedModel

STEP_TIME, MACHINE_TIME = "step of a library", "step of a library for a machine"  # names of kept times
GUESSED_STEP, GUESSED_MACHINE = 45.0, 28.0  # [s] of one core in docs/validation/first_start.json, until they are kept


def export(
    *,
    model: str,
    part: Sequence[str] | None = None,
    labels: Path | None = None,
    without: Sequence[str] = (),
    folder: Path | None = None,
    web: Path | None = None,
    name: str | None = None,
    targets: Sequence[str] | None = None,
    relaxed: bool = False,
    tools: int = 2,
    yes: bool = False,
) -> int:
    """Write a library of a model for programs in C to a folder, a page on which a browser steps it to `web`, or both.

    All options are checked before a model is trained or compiled. With `yes` nobody is asked before work of minutes.
    """
    console, chosen = Console(), identifier(Path(model).stem) if name is None else name
    if folder is None:
        if web is None:
            raise InputError("--c or --web must be given, got neither; give a folder for one of them, or for both")
        if name is not None or targets or relaxed:
            raise InputError("web must be with --c where name, target or relaxed is given, got no --c; add it")
    for argument, each in (("folder", folder), ("web", web)):
        if each is not None:
            check_new(each, argument)
    if folder is not None and web is not None and folder.absolute() == web.absolute():
        raise InputError(f"web must be another folder than that of --c, got {str(web)!r}; choose another")
    if web is not None:
        check_page()
    check_library(chosen, tools)
    opened = open_input(model, for_training=True, part=part, labels=labels, without=without)
    machines = list(dict.fromkeys(targets or [HOST_TARGET])) if folder is not None else []
    training, estimate = opened.training_needed(console), _estimate(machines, web is not None)
    if training is not None:
        estimate = training.followed_by(estimate)
    else:
        estimate = estimate._replace(what=f"{opened.title}: {estimate.what}")
    confirm(console, estimate, "Compile?" if training is None else "Train and compile?", yes)
    reduced, complete = opened.reduced(console), list[str]()
    if training is not None:
        complete.append("the trained model is kept")
    try:
        library = _lower(reduced, chosen, tools, console)
        if folder is not None:
            _write_library(library, folder, opened.title, machines, not relaxed, console)
            complete.append(f"{folder} is complete")
        if web is not None:
            _write_page(library, web, opened.title, console)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("; ".join(complete)) from None
    return 0


def _lower(model: ReducedModel, name: str, tools: int, console: Console) -> Library:
    """Return the library of a model, and keep the time of that."""
    began = process_time()
    with console.status("compiling the step of the model"):
        library = lower_model(model, name, tools)
    keep(STEP_TIME, process_time() - began)
    return library


def _write_library(
    library: Library, folder: Path, title: str, machines: Sequence[str], strict: bool, console: Console
) -> None:
    """Write the library for machines, and print its files."""
    began = process_time()
    with console.status(f"writing the library for {_words(machines)}"):
        written = export_c(library, folder, title=title, targets=machines, strict=strict, say=console.say)
    keep(MACHINE_TIME, (process_time() - began) / len(machines))
    _say(console, folder, written)
    console.say(f"build and run it: cmake -S {folder} -B {folder}/build && cmake --build {folder}/build")
    console.say(f"                  {folder}/build/press {folder}/{library.name}.palpate")


def _write_page(library: Library, folder: Path, title: str, console: Console) -> None:
    """Write the page, and print its files."""
    with console.status("writing the page for browsers"):
        written = export_web(library, folder, title)
    _say(console, folder, written)
    console.say(f"open it:          python3 -m http.server --directory {folder} 8000")
    console.say("                  http://localhost:8000")


def _estimate(machines: Sequence[str], has_page: bool) -> Estimate:
    """Return the estimate of compiling a model's step for machines, and for browsers."""
    step, machine = kept_seconds(STEP_TIME), kept_seconds(MACHINE_TIME)
    count = len(machines) + (len(WEB_TARGETS) if has_page else 0)
    seconds = (step or GUESSED_STEP) + count * (machine or GUESSED_MACHINE)
    what = f"compiling of its step for {_words([*machines, *(['browsers'] if has_page else [])])}"
    return Estimate(what, {"compiling the step": seconds}, is_guess=step is None or machine is None)


def _words(machines: Sequence[str]) -> str:
    return ", ".join("this machine" if each == HOST_TARGET else each for each in machines)


def _say(console: Console, folder: Path, written: dict[str, str]) -> None:
    for file, about in written.items():
        console.say(f"{folder / file}: {about}")
