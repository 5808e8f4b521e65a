"""A published liver, fetched on request: never shipped with the package."""

from __future__ import annotations

from pathlib import Path

from palpate.faults import FileFormatError
from palpate.meshfree.surface_files import read_surface
from palpate.meshfree.surfaces import Surface

__all__ = ["CITATION", "PART", "SOURCE", "fetch_liver"]

SOURCE = "https://github.com/hubmapconsortium/ccf-releases/raw/cb9bfd93/v1.3/models/VH_F_Liver.glb"
SHA256 = "ad9b0be0ff253e7bfe31bfffc00017dafce226d4f3e7804a81cbb4c2e269d598"
PART = "VH_F_capsule_of_the_liver"
CITATION = (
    "Kristen Browne. 2021. 3D Reference Organ for Liver, Female v1.1. https://doi.org/10.48539/HBM798.JZZM.649. "
    "CC BY 4.0. Its one hole is closed here."
)


def fetch_liver(folder: str | Path | None = None, source: str = SOURCE) -> Surface:
    """Return the female liver of the Human Reference Atlas (CC BY 4.0, `CITATION`), its one hole closed.

    The file of 1.7 MB is downloaded once and checked by its SHA-256.

    Parameters
    ----------
    folder : path, optional
        Where the file is kept; by default the user's cache. A file ``VH_F_Liver.glb`` that lies there already is used.
    source : str
        Address to download from, if the published one has moved.

    Raises
    ------
    FileFormatError
        What was downloaded is another file.
    OSError
        It cannot be downloaded.
    """
    import pooch

    kept = Path(pooch.os_cache("palpate") if folder is None else folder)
    try:
        path = pooch.retrieve(source, known_hash=f"sha256:{SHA256}", fname="VH_F_Liver.glb", path=kept)
    except ValueError as error:  # pooch's answer to another hash
        raise FileFormatError(f"{source} is not the published file: its SHA-256 differs from {SHA256}") from error
    return read_surface(path, part=PART, mend=True)
