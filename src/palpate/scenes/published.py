"""Published liver surface, downloaded on request."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from urllib.request import urlopen

from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import whole_file
from palpate.core.working_folder import cache_folder
from palpate.surface.files import read_surface
from palpate.surface.surface import Surface

LIVER_ADDRESS = "https://github.com/hubmapconsortium/ccf-releases/raw/cb9bfd93/v1.3/models/VH_F_Liver.glb"
LIVER_FILE = "VH_F_Liver.glb"
MAX_LIVER_BYTES, DOWNLOAD_SECONDS = 20_000_000, 60.0
LIVER_SHA256 = "ad9b0be0ff253e7bfe31bfffc00017dafce226d4f3e7804a81cbb4c2e269d598"
LIVER_PART = "VH_F_capsule_of_the_liver"
LIVER_CITATION = (
    "Kristen Browne. 2021. 3D Reference Organ for Liver, Female v1.1. https://doi.org/10.48539/HBM798.JZZM.649. "
    "CC BY 4.0. Its one hole is closed here."
)


def fetch_liver(folder: str | Path | None = None, source: str = LIVER_ADDRESS) -> Surface:
    """Return the female liver of the Human Reference Atlas (CC BY 4.0, `LIVER_CITATION`), its one hole closed.

    The file of 1.7 MB is downloaded once and checked by its SHA-256.

    Parameters
    ----------
    folder : path, optional
        Folder of the file; by default the user's cache. An existing valid file ``VH_F_Liver.glb``
        is used.
    source : str
        Address to download from, if the published one has moved.

    Raises
    ------
    InputError
        `source` is not an address.
    FileFormatError
        The download is another file; nothing is written.
    OSError
        The file cannot be downloaded.

    References
    ----------
    Kristen Browne. 2021. 3D Reference Organ for Liver, Female v1.1. https://doi.org/10.48539/HBM798.JZZM.649.

    Examples
    --------
    >>> import palpate as pt
    >>> surface = pt.io.fetch_liver()  # doctest: +SKIP
    >>> pt.io.fetch_liver(source="liver.glb")
    Traceback (most recent call last):
        ...
    palpate.core.faults.InputError: source must be an address, got 'liver.glb'
    """
    place = cache_folder() if folder is None else Path(folder)
    if place is None:
        raise InputError("folder must be given for a user without a home folder, got None")
    path = place / LIVER_FILE
    if not (path.is_file() and sha256(path.read_bytes()).hexdigest() == LIVER_SHA256):
        content = _downloaded(source)
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial:
            partial.write_bytes(content)
    return read_surface(path, part=LIVER_PART, repair=True)


def _downloaded(source: str) -> bytes:
    """Return the content of the published file."""
    try:
        with urlopen(source, timeout=DOWNLOAD_SECONDS) as answer:
            content: bytes = answer.read(MAX_LIVER_BYTES)
    except ValueError as error:
        raise InputError(f"source must be an address, got {source!r:.200}") from error
    if sha256(content).hexdigest() != LIVER_SHA256:
        raise FileFormatError(f"{source} is not the published file: its SHA-256 differs from {LIVER_SHA256}")
    return content
