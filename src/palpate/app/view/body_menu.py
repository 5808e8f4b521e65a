"""Menu of a page: the law of the tissue, and what is shown with the body: a reduced model, or a body of another law."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

from palpate.app.common.compile_ahead import compile_ahead
from palpate.app.common.console import Console
from palpate.app.models.trained import compared_file, compared_modes
from palpate.app.session.comparison import Comparison
from palpate.app.session.messages import Message
from palpate.app.session.session import Session, latest
from palpate.app.view.compile_engine import compile_engine
from palpate.app.view.refinement import Trainer
from palpate.app.view.server.preparation import Preparation
from palpate.app.view.training_process import TrainingProcess
from palpate.core.faults import InputError
from palpate.core.parameters import written_section
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.scene import Scene
from palpate.scenes.tissue import material_of, of_law, offered_laws, parameters_text

JOIN_SECONDS = 2.0  # [s] in which a body that is being made may end
NO_MODES = 0  # of the full body alone
BODY_PREPARING, BODY_READY, BODY_FAILED = "preparing", "ready", "failed"


def make_trainer(scene: Scene) -> Trainer:
    """Start the training of the reduced models of a scene that are compared with its full body."""
    return TrainingProcess(scene, compared=True)


def offers_modes(scene: Scene, session: Session) -> bool:
    """Return True if reduced models are compared with the body of a scene, whose end forceps pull in a session.

    Not with that of a surface: the page fills it with the nodes of real time, a training with those of the scene.
    """
    return bool(session.end) and scene.surface is None


def has_menu(scene: Scene) -> bool:
    """Return True if the body of a scene may have another law: a solid of one tissue, at rest as its surface is."""
    about = scene.description
    regions = any(region.parameters for region in about.region)
    return about.body.thickness is None and bool(offered_laws(about.tissue)) and not (regions or about.body.under_loads)


class Choice(NamedTuple):
    """A choice of the menu."""

    law: str
    modes: int = NO_MODES  # of a reduced model next to the full body
    second: str = ""  # law of a second body


class BodyMenu:
    """Makes bodies of a scene by the choices of the driver, behind the session that is shown.

    `session` is that of the scene's full body; `train` starts the training of reduced models of a scene.
    """

    def __init__(
        self, scene: Scene, session: Session, console: Console, train: Callable[[Scene], Trainer] = make_trainer
    ) -> None:
        self._scene, self._console, self._train = scene, console, train
        self._cloud, self._end, self._shown = session.model.cloud, session.end, session
        self._chosen = Choice(scene.description.tissue.law)
        self._state, self._note = BODY_READY, ""
        self._progress: Callable[[], dict[str, Any]] = dict
        self._lock, self._closed = threading.Lock(), False
        self._next: tuple[Session, Choice] | None = None  # made, and not yet shown
        self._thread: threading.Thread | None = None
        self._trainer: Trainer | None = None
        self._laws = [self._describe(name) for name in offered_laws(scene.description.tissue)]
        self._modes_offered = [NO_MODES, *compared_modes(scene)] if offers_modes(scene, session) else []
        self._trained = self._is_trained(self._chosen.law)

    def _describe(self, name: str) -> dict[str, str]:
        """Return the name of a law, and its parameters and moduli for people."""
        tissue = of_law(self._scene.description.tissue, name)
        kilopascals = 1e-3 * material_of(tissue).shear_modulus
        moduli = f"shear modulus {kilopascals:.3g} kPa and Poisson's ratio {tissue.poisson:.3g}"
        here = name == self._scene.description.tissue.law
        return {"name": name, "text": f"{parameters_text(tissue)}. At rest {moduli}{'' if here else ', as before'}."}

    def _scene_of(self, law: str) -> Scene:
        """Return the scene with another law, whose body has the nodes of that which is shown."""
        tissue = of_law(self._scene.description.tissue, law)
        return self._scene.with_tissue(self._cloud, law=tissue.law, parameters=tissue.parameters)

    def _is_trained(self, law: str) -> bool:
        """Return True if the reduced models of a law are kept, or none are offered."""
        if len(self._modes_offered) < 2:
            return True
        scene = self._scene_of(law)
        try:
            return all(compared_file(scene, modes).is_file() for modes in self._modes_offered[1:])
        except InputError:  # a user without a home folder keeps no models
            return False

    def message(self) -> dict[str, Any]:
        """Return the message ``bodies`` of the protocol."""
        with self._lock:
            progress = {"phase": None, "fraction": None, "seconds_left": None, **self._progress()}
            return {
                "type": "bodies", "laws": self._laws, "law": self._chosen.law, "second": self._chosen.second,
                "modes": self._modes_offered, "shown_modes": self._chosen.modes, "trained": self._trained,
                "state": self._state, **progress, "note": self._note,
            }  # fmt: skip

    def handle(self, message: Message) -> None:
        """Begin to make the body of a message ``body``, with a law, and a number of modes or a second law."""
        choice = Choice(*(message[name] for name in Choice._fields))
        modes, names = choice.modes, [each["name"] for each in self._laws]
        for name in ("law", "second") if choice.second else ("law",):
            if (given := message[name]) not in names:
                raise InputError(f"body: {name} must be one of {', '.join(names)}, got {given!r}; choose one of these")
        if choice.second == choice.law:
            raise InputError(f"body: second must be another law than law, got {choice.law!r} twice; leave second out")
        if modes and choice.second:
            raise InputError(f"body: second must be empty with modes, got {choice.second!r}; compare one at a time")
        if modes not in (NO_MODES, *self._modes_offered):
            allowed = ", ".join(map(str, self._modes_offered or (NO_MODES,)))
            raise InputError(f"body: modes must be one of {allowed} for this body, got {modes}; choose one of these")
        with self._lock:
            if self._state == BODY_PREPARING:
                raise InputError("body must wait for the one that is being prepared, got another; send it again later")
            self._state, self._note = BODY_PREPARING, ""
            self._thread = threading.Thread(target=self._make, args=(choice,), name="palpate body", daemon=True)
            self._thread.start()

    def compare(self, modes: int) -> None:
        """Begin to make a reduced model with a number of modes, next to the full body."""
        self.handle({"law": self._chosen.law, "modes": modes, "second": ""})

    def _make(self, choice: Choice) -> None:
        try:
            session = self._session(choice)
        except Exception as error:  # of the law or the training; the body that is shown stays
            self._fail(choice, error)
            return
        with self._lock:
            self._next, self._progress = (session, choice), dict

    def _fail(self, choice: Choice, error: Exception) -> None:
        reason = str(error) if isinstance(error, InputError | OSError) else f"{type(error).__name__}: {error}"
        with self._lock:
            self._state, self._note, self._progress = BODY_FAILED, reason, dict
        self._console.say(f"no body of the law {choice.law} was made: {reason}")

    def _check_open(self) -> None:
        if self._closed:
            raise InputError("the page has ended")

    def _session(self, choice: Choice) -> Session:
        """Return the session of a body, with a reduced model or a body of another law if these are chosen."""
        body, foundations = self._body(choice.law)
        title, end = self._scene.title, self._end
        session: Session
        if choice.modes:
            reduced = self._reduced(self._scene_of(choice.law), choice.modes)
            session = Comparison(reduced, body, title, foundations=foundations)
        elif choice.second:
            session = Comparison(body, self._body(choice.second)[0], title, end=end, foundations=foundations)
        else:
            session = Session(body, title, foundations=foundations, end=end)
        session.subtitle, session.notes = self._shown.subtitle, self._shown.notes
        return session

    def _body(self, law: str) -> tuple[Any, Any]:
        """Return the full body of a law and its springs; its engine is compiled."""
        scene = self._scene_of(law)
        preparation = Preparation(scene.title, f"law {law}")
        try:
            if not preparation.code_is_compiled and law != self._scene.description.tissue.law:
                self._begin(preparation, "compiling, once for this computer")
                with compile_ahead(compile_engine, written_section(scene.description.tissue)) as wait:
                    wait()
            self._begin(preparation, "making the body")
            made = scene.body, scene.foundations
            preparation.end()
        finally:
            preparation.close()
        return made

    def _begin(self, preparation: Preparation, phase: str) -> None:
        """Begin a phase of a preparation, whose progress is that of this menu."""
        preparation.begin(phase)
        with self._lock:
            self._check_open()
            self._progress = lambda: {
                name: value if name != "seconds_left" or value is None else round(value)
                for name, value in preparation.message().items()
                if name in ("phase", "fraction", "seconds_left")
            }

    def _reduced(self, scene: Scene, modes: int) -> ReducedModel:
        """Return the reduced model of a scene with a number of modes, trained where it is missing."""
        file = compared_file(scene, modes)
        if not file.is_file():
            with self._lock:
                self._check_open()
                trainer = self._trainer = self._train(scene)
            self._console.say(f"reduced models are trained in the background, and kept in {file.parent}")
            for event in trainer.events():
                if "failed" in event:
                    raise InputError(event["failed"])
                self._follow(event)
        return load(Path(file))

    def _follow(self, event: dict[str, Any]) -> None:
        """Show the phase of a training, and the time that is left."""
        began, left = monotonic(), event.get("left")

        def progress() -> dict[str, Any]:
            rest = None if left is None else max(round(left - (monotonic() - began)), 1)
            return {"phase": event.get("phase", "training"), "seconds_left": rest}

        with self._lock:
            self._progress = progress

    def next_source(self) -> Session | None:
        """Return the running session of the body that was made, once."""
        with self._lock:
            made, self._next = self._next, None
        if made is None:
            return None
        (session, choice), former = made, latest(self._shown)
        state, reason, recorded = former.engine.state, former.pause_reason, former.recordings.is_active
        try:
            session.continue_from(former)
        except Exception as error:  # the body that is shown goes on
            session.stop()
            former.devices, former.successor = former.devices | session.devices, None
            with contextlib.suppress(InputError):  # a diverged state waits for a reset
                former.start()
            if state != "running":
                former.pause(reason)
            self._fail(choice, error)
            return None
        with self._lock:
            self._shown, self._chosen, self._state = session, choice, BODY_READY
            self._note = "The recording ended with the former body." if recorded else ""
            self._trained = self._is_trained(choice.law)
        return session

    def close(self) -> None:
        """End the making of a body, the session of the last one, and one that was made and not shown."""
        with self._lock:
            self._closed, trainer = True, self._trainer
        if trainer is not None:
            trainer.stop()
        if self._thread is not None:
            self._thread.join(JOIN_SECONDS)
        if self._next is not None:
            self._next[0].close()
        self._shown.close()
