"""The thread that an engine's loop runs in."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from palpate.realtime.clock import sharpen_sleep
from palpate.realtime.exchange import set_flag
from palpate.realtime.loop import PAUSED, RAN_AWAY, RUNNING, STOPPED

__all__ = ["Runner"]


class Runner:
    """Runs a loop in a thread of its own, whenever it is told to.

    Parameters
    ----------
    loop : function
        Goes on while the command is RUNNING; returns why it ended.
    command : flags
    on_run_away : function or None
        Called in the thread when the loop returns RAN_AWAY or raises.

    Attributes
    ----------
    state : int
        RUNNING, STOPPED, PAUSED or RAN_AWAY.
    trouble : str
        What went wrong besides, or nothing.
    """

    def __init__(
        self, loop: Callable[[], int], command: NDArray[np.int64], on_run_away: Callable[[], None] | None
    ) -> None:
        self._loop, self._command, self._on_run_away = loop, command, on_run_away
        self._thread: threading.Thread | None = None
        self.state, self.trouble = STOPPED, ""
        set_flag(command, 0, STOPPED)
        loop()  # is compiled, and returns at once

    def go(self) -> None:
        """Start the loop."""
        set_flag(self._command, 0, RUNNING)
        self.state = RUNNING
        # a daemon, as an engine that nobody stops must not keep Python alive
        self._thread = threading.Thread(target=self._run, name="palpate engine", daemon=True)
        self._thread.start()

    def end(self, state: int) -> None:
        """Let the loop return, if it runs, and wait until it has; then be STOPPED or PAUSED, unless it ran away."""
        set_flag(self._command, 0, state)
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        if self.state == PAUSED:
            self.state = state

    def _run(self) -> None:
        state = RAN_AWAY
        try:
            sharpen_sleep()
            state = self._loop()
        except Exception as error:  # raised by the model
            self.trouble = f"the model's step failed: {error!r}"
        if state == RAN_AWAY and self._on_run_away is not None:
            try:
                self._on_run_away()
            except Exception as error:
                self.trouble = f"the black box is lost: {error}"
        self.state = state
