"""Names the system of a wheel of packs; a wheel without a pack is empty, and for any system."""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LIBC = "manylinux_2_28"  # the oldest C library of Linux on which packs are used
PLATFORMS = {"linux": LIBC, "macosx": "macosx_11_0", "win": "win"}


class PackBuildHook(BuildHookInterface):
    """Sets the tag of the wheel: this Python and this system if there is a pack."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if not list(Path(self.root, "src", "palpate_kernels").glob("*.pack")):
            return
        system, _, rest = sysconfig.get_platform().partition("-")
        machine = rest.rpartition("-")[2].replace("-", "_")
        python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}-{PLATFORMS.get(system, system)}_{machine}"
