"""What the tests of all commands share."""

from __future__ import annotations

import pytest

from palpate.app.cli import main
from palpate.dynamics.reactions import evaluate


@pytest.fixture
def assert_refused(capsys):
    """A function that runs a command line and asserts that it is refused in one line with some parts in it."""

    def refused(argv, *parts):
        try:
            code = main(argv)
        except SystemExit as end:
            code = end.code
        captured = capsys.readouterr()
        said = [line for line in captured.err.splitlines() if not line.endswith("...")]
        assert code == 2
        assert captured.out == ""
        assert len(said) == 1
        assert all(part in said[0] for part in parts), said[0]

    return refused


@pytest.fixture
def stop_after(monkeypatch):
    """A function that makes runs raise an error at the first snapshot after a time [s]."""

    def stop(time, error):
        def late(model, state, drive):
            if state.time > time:
                raise error
            return evaluate(model, state, drive)

        monkeypatch.setattr("palpate.dynamics.rollout.evaluate", late)

    return stop
