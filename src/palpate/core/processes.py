"""Child processes: a function of palpate in a process of its own, which ends with the one that started it.

Values go both ways as lines of JSON: to the function on the standard input of the child, and back on its standard
output. The standard input stays open as long as the parent lives; when it ends, the child ends in every case. An
interrupt of the terminal is left to the parent, which stops its children.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from queue import SimpleQueue
from typing import Any

Receive = Callable[[], Any]  # waits for the next value of the parent
Answer = Callable[[Any], None]
Function = Callable[[Receive, Answer], None]

SERVE_CODE = "import sys; from palpate.core.processes import serve; serve(*sys.argv[1:])"
LOWEST_PRIORITY = 19


class Child:
    """A process that calls a function of a module with `Receive` and `Answer`.

    It first receives `given`. Modules are imported from the parent's folders, and from the working folder only if that
    is one of them. `environment` has additional variables. An `idle` process has the lowest priority. The messages and
    warnings of a `quiet` one are dropped; otherwise they are those of this process.
    """

    def __init__(
        self,
        function: Function,
        request: Any,
        *,
        environment: Mapping[str, str] | None = None,
        idle: bool = False,
        quiet: bool = True,
    ) -> None:
        words = [function.__module__, function.__name__, str(LOWEST_PRIORITY if idle else 0)]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", SERVE_CODE, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None, env={**os.environ, **(environment or {})}, encoding="utf-8",
            creationflags=getattr(subprocess, "IDLE_PRIORITY_CLASS", 0) if idle else 0,  # of Windows, without `os.nice`
        )  # fmt: skip
        self.pid, self._is_read = self._process.pid, False
        self.send([each for each in sys.path if each])
        self.send(request)

    def send(self, value: Any) -> None:
        """Send a value; one that has ended receives nothing, which `answers` shows."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.write(json.dumps(value) + "\n")
            self._process.stdin.flush()

    def answers(self) -> Iterator[Any]:
        """Yield the answers until it ends."""
        assert self._process.stdout is not None
        self._is_read = True
        with self._process.stdout as lines:
            for line in lines:
                if line.endswith("\n"):  # not of a killed one
                    yield json.loads(line)

    def wait(self) -> int:
        """Return the exit code when it has ended."""
        return self._process.wait()

    def stop(self) -> None:
        """End it in every case, and with it its own children."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()
        if not self._is_read:
            self._process.stdout.close()


def serve(module: str, name: str, niceness: str) -> None:
    """Call a function in the child, and end the process after it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(int(niceness))
    values: SimpleQueue[Any] = SimpleQueue()
    lines, answers = os.fdopen(os.dup(0), encoding="utf-8"), sys.stdout
    sys.stdout = sys.stderr

    def read() -> None:
        for line in lines:
            values.put(json.loads(line))
        os._exit(1)

    def answer(value: Any) -> None:
        answers.write(json.dumps(value) + "\n")
        answers.flush()

    threading.Thread(target=read, daemon=True).start()
    sys.path += [each for each in values.get() if each not in sys.path]
    try:
        getattr(importlib.import_module(module), name)(values.get, answer)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        os._exit(1)
    sys.stderr.flush()
    os._exit(0)  # no lock of the reading thread is waited for
