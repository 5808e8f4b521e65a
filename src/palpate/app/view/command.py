"""Command ``palpate view``: shows a body in real time on a page, or drives it by a script."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.app.common.arguments import parse_settings
from palpate.app.common.console import Console, print_json, print_plain, quantities_table
from palpate.app.common.exit_status import DONE, FAILED, INTERRUPTED
from palpate.app.train.scene_folder import recordings_folder
from palpate.app.view.server.address import DEFAULT_PORT, LOOPBACK, open_listener
from palpate.dynamics.loads.foundation import Foundation
from palpate.extras import require
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.files import check_folder
from palpate.scenes.names import PACKAGE_SCENES, is_scene_file
from palpate.scenes.open_scene import open_scene
from palpate.scenes.places import side_mask
from palpate.scenes.surface_scene import is_surface_file, surface_scene
from palpate.surface.surface import Surface

if TYPE_CHECKING:  # each takes a second to import, before the page opens
    from palpate.app.session.messages import Message
    from palpate.app.session.session import Session
    from palpate.reduction.hyper.model import ReducedModel
    from palpate.scenes.organ_scene import OrganScene

__all__ = ["view"]

MAX_HEADLESS_SECONDS = 3600.0  # [s] of a headless session
MAX_REFILLS, LOAD_SECONDS = 3, 0.5  # of a body whose steps take another time than expected; of a measurement
STOP_SECONDS, TRAINING_STOP_SECONDS = 1.0, 10.0  # [s] after an interrupt; workers of a training are stopped in order


def view(
    what: str,
    *,
    port: int = DEFAULT_PORT,
    host: str = LOOPBACK,
    browser: bool = True,
    record: Path | None = None,
    headless: bool = False,
    seconds: float | None = None,
    script: Path | None = None,
    units: str | None = None,
    scale: float = 1.0,
    part: Sequence[str] | None = None,
    spacing: float | None = None,
    law: str | None = None,
    given: Sequence[str] = (),
    fixed: Sequence[str] = (),
    refine: bool = False,
    compare: bool = False,
    scene: str | None = None,
    as_json: bool = False,
) -> int:
    """Show a body in real time on a page until interrupted, or drive it by a script without a page.

    Parameters
    ----------
    what : str
        A surface file or a scene file, whose full body is shown; or as of `palpate.app.models.loader.open_model`.
    port : int
        The next free one is used if it is busy.
    host : str
        Address of this machine; addresses other than 127.0.0.1 admit other machines.
    browser : bool
        Whether to open a browser.
    record : path, optional
        File for a recording of the whole session, written when it ends, also by SIGTERM or SIGHUP.
    headless : bool
        Serve nothing: run a script for a duration, and print the deadline statistics.
    seconds : float, optional [s]
        Duration of a headless session, 10 by default.
    script : path, optional
        Script of a headless session; see `palpate.app.session.script.read_script`.
    units, scale, part, spacing, law, given, fixed
        Of a body from a surface file, see `palpate.scenes.surface_scene.surface_scene`; `spacing` and `given` also of
        a scene file.
    refine : bool
        Train a reduced model behind the full body of a surface file or a scene file, and change over to it
        (`palpate.app.view.refinement`).
    compare : bool
        Also step the full model of the reduced model's training scene, under the same tool.
    scene : str, optional
        With `compare`: the user's own scene, ``"module:function"``, which the model must name.
    as_json : bool
        Print the summary of a headless session as JSON.

    Returns
    -------
    int
        0; 1 if a recording, or its file for ParaView, was not written.
    """
    run = _headless_script(headless, seconds, script)
    port = integer_in_range("port", port, 1, 65535)
    if run is None:
        require("websockets", "a page in the browser")
        open_listener(host, port).close()  # refuses a wrong address before a model is trained
    if record is not None:
        _check_record(record, what)
    options: dict[str, Any] = {
        "units": units, "scale": scale, "part": tuple(part or ()), "spacing": spacing, "law": law,
        "settings": parse_settings(given), "fixed": tuple(fixed),
    }  # fmt: skip
    if compare and (is_surface_file(what) or is_scene_file(what)):
        raise InputError(f"compare must be left out for a full body, got {what!r:.60}; give a reduced model")
    if refine and (headless or not (is_surface_file(what) or is_scene_file(what))):
        reason = "--headless" if headless else f"{what!r:.60}"
        raise InputError(f"refine must be left out unless a page shows a surface file or a scene file, got {reason}")
    if scene is not None and not compare:
        raise InputError(f"scene must be left out without --compare, got {scene!r:.60}; add --compare")
    subject = _read_subject(what, options, compare, scene)
    with _exit_on_signals():
        if run is None:
            return FAILED if _show(subject, record, (port, host, browser), refine) else DONE
        from palpate.app.session.script import run_script

        with _session(subject, record, Console()) as session:
            summary = run_script(session, *run)
    print_json(summary) if as_json else print_plain([_table(session.title, summary)], Path("."), ())
    return FAILED if session.failures else DONE


@dataclass(frozen=True)
class _Subject:
    """Subject of a view before the page opens: a full body, a model from a file, or a scene's name."""

    what: str
    title: str
    touched: OrganScene | None = None
    model: ReducedModel | None = None
    compare: bool = False
    scene: str | None = None

    @property
    def durations_name(self) -> str:
        """Name under which the durations of its preparation are kept."""
        if self.model is not None:
            return f"{Path(self.what).resolve()}{' compared' if self.compare else ''}"
        if self.touched is None:
            return self.what
        about = self.touched.description
        return f"surface {about.tissue.law} {about.body.spacing or ''}".rstrip()

    @property
    def surface(self) -> Surface | None:
        """Surface that the page shows at first."""
        if self.touched is not None:
            return self.touched.surface
        if self.model is None:
            return None
        cloud = self.model.cloud
        has_surface = len(cloud.triangles) and cloud.points.shape[1] == 3
        return Surface(cloud.points, cloud.triangles) if has_surface else None


def _read_subject(what: str, options: dict[str, Any], compare: bool, scene: str | None) -> _Subject:
    """Read a scene, a surface or a model, and check the options of a surface."""
    others = {"units": None, "scale": 1.0, "part": (), "law": None, "fixed": ()}
    if is_surface_file(what):
        touched = surface_scene(what, **options)
        assert touched.surface is not None
        for support in touched.description.support:
            if support.place.side:
                side_mask(touched.surface.vertices, support.place.side)
        return _Subject(what, touched.title, touched)
    strange = [name for name, value in others.items() if options[name] != value]
    if is_scene_file(what):
        if strange:
            raise InputError(f"{strange[0]} must be left out with a scene file, got {what!r:.60}; change the file")
        given = {} if options["spacing"] is None else {"spacing": options["spacing"]}
        touched = open_scene(what, given | options["settings"])
        _ = touched.surface, touched.material
        return _Subject(what, touched.title, touched)
    if strange or options["spacing"] is not None or options["settings"]:
        raise InputError(
            "units, scale, part, spacing, law, set and fixed must be left out unless a surface file is viewed, got "
            f"{what!r:.60}"
        )
    if what in PACKAGE_SCENES:
        return _Subject(what, what.capitalize(), compare=compare, scene=scene)
    from palpate.app.models.loader import open_model

    model, title = open_model(what, Console())
    return _Subject(what, title, None, model, compare, scene)


def _show(subject: _Subject, record: Path | None, address: tuple[int, str, bool], refine: bool) -> list[str]:
    """Show a body on a page until interrupted: first its surface, then the session.

    Returns
    -------
    list of str
        Failures of recordings.
    """
    from palpate.app.view.compile_ahead import compile_ahead
    from palpate.app.view.server.host import serve
    from palpate.app.view.server.preparation import Preparation

    preparation = Preparation(subject.title, subject.durations_name, subject.surface)
    console = Console(preparation.begin)
    patience = TRAINING_STOP_SECONDS if subject.what in PACKAGE_SCENES else STOP_SECONDS
    with serve(preparation, console, *address) as host, contextlib.ExitStack() as stack:
        try:
            with _end_after_interrupt(patience):
                touched = None if preparation.code_is_compiled else subject.touched
                ahead = contextlib.nullcontext() if touched is None else compile_ahead(touched.description.tissue)
                with ahead as wait:
                    session = stack.enter_context(_session(subject, record, console, wait))
                from palpate.app.view.refinement import Refinement

                preparation.end()
        except Exception as error:
            host.fail(str(error) if isinstance(error, InputError) else "palpate ended; its terminal says why")
            raise
        finally:
            preparation.close()
        refinement = None
        if subject.touched is not None:
            refinement = stack.enter_context(contextlib.closing(Refinement(subject.touched, session, console)))
            if refine:
                refinement.handle("start")
        host.show(session, refinement)
        try:
            host.wait()
        except KeyboardInterrupt:
            pass
        finally:
            host.stop()  # before the session ends
    return session.failures


@contextlib.contextmanager
def _session(
    subject: _Subject, record: Path | None, console: Console, wait: Callable[[], object] | None = None
) -> Iterator[Session]:
    """Yield a running session; stop it at the end, and write its recordings.

    The engine is prepared after `wait`, if there is one.
    """
    console.begin_phase("importing")
    from palpate.app.models.learned_spacings import learned_spacing
    from palpate.app.models.loader import open_model
    from palpate.app.models.touch import is_guessed, open_touched

    model: Any
    foundations: tuple[Foundation, ...] = ()
    guessed = False
    if subject.model is not None:
        model = subject.model
    elif subject.touched is not None:
        learned = None
        with contextlib.suppress(OSError, InputError):  # of a missing file, which the body then names
            learned = learned_spacing(subject.touched.digest)
        touched = open_touched(subject.touched, console, learned)
        model, foundations, guessed = touched.body, touched.foundations, is_guessed(subject.touched, touched)
    else:
        model, _ = open_model(subject.what, console)
    with console.status("preparing the engine (the first run on a machine compiles it, in about a minute)"):
        if wait is not None:
            wait()
        session = _open_session(model, subject, foundations)
    session.start()
    try:
        if guessed:
            session = _in_real_time(session, touched, subject, console)
        if is_scene_file(subject.what):
            session.folder = recordings_folder(Path(subject.what))
        if record is not None:
            session.start_recording(record)
        yield session
    finally:
        session.close()
        with contextlib.suppress(OSError):  # the terminal was closed
            _print_notifications(session, console)


def _in_real_time(session: Session, touched: OrganScene, subject: _Subject, console: Console) -> Session:
    """Return the running session, or one of the same surface filled again, whose body keeps real time."""
    from palpate.app.models.learned_spacings import keep_spacing
    from palpate.app.models.touch import better_spacing, open_touched

    scene = subject.touched
    assert scene is not None
    for _ in range(MAX_REFILLS):
        spacing = better_spacing(touched, session.load(LOAD_SECONDS))
        if spacing is None:
            break
        session.close()
        console.say("the body is filled again, since its steps take another time than expected")
        before, touched = touched.body.cloud.spacing, open_touched(scene, console, spacing)
        session = _open_session(touched.body, subject, touched.foundations)
        session.start()
        if touched.body.cloud.spacing == before:  # thin tissue has no coarser one
            break
    keep_spacing(scene.digest, touched.body.cloud.spacing)
    return session


def _open_session(model: Any, subject: _Subject, foundations: tuple[Foundation, ...]) -> Session:
    """Return a session of a body, or of a reduced model and its full body."""
    from palpate.app.session.comparison import Comparison
    from palpate.app.session.full_model_replay import full_model
    from palpate.app.session.session import Session
    from palpate.reduction.hyper.model import ReducedModel

    if subject.compare and isinstance(model, ReducedModel):
        return Comparison(model, full_model(model, subject.scene), subject.title)
    return Session(model, subject.title, foundations=foundations)


@contextlib.contextmanager
def _end_after_interrupt(patience: float) -> Iterator[None]:
    """End the program a time [s] after Ctrl-C at the latest: a compiler does not return for seconds."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield
        return
    watched, notified = socket.socketpair()
    notified.setblocking(False)
    left = threading.Event()

    def watch() -> None:
        with watched:
            while signals := watched.recv(16):
                if signal.SIGINT in signals and not left.wait(patience):
                    with contextlib.suppress(OSError):
                        os.write(2, b"palpate: interrupted\n")
                    os._exit(INTERRUPTED)

    threading.Thread(target=watch, name="palpate interrupt", daemon=True).start()
    before = signal.set_wakeup_fd(notified.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        left.set()
        signal.set_wakeup_fd(before)
        notified.close()


@contextlib.contextmanager
def _exit_on_signals() -> Iterator[None]:
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


def _check_record(path: Path, what: str) -> None:
    """Raise InputError if a recording, or its file for ParaView, would replace another file."""
    check_folder(path.parent, "record")
    if path.suffix != ".h5":
        raise InputError(f"record must end in .h5, got {str(path)!r}; its file for ParaView ends in .vtkhdf")
    from palpate.app.recordings.recording_journal import is_recording

    recorded = is_recording(path)
    for each in (path, path.with_suffix(".vtkhdf")):
        if each.exists() and Path(what).exists() and os.path.samefile(each, what):
            raise InputError(f"record must be another file than the model, got {str(path)!r}; choose another name")
        if each.exists() and not recorded:
            raise InputError(
                f"record must be a new file or an earlier recording, got {str(path)!r}, but {each.name} is another "
                "file; choose another name"
            )


def _headless_script(
    headless: bool, seconds: float | None, script: Path | None
) -> tuple[list[tuple[float, Message]], float] | None:
    """Return the script and the duration [s] of a headless session, or None for a session with a page."""
    if not headless:
        if seconds is not None or script is not None:
            raise InputError("seconds and script must be left out without --headless, got one of them; add --headless")
        return None
    seconds = number_in_range(
        "seconds", 10.0 if seconds is None else seconds, 0.0, MAX_HEADLESS_SECONDS, open_low=True, unit="s"
    )
    from palpate.app.session.script import read_script

    return read_script(script) if script is not None else [], seconds


def _print_notifications(session: Session, console: Console) -> None:
    for message in session.notifications:
        failed = message["type"] == "error"
        console.say(message["reason"] if failed else f"recorded {message['frames']} snapshots in {message['file']}")


def _table(title: str, summary: dict[str, Any]) -> Any:
    rows = {
        "periods": f"{summary['periods']}",
        "computing time of a period, median; 99 %": f"{summary['median_ms']:.3g} ms; {summary['p99_ms']:.3g} ms",
        "deadlines missed": f"{summary['misses']}",
        "largest force; last": f"{summary['largest_force']:.3g} N; {summary['last_force']:.3g} N",
        "largest trust number (above 1: not trained on)": f"{summary['largest_trust']:.2f}",
        "messages; refused": f"{summary['messages']}; {len(summary['refused'])}",
        "verdict": summary["verdict"],
    }
    return quantities_table(f"{title}, {summary['seconds']:g} s", ["value"], {name: [v] for name, v in rows.items()})
