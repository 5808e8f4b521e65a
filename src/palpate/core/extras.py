"""Optional packages, and the extra that installs each."""

from __future__ import annotations

from importlib.util import find_spec

from palpate.core.faults import InputError

EXTRA_BY_PACKAGE = {
    "distributed": "cluster",
    "imageio": "film",
    "imageio_ffmpeg": "film",
    "matplotlib": "plot",
    "pydicom": "dicom",
    "pymor": "linear",
    "pyvista": "film",
    "websockets": "view",
}  # as in pyproject.toml


def require(package: str, what: str) -> None:
    """Check that an optional package is installed, one of `EXTRA_BY_PACKAGE`, without importing it.

    `what` requires it, as the message begins: ``"a page in the browser"``.
    """
    try:
        installed = find_spec(package) is not None
    except (ImportError, ValueError):
        installed = False
    if not installed:
        raise InputError(
            f"{what} requires {package}, which is not installed; pip install 'palpate[{EXTRA_BY_PACKAGE[package]}]'"
        )
