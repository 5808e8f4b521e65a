"""Former public names: they work for one version, and warn."""

from __future__ import annotations

import warnings
from typing import Any


def warn_renamed(former: str, name: str, stacklevel: int = 3) -> None:
    """Warn that a name has changed, by default whoever calls the caller of this function."""
    warnings.warn(f"{former} is {name} since version 0.2; use the new name", DeprecationWarning, stacklevel=stacklevel)


def renamed_attribute(owner: str, former: str, name: str) -> property:
    """Return the property of a class under its former name."""

    def read(self: Any) -> Any:
        warn_renamed(f"{owner}.{former}", f"{owner}.{name}")
        return getattr(self, name)

    return property(read, doc=f"Former name of `{name}`.")
