"""Command ``palpate view``: shows a body in real time on a page."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from palpate.app.common.arguments import option_names, parse_settings
from palpate.app.common.console import Console
from palpate.app.common.exit_status import DONE, FAILED, INTERRUPTED
from palpate.app.device.options import DeviceOptions, take_device
from palpate.app.models.input import Input, open_input
from palpate.app.session.opening import MakeSession, check_record, exit_on_signals, running_session
from palpate.app.view.server.address import DEFAULT_PORT, LOOPBACK, PORT_ATTEMPTS, open_listener, public_address
from palpate.core.extras import require
from palpate.core.faults import InputError, integer_in_range
from palpate.scenes.names import SceneKind
from palpate.surface.labels.reading import is_label_map
from palpate.surface.surface import Surface

if TYPE_CHECKING:  # it takes a second to import, before the page opens
    from palpate.app.session.session import Session
    from palpate.app.view.server.host import Host
    from palpate.app.view.server.preparation import Preparation
    from palpate.dynamics.loads.foundation import Foundation

    Place: TypeAlias = Host | tuple[int, str, bool, str | None]  # of a page: its host, or the arguments of `serve`

STOP_SECONDS, TRAINING_STOP_SECONDS = 1.0, 10.0  # [s] after an interrupt; workers of a training are stopped in order


def view(
    source: str,
    *,
    port: int = DEFAULT_PORT,
    host: str = LOOPBACK,
    public_url: str | None = None,
    browser: bool = True,
    record: Path | None = None,
    spacing: float | None = None,
    given: Sequence[str] = (),
    refine: bool = False,
    reduced: bool = False,
    compare: bool = False,
    scene: str | None = None,
    yes: bool = False,
    **shape: Any,
) -> int:
    """Show a body in real time on a page until interrupted.

    The full solid of a scene or a surface is shown, and a reduced model that is kept for it takes over; with
    `refine` one is trained in the background, and with `reduced` before anything is shown. `record` is the file of
    a recording of the whole session, written when it ends, also by SIGTERM or SIGHUP. With `compare` the full model
    of the reduced model's training scene is stepped, too; `scene`, ``"module:function"``, is the user's own, which
    the model must name. With `yes` nobody is asked before a training of minutes. `shape` has the options of a
    surface file, and those of a device (`palpate.app.device.options`).

    Returns 0; 1 if a recording, or its file for ParaView, was not written.
    """
    port, device = integer_in_range("port", port, 1, 65535), take_device(shape)
    require("websockets", "a page in the browser")
    if public_url is not None:
        public_address(public_url)
    open_listener(
        host, port, PORT_ATTEMPTS if public_url is None else 1
    ).close()  # refuses a wrong address before a model is trained
    if record is not None:
        check_record(record, source)
    if scene is not None and not compare:
        raise InputError(f"scene must be left out without --compare, got {scene!r:.60}; add --compare")
    settings, address = parse_settings(given), (port, host, browser, public_url)

    def read(parts: Sequence[str], without: Sequence[str] = ()) -> Input:
        left_out = [*(shape.get("without") or ()), *without]
        return open_input(source, settings, spacing, reduced, **shape | {"part": list(parts), "without": left_out})

    def show(opened: Input, place: Place) -> int:
        full = opened.scene is not None and not (reduced or compare)
        if compare and opened.scene is not None and opened.scene.kind is not SceneKind.PACKAGE:
            raise InputError(f"compare must be left out for a full body, got {source!r:.60}; give a reduced model")
        if refine and not full:
            raise InputError(f"refine must be left out unless a page shows a full body, got {source!r:.60}")
        if refine and _is_sheet(opened):
            raise InputError(
                f"refine must be left out for a sheet, whose model no tool touches, got {source!r:.60}; use reduced"
            )
        if full:
            opened = damped(opened)
        else:
            _confirm_training(opened, yes or not isinstance(place, tuple))  # the page of a choice is open already
        end = end_of(opened) if full else ""
        make = partial(_make_session, title=opened.title, compare=compare, scene=scene, end=end)
        name = _durations_name(opened, full, compare)
        return FAILED if _show(Shown(opened, full, make), name, record, place, refine, device) else DONE

    with exit_on_signals():
        if is_label_map(source) and not shape.get("part"):
            from palpate.app.view.choose_labels import choose_on_page

            with choose_on_page(source, shape.get("labels"), read, address) as (place, chosen):
                return show(chosen, place)
        return show(read(shape.get("part") or ()), address)


class Shown(NamedTuple):
    """What a page shows: an input, whether as a full body, and the function that makes its session."""

    opened: Input
    full: bool
    make: MakeSession


def _is_sheet(opened: Input) -> bool:
    return opened.scene is not None and opened.scene.description.body.thickness is not None


def end_of(opened: Input) -> str:
    """Return the group that forceps pull on the page: that of a solid which the tool of its scene holds, or none."""
    return "" if opened.scene is None or _is_sheet(opened) else opened.scene.held_group


def damped(opened: Input) -> Input:
    """Return an input whose pulled body has the usual damping, in place of none: it would swing for minutes."""
    scene = opened.scene
    if scene is None or not end_of(opened) or scene.description.tissue.mass_damping:
        return opened
    if any(key.rpartition(".")[2] == "mass_damping" for key in scene.settings):
        return opened
    from palpate.tissue.liver import MASS_DAMPING

    other = scene.with_tissue(mass_damping=MASS_DAMPING)
    other.notes += [
        *scene.notes,
        f"damping: {MASS_DAMPING:g} 1/s on this page, so that the body comes to rest; runs of the scene have none",
    ]
    return replace(opened, scene=other)


def _confirm_training(opened: Input, yes: bool) -> None:
    """State what a training does where it is needed, and ask before a long one."""
    console = Console()
    training = opened.training_needed(console)
    if training is not None:
        from palpate.app.train.estimate import confirm

        confirm(console, training, "Train?", yes)


def _make_session(
    body: Any, foundations: tuple[Foundation, ...], *, title: str, compare: bool, scene: str | None, end: str = ""
) -> Session:
    """Return a session of a body, or of a reduced model and its full body."""
    from palpate.app.session.comparison import Comparison
    from palpate.app.session.full_model_replay import full_model
    from palpate.app.session.session import Session

    if compare:
        return Comparison(body, full_model(body, scene), title, foundations=foundations)
    return Session(body, title, foundations=foundations, end=end)


def _durations_name(opened: Input, full: bool, compare: bool) -> str:
    """Return the name under which the durations of a preparation are kept."""
    if opened.scene is None:
        return f"{Path(opened.name).resolve()}{' compared' if compare else ''}"
    about = opened.scene.description
    return f"surface {about.tissue.law} {about.body.spacing or ''}".rstrip() if full else opened.name


def _first_surface(opened: Input, full: bool) -> Surface | None:
    """Return the surface that a page shows at first: that of a file, or of the nodes of a small body or a model."""
    if opened.scene is not None:
        if not full or opened.scene.surface is not None:
            return opened.scene.surface if full else None
        cloud = opened.scene.cloud
    else:
        assert opened.model is not None
        cloud = opened.model.cloud
    has_surface = len(cloud.triangles) and cloud.points.shape[1] == 3
    return Surface(cloud.points, cloud.triangles) if has_surface else None


def first_page(opened: Input, full: bool, durations_name: str) -> Preparation:
    """Return what a page shows while the body is prepared: its surface, and notes about it."""
    from palpate.app.view.server.preparation import Preparation

    surface, subtitle, notes = _first_surface(opened, full), "", list[str]()
    if full and opened.scene is not None:
        subtitle, notes = opened.scene.subtitle, [*opened.scene.notes]
        notes += [f"surface: {each}" for each in (surface.warnings if surface else ())]
    notes = [option_names(note) for note in notes]
    return Preparation(opened.title, durations_name, surface, subtitle=subtitle, notes=notes)


def _show(
    shown: Shown,
    durations_name: str,
    record: Path | None,
    place: Place,
    refine: bool,
    device: DeviceOptions | None,
) -> list[str]:
    """Show a body on a page until interrupted, first its surface; return failures of recordings."""
    from palpate.app.view.server.host import Host, serve

    preparation = first_page(shown.opened, shown.full, durations_name)
    console = Console(preparation.begin)
    serving = contextlib.nullcontext(place) if isinstance(place, Host) else serve(preparation, console, *place)
    with serving as host:
        if isinstance(place, Host):
            host.prepare(preparation)
        return run_page(shown, preparation, console, host, record=record, refine=refine, device=device)


def run_page(
    shown: Shown,
    preparation: Preparation,
    console: Console,
    host: Host,
    *,
    record: Path | None = None,
    refine: bool = False,
    device: DeviceOptions | None = None,
) -> list[str]:
    """Prepare what the page of a host shows, and show it until the host stops; return failures of recordings."""
    from palpate.app.view.surroundings import show_surroundings

    opened, full, make = shown
    scene = opened.scene if full else None
    patience = TRAINING_STOP_SECONDS if scene is None and opened.model is None else STOP_SECONDS
    with contextlib.ExitStack() as stack:
        if scene is not None:
            show_surroundings(host, scene)
        with preparing(host, preparation, patience):
            wait = None
            if scene is not None and not preparation.code_is_compiled:
                from palpate.app.common.compile_ahead import compile_ahead
                from palpate.app.view.compile_engine import compile_engine
                from palpate.core.parameters import written_section

                tissue = written_section(scene.description.tissue)
                wait = stack.enter_context(compile_ahead(compile_engine, tissue))
            session = stack.enter_context(running_session(opened, full, make, console, record, wait))
            from palpate.app.device.driver import driving
            from palpate.app.view.body_menu import BodyMenu, has_menu, offers_modes
            from palpate.app.view.refinement import Refinement, is_trained

            preparation.end()
        makers: dict[str, Any] = {}
        if scene is not None and has_menu(scene):
            menu = makers["body"] = stack.enter_context(contextlib.closing(BodyMenu(scene, session, console)))
            if refine and offers_modes(scene, session):
                menu.compare(scene.description.training.modes)
        if scene is not None and not (_is_sheet(opened) or (makers and offers_modes(scene, session))):
            makers["refine"] = stack.enter_context(contextlib.closing(Refinement(scene, session, console)))
            if refine or is_trained(scene):
                makers["refine"].handle({"action": "start"})
        stack.enter_context(driving(session, device, console.say))
        host.show(session, makers)
        try:
            host.wait()
        except KeyboardInterrupt:
            pass
        finally:
            host.stop()  # before the session ends
    return session.recordings.failures


@contextlib.contextmanager
def preparing(host: Host, preparation: Preparation, patience: float = STOP_SECONDS) -> Iterator[None]:
    """End a preparation, and show the page why it failed; Ctrl-C ends the program within a time [s]."""
    try:
        with _end_after_interrupt(patience):
            yield
    except Exception as error:
        host.fail(str(error) if isinstance(error, InputError) else "palpate ended; its terminal says why")
        raise
    finally:
        preparation.close()


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
