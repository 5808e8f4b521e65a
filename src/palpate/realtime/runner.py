"""The thread that runs an engine's loop."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from palpate.realtime.clock import use_precise_sleep
from palpate.realtime.loop import DIVERGED, PAUSED, RUNNING, STOPPED
from palpate.realtime.seqlock import set_flag


class Runner:
    """Starts and stops a loop in its own thread.

    The loop runs while element 0 of `command` is RUNNING, and returns the reason for its end. `on_divergence` is called
    in the thread when it returns DIVERGED or raises. The `state` is RUNNING, STOPPED, PAUSED or DIVERGED; `error_text`
    is the message of the last exception in the thread, empty if there was none.
    """

    def __init__(
        self, loop: Callable[[], int], command: NDArray[np.int64], on_divergence: Callable[[], None] | None
    ) -> None:
        self._loop, self._command, self._on_divergence = loop, command, on_divergence
        self._thread: threading.Thread | None = None
        self.state, self.error_text = STOPPED, ""
        set_flag(command, 0, STOPPED)
        loop()  # compiles it; returns at once

    def swap_loop(self, loop: Callable[[], int]) -> None:
        """Replace the loop, which must not run."""
        self._loop = loop

    def start(self) -> None:
        """Start the loop."""
        set_flag(self._command, 0, RUNNING)
        self.state = RUNNING
        # a daemon thread: a running engine must not keep Python alive
        self._thread = threading.Thread(target=self._run, name="palpate engine", daemon=True)
        self._thread.start()

    def stop(self, state: int) -> None:
        """Stop the loop, wait for its end, and set the state to STOPPED or PAUSED unless the loop diverged."""
        set_flag(self._command, 0, state)
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        if self.state == PAUSED:
            self.state = state

    def _run(self) -> None:
        state = DIVERGED
        try:
            use_precise_sleep()
            state = self._loop()
        except Exception as error:  # of the model
            self.error_text = f"the model's step raised {error!r}"
        if state == DIVERGED and self._on_divergence is not None:
            try:
                self._on_divergence()
            except Exception as error:
                self.error_text = f"the black box was not written: {error}"
        self.state = state
