"""Refinement of a session: a reduced model is trained next to a full body, and takes its place when it is ready."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic
from typing import Any, Protocol

from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console, percent
from palpate.app.models.trained import model_file, training_folder
from palpate.app.session.comparison import Comparison
from palpate.app.session.messages import Message
from palpate.app.session.session import Session, latest
from palpate.app.view.training_process import TrainingProcess
from palpate.core.faults import InputError
from palpate.reduction.storage.models import load
from palpate.scenes.open_surface import complete_for_training
from palpate.scenes.scene import Scene

MAX_FORCE_ERROR, MAX_SURFACE_ERROR = 0.1, 0.1  # mean on held-out runs, up to which a model is used without a question
OFFERED, TRAINING, READY, USED, FAILED = "offered", "training", "ready", "used", "failed"
JOIN_SECONDS = 2.0  # [s] in which a model that is being loaded may end


def is_trained(scene: Scene) -> bool:
    """Return True if a reduced model is kept for a scene that takes over from its full body: one that tools touch."""
    tool = scene.description.tool
    if tool.holds or tool.hold_radius:
        return False
    try:
        return model_file(complete_for_training(scene)).is_file()
    except InputError:  # a user without a home folder keeps no models
        return False


class Trainer(Protocol):
    """A training in the background; see `palpate.app.view.training_process.TrainingProcess`."""

    def events(self) -> Iterator[dict[str, Any]]:
        """Yield its reports until it ends."""

    def stop(self) -> None:
        """End it."""


class Refinement:
    """Trains the reduced model of a scene behind the session of its full body, and makes the session of that model.

    `train` starts a training of a scene.
    """

    def __init__(
        self, scene: Scene, session: Session, console: Console,
        train: Callable[[Scene], Trainer] = TrainingProcess,
    ) -> None:  # fmt: skip
        self._scene, self._session, self._console, self._train = scene, session, console, train
        self._lock = threading.Lock()
        self._state, self._note, self._accepted = OFFERED, "", False
        self._phase: dict[str, Any] = {}
        self._began = self._phase_began = monotonic()
        self._errors: dict[str, float] = {}
        self._trainer: Trainer | None = None
        self._thread: threading.Thread | None = None
        self._next: Session | None = None

    @property
    def _is_offered(self) -> bool:
        """Whether the body that is shown is that of the scene, or of its model: not one of another law, nor two."""
        shown, tissue = self._shown, self._session.model.material
        return shown is self._next or (not isinstance(shown, Comparison) and shown.model.material == tissue)

    @property
    def _present_state(self) -> str:
        """The state, used while the model is shown: one that another body has replaced is ready again."""
        return USED if self._next is self._shown else self._state

    @property
    def _shown(self) -> Session:
        return latest(self._session)

    def message(self) -> dict[str, Any] | None:
        """Return the message ``refinement`` of the protocol; None while another body or two are shown."""
        with self._lock:
            if not self._is_offered:
                return None
            left, now = self._phase.get("left"), monotonic()
            share = None
            if left is not None:
                left -= now - self._phase_began
                share = (now - self._began) / (now - self._began + left) if left > 0 else None
            return {
                "type": "refinement", "state": self._present_state, "phase": self._phase.get("phase"),
                "fraction": None if share is None else round(share, 3),
                "seconds_left": None if left is None or share is None else round(left),
                "errors": self._errors or None, "good": self._is_good, "note": self._note,
            }  # fmt: skip

    @property
    def _is_good(self) -> bool:
        errors = self._errors
        surface = errors.get("surface", errors.get("displacement", 1.0))
        return errors.get("force", 1.0) <= MAX_FORCE_ERROR and surface <= MAX_SURFACE_ERROR

    def handle(self, message: Message) -> None:
        """Execute an action: ``start`` or ``stop`` the training, or ``use`` a model that is ready."""
        action = message["action"]
        allowed = {"start": (OFFERED, FAILED), "stop": (TRAINING,), "use": (READY,)}[action]
        with self._lock:
            if (state := self._present_state) not in allowed:
                raise InputError(f"refine must be an action of the state {state!r}, got {action!r}; wait for it")
            if action == "use":
                self._accepted = True
            elif action == "start":
                self._start()
            else:
                self._state, self._phase = OFFERED, {}
                self._note = "Stopped. What was computed is kept, and used when it is started again."
                trainer, self._trainer = self._trainer, None
        if action == "stop" and trainer is not None:
            trainer.stop()

    def _start(self) -> None:
        self._state, self._note, self._phase = TRAINING, "", {"phase": "starting"}
        self._began = self._phase_began = monotonic()
        self._thread = threading.Thread(target=self._follow, args=(self._thread,), name="palpate refine", daemon=True)
        self._thread.start()

    def _follow(self, before: threading.Thread | None) -> None:
        """Follow a training to its end, and load its model; an earlier one has to end first."""
        if before is not None:
            before.join()
        try:
            scene = complete_for_training(self._scene)
            with self._lock:
                if not self._is_followed:
                    return
                trainer = self._trainer = self._train(scene)
            self._console.say(f"a reduced model is trained in the background, and kept in {training_folder(scene)}")
            for event in trainer.events():
                self._take(event)
        except Exception as error:  # of the scene or of a damaged model; the full body stays
            self._fail(str(error) if isinstance(error, InputError | OSError) else f"{type(error).__name__}: {error}")

    @property
    def _is_followed(self) -> bool:
        """Whether the followed training is not stopped."""
        return self._state == TRAINING and self._thread is threading.current_thread()

    def _take(self, event: dict[str, Any]) -> None:
        if "trained" in event:
            self._load(event)
        elif "failed" in event:
            self._fail(event["failed"])
        else:
            for line in event.get("estimate", ()):
                self._console.say(line)
            with self._lock:
                if self._is_followed:
                    self._phase, self._phase_began = event, monotonic()

    def _load(self, event: dict[str, Any]) -> None:
        """Make the session of a trained model."""
        model = load(Path(event["trained"]))
        session = self._session_of(model)
        with self._lock:
            if not self._is_followed:
                return
            self._state, self._phase, self._errors, self._next = READY, {}, event["errors"], session
        errors = ", ".join(f"{name} {percent(error)}" for name, error in event["errors"].items())
        self._console.say(f"a reduced model is ready; mean errors on paths not trained on: {errors or 'not measured'}")

    def _session_of(self, model: Any) -> Session:
        session = Session(model, self._session.title, foundations=self._scene.foundations)
        session.subtitle = self._session.subtitle
        session.notes = tuple(option_names(note) for note in self._scene.notes)
        return session

    def _fail(self, reason: str) -> None:
        with self._lock:
            if not self._is_followed:
                return
            self._state, self._phase, self._note = FAILED, {}, reason
        self._console.say(f"no reduced model was trained: {reason}; the full body stays")

    def next_source(self) -> Session | None:
        """Return the running session of the model once it is accepted, or good while nobody uses the body."""
        shown = self._shown
        in_use = shown.is_touched or shown.body.cuts
        with self._lock:
            wanted = self._is_offered and (self._accepted or (self._is_good and not in_use))
            if not wanted or self._present_state != READY or self._next is None:
                return None
            if self._next.successor is not None:  # another body has replaced it
                self._next = self._session_of(self._next.model)
            self._note = "The recording ended with the full body." if shown.recordings.is_active else ""
            self._next.continue_from(shown)
            self._accepted = False
            return self._next

    def close(self) -> None:
        """End the training, and the session of the model; its recordings are written."""
        with self._lock:
            trainer = self._trainer
            if self._state == TRAINING:
                self._state = OFFERED
        if trainer is not None:
            trainer.stop()
        if self._thread is not None:
            self._thread.join(JOIN_SECONDS)
        if self._present_state == USED:
            self._shown.close()
