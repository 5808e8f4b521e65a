"""The studies' modules can be imported by these tests; and a model of a block that a ball presses."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "validation"))


@pytest.fixture(scope="session")
def model_file(tmp_path_factory):
    from exported import train

    path = tmp_path_factory.mktemp("model") / "organ.rom"
    train("MooneyRivlin", path)
    return path


@pytest.fixture(scope="session")
def exported_folder(model_file):
    from exported import export

    return export(model_file, "--c", str(model_file.parent / "organ"))


@pytest.fixture(scope="session")
def folder_for_arm(model_file):
    """The library for a second processor, which compiles the step once more."""
    from exported import export

    return export(model_file, "--target", "linux-aarch64", "--c", str(model_file.parent / "arm"))
