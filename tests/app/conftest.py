"""What the tests of all commands share."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from palpate.app.cli import main
from palpate.dynamics.run.reactions import nodal_outputs


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
        def late(model, fields, state, *others):
            if state.time > time:
                raise error
            return nodal_outputs(model, fields, state, *others)

        monkeypatch.setattr("palpate.dynamics.nodal.model.nodal_outputs", late)

    return stop


@pytest.fixture(scope="session")
def run_study():
    """A function that runs a study as a person would: its folder, report, standard output and standard error."""

    def run(options, out):
        command = [sys.executable, "-W", "error", "-m", "palpate", *options, "--json", "--out", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return out, json.loads((out / "report.json").read_text()), done.stdout, done.stderr

    return run


@pytest.fixture(scope="session")
def assert_drawn():
    """A function that asserts that a file is a picture with something on it."""

    def drawn(path):
        from matplotlib.image import imread

        picture = imread(path)
        assert min(picture.shape[:2]) > 500
        assert picture[..., :3].std() > 0.02

    return drawn
