"""Bodies and runs that several tests look at; they are made once."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.compiled.code_cache import code_folder
from palpate.core.sealed import open_sealed, write_sealed

SESSIONS = ("app/device", "app/session", "app/recordings", "app/view")
ORDER = (
    *SESSIONS, "surface", "tissue", "meshfree", "scenes", "app", "dynamics/run", "reduction/galerkin", "dynamics",
    "realtime", "validation", "reduction", "contracts",
)  # fmt: skip
QUICK = "not slow and not lint"  # the tests of `make test`
MARKED_MODULE = re.compile(r"^pytestmark = \[?\s*pytest\.mark\.(slow|lint)\b", re.MULTILINE)


def place_of(nodeid):
    """Return the place in `ORDER` of the folder of a test; files in ``tests`` itself are the last."""
    file = nodeid.split("::", 1)[0].removeprefix("tests/")
    return next((place for place, folder in enumerate(ORDER) if file.startswith(f"{folder}/")), len(ORDER))


@pytest.fixture(autouse=True, scope="session")
def _own_cache_folder(tmp_path_factory):
    """Tests learn no spacings from other runs, and leave none to them, but share the user's compiled code."""
    code, cache = code_folder(), tmp_path_factory.mktemp("cache")
    if code is not None:
        (cache / "palpate").mkdir(mode=0o700)
        (cache / "palpate" / "code").symlink_to(code, target_is_directory=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(cache))
        yield


def pytest_ignore_collect(collection_path, config):
    """Import no module of which an expression of the Makefile runs no test: reading all takes half a minute."""
    if not collection_path.match("test_*.py"):
        return None
    text, expression = collection_path.read_text(encoding="utf-8"), config.getoption("markexpr")
    if expression == "lint":
        return "mark.lint" not in text or None
    if expression == QUICK:
        return bool(MARKED_MODULE.search(text) and "mark.quick" not in text) or None
    return None


def is_slow(item):
    """Return whether a test is slow: by its nearest mark ``slow`` or ``quick``, or by the values of a ``quick``."""
    nearest, values = None, item.callspec.params if hasattr(item, "callspec") else {}
    slow = False
    for node, mark in item.iter_markers_with_node():
        if mark.name == "quick":
            slow |= any(values.get(name, allowed[0]) not in allowed for name, allowed in mark.kwargs.items())
        if mark.name in ("slow", "quick"):
            nearest = nearest or node
            slow |= mark.name == "slow" and node is nearest
    return slow


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Leave the mark ``slow`` on slow tests alone, and sort the folders."""
    slow = [item for item in items if is_slow(item)]
    for node in {node for item in items for node in item.listchain()}:
        node.own_markers = [mark for mark in node.own_markers if mark.name != "slow"]
    for item in slow:
        item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: place_of(item.nodeid))


@pytest.hookimpl(specname="pytest_collection_modifyitems", tryfirst=True)
def pytest_leave_to_release(items):
    """Mark for a release what an ``each_kind`` mark of a test, a class or a module leaves out."""
    for item in items:
        values = item.callspec.params if hasattr(item, "callspec") else {}
        for mark in item.iter_markers("each_kind"):
            if any(values.get(name, values_kept[0]) not in values_kept for name, values_kept in mark.kwargs.items()):
                item.add_marker(pytest.mark.release)


@pytest.hookimpl(specname="pytest_collection_modifyitems", wrapper=True, tryfirst=True)
def pytest_quick_tests_first(items):
    """Sort the slow tests of a session behind the quick ones."""
    yield
    items.sort(key=lambda item: item.get_closest_marker("slow") is not None)


def units(nodeids, sessions_first):
    """Return the unit of a worker to which each test belongs: tests of a file in a row, or the first of `SESSIONS`."""
    found, count, before, in_sessions = {}, Counter(), None, sessions_first
    for nodeid in nodeids:
        file = nodeid.split("::", 1)[0]
        in_sessions = in_sessions and place_of(nodeid) < len(SESSIONS)
        count[file] += file != before
        found[nodeid], before = "sessions" if in_sessions else f"{file} {count[file]}", file
    return found


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Return a scheduler that keeps the quick tests of sessions on one worker, and those of any other file together.

    Two workers that begin with the same kind of body compile the same kernels at the same time. One begins with the
    sessions, which need most kernels. The other goes through `ORDER`: what compiles little, then the strong form, and
    last what uses the kernels of sessions. Slow tests come later, when these kernels are there, file by file.
    """
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduler(LoadFileScheduling):
        def add_node_collection(self, node, collection):
            self.units = units(collection, config.getvalue("markexpr").split(" ")[0] not in ("slow", "release"))
            super().add_node_collection(node, collection)

        def _split_scope(self, nodeid):
            return self.units[nodeid]

    return Scheduler(config, log)


@pytest.fixture(scope="session")
def jittered_points():
    return pt.box((0.5, 0.6, 0.5), spacing=0.1, jitter=0.2).points


@pytest.fixture(scope="session")
def tissue():
    return pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000.0, poisson=0.45)


@pytest.fixture(scope="session")
def bar():
    """A bar, 30 mm by 15 mm by 15 mm, with a patch ``"tip"`` of four nodes in the middle of its end."""
    cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    end = cloud.group("x+")
    tip = end[np.all(np.abs(cloud.points[end, 1:] - 0.0075) < 0.004, axis=1)]
    return replace(cloud, groups={**cloud.groups, "tip": tip})


@pytest.fixture(scope="session")
def calm(bar, tissue):
    """The stiffness damping that the held bar needs, from its spectrum."""
    return pt.Solid(bar, tissue, form="strong", fixed="x-").stiffness_damping


@pytest.fixture
def held(bar, tissue, calm):
    """The bar, held at one end; new for every test."""
    return pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=calm)


@pytest.fixture(scope="session")
def small_cloud():
    """The smallest box: four nodes a side, 15 mm."""
    return pt.box((0.015, 0.015, 0.015), spacing=0.005)


@pytest.fixture
def free(small_cloud, tissue):
    """The smallest box, held nowhere; new for every test."""
    return pt.Solid(small_cloud, tissue, form="strong", stiffness_damping=6e-5)


@pytest.fixture(scope="session")
def rotation():
    """Some rotation in space."""
    q, r = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


@pytest.fixture(scope="session")
def pull():
    """A smooth pull at the end of the bar, sideways too."""
    return pt.SurfaceForce("x+", force=lambda t: np.sin(300 * t) ** 2 * np.array([0.6, 0.15, 0.05]))


@pytest.fixture(scope="session")
def run(bar, tissue, calm, pull):
    """A short run of the bar under that pull."""
    return pt.rollout(
        pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=calm), [pull], duration=0.03, every=0.0005
    )


@pytest.fixture
def forge():
    """Return a function that changes header and arrays of a sealed file and writes it again with right checksums."""

    def forged(path, change, kind, version, to=None):
        file = open_sealed(path, kind, version)
        header, arrays = dict(file.header), {name: file.read(name) for name in file.arrays}
        by_row = {name for name, entry in file.arrays.items() if entry.by_row}
        change(header, arrays)
        rows = {name: list(arrays.pop(name)) for name in by_row & arrays.keys() if len(arrays[name])}
        write_sealed(to or path, kind, version, header, arrays, rows)
        return to or path

    return forged
