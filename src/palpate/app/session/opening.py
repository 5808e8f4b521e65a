"""Opening of a session: the body of an input is prepared and stepped, and its recordings are written at the end."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.app.common.console import Console
from palpate.app.models.input import Input
from palpate.app.train.scene_folder import recordings_folder
from palpate.core.faults import InputError
from palpate.core.files import check_folder
from palpate.scenes.names import SceneKind
from palpate.scenes.scene import Scene

if TYPE_CHECKING:  # it takes a second to import, before a page opens
    from palpate.app.session.session import Session
    from palpate.dynamics.loads.foundation import Foundation

MakeSession = Callable[[Any, "tuple[Foundation, ...]"], "Session"]

MAX_REFILLS, LOAD_SECONDS = 3, 0.5  # of a body whose steps take another time than expected; of a measurement


@contextlib.contextmanager
def running_session(
    opened: Input,
    full: bool,
    make: MakeSession,
    console: Console,
    record: Path | None = None,
    wait: Callable[[], object] | None = None,
    exact: bool = False,
) -> Iterator[Session]:
    """Yield a running session; stop it at the end, and write its recordings.

    With `full`, the full body of the scene is stepped, in place of its reduced model. It keeps real time;
    with `exact` it has the spacing of the scene, where that gives one. `make` returns the session of a body and its
    springs; before that, `wait` is called. `record` is the file of a recording of the whole session.
    """
    console.begin_phase("starting")
    from palpate.app.models.full_body import is_guessed
    from palpate.app.models.spacing_cache import cached_spacing

    scene, fitted = opened.scene, None
    if scene is not None and full and exact and scene.description.body.spacing is not None:
        with console.status("filling the surface with nodes (the first time on a machine compiles it)"):
            fitted, _ = scene, scene.body
    elif scene is not None and full:
        spacing = None
        with contextlib.suppress(OSError, InputError):  # of a missing file, which the body then names
            spacing = cached_spacing(scene.digest)
        fitted = _full_body(scene, console, spacing)
    body: Any = opened.reduced(console) if fitted is None else fitted.body
    with console.status("preparing the engine (the first time on a machine compiles it, for about a minute)"):
        if wait is not None:
            wait()
        session = make(body, () if scene is None else scene.foundations)
    if scene is not None and fitted is not None:
        _describe(session, scene, fitted)
    session.start()
    try:
        if scene is not None and fitted is not None and is_guessed(scene, fitted):
            session = refill_until_realtime(session, scene, fitted, make, console)
        if scene is not None and scene.kind is SceneKind.SCENE_FILE:
            session.recordings.folder = recordings_folder(Path(scene.name))
        if record is not None:
            session.recordings.start(record)
        yield session
    finally:
        session.close()
        with contextlib.suppress(OSError):  # the terminal was closed
            for message in session.notifications:
                failed = message["type"] == "error"
                console.say(
                    message["reason"] if failed else f"recorded {message['frames']} snapshots in {message['file']}"
                )


def _full_body(scene: Scene, console: Console, spacing: float | None) -> Scene:
    """Return a scene with its full body, and print what was guessed and repaired."""
    from palpate.app.models.full_body import full_body_lines, prepare_full_body

    fitted = prepare_full_body(scene, console.status, spacing)
    for line in full_body_lines(scene, fitted):
        console.say(line)
    return fitted


def _describe(session: Session, scene: Scene, fitted: Scene) -> None:
    """Give a session of a surface the lines that were printed about its body, for its viewers."""
    from palpate.app.models.full_body import force_line, notes_of

    session.subtitle, notes = scene.subtitle, notes_of(scene, fitted)
    session.notes = (*notes, force_line(fitted)) if scene.surface is not None else tuple(notes)


def refill_until_realtime(
    session: Session, scene: Scene, fitted: Scene, make: MakeSession, console: Console
) -> Session:
    """Return the running session, or one of the same surface filled again, whose body keeps real time."""
    from palpate.app.models.spacing import better_spacing
    from palpate.app.models.spacing_cache import cache_spacing

    for _ in range(MAX_REFILLS):
        spacing = better_spacing(fitted.body.cloud, session.load(LOAD_SECONDS))
        if spacing is None:
            break
        session.close()
        console.say("the body is filled again, since its steps take another time than expected")
        before, fitted = fitted.body.cloud.spacing, _full_body(scene, console, spacing)
        session = make(fitted.body, fitted.foundations)
        _describe(session, scene, fitted)
        session.start()
        if fitted.body.cloud.spacing == before:  # thin tissue has no coarser one
            break
    cache_spacing(scene.digest, fitted.body.cloud.spacing)
    return session


def check_record(path: Path, source: str) -> None:
    """Raise InputError if a recording, or its file for ParaView, would replace another file."""
    check_folder(path.parent, "record")
    if path.suffix != ".h5":
        raise InputError(f"record must end in .h5, got {str(path)!r}; its file for ParaView ends in .vtkhdf")
    from palpate.app.recordings.recording_journal import is_recording

    recorded = is_recording(path)
    for each in (path, path.with_suffix(".vtkhdf")):
        if each.exists() and Path(source).exists() and os.path.samefile(each, source):
            raise InputError(f"record must be another file than the model, got {str(path)!r}; choose another name")
        if each.exists() and not recorded:
            raise InputError(
                f"record must be a new file or an earlier recording, got {str(path)!r}, but {each.name} is another "
                "file; choose another name"
            )


@contextlib.contextmanager
def exit_on_signals() -> Iterator[None]:
    """Raise SystemExit for SIGTERM and SIGHUP, so that recordings are written; ignore further signals."""
    signals = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    signals = [each for each in signals if signal.getsignal(each) is signal.SIG_DFL]  # nohup ignores one of them
    if threading.current_thread() is not threading.main_thread():
        signals = []

    def end(number: int, frame: object) -> None:
        for each in signals:
            signal.signal(each, signal.SIG_IGN)
        raise SystemExit(128 + number)

    for each in signals:
        signal.signal(each, end)
    try:
        yield
    finally:
        for each in signals:
            signal.signal(each, signal.SIG_DFL)
