"""Compiled functions are read from the cache, and compiled again when a source they use has changed."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import NumbaError
from numba.core.registry import cpu_target

import palpate
import palpate as pt
from palpate.compiled import code_digest
from palpate.compiled.code_digest import kernel_sources, law_digest
from palpate.compiled.jit import law_njit
from palpate.dynamics.loads.supports import FIXED

pytestmark = pytest.mark.slow

SECOND_PROCESS = """
import sys
import palpate as pt
import palpate.dynamics.contact.impulses as contact
import palpate.dynamics.nodal.central_difference as steps
tissue = eval(sys.argv[1])
model = pt.Solid(pt.box((0.03, 0.015, 0.015), spacing=0.005), tissue, fixed="x-", form="strong", stiffness_damping=6e-5)
pull = pt.SurfaceForce("x+", force=(1.0, 0.0, 0.0))
run = pt.rollout(model, [pull], duration=1e-3, every=2e-4, progress=False)
rom = pt.galerkin(model, run, modes=2)
pt.rollout(rom, [pull], duration=1e-3, every=2e-4, progress=False)
step = steps.full_step(model.formulation.of_steps, contact.NO_TOOLS)
for f in (model._internal_force, step, rom._projected_force, rom._advance):
    print(sum(f.stats.cache_hits.values()), sum(f.stats.cache_misses.values()))
"""


def test_a_kernel_that_allocates_must_say_so():
    def doubled(values):
        return values + values

    assert law_njit("test", cached=False, allocates=True)(doubled)(np.ones(2)).tolist() == [2.0, 2.0]
    with pytest.raises(NumbaError):
        law_njit("test", cached=False)(doubled)(np.ones(2))


@pytest.mark.each_kind(law=["MooneyRivlin(C1=20e3, C2=5e3, "])
@pytest.mark.parametrize("law", ["MooneyRivlin(C1=20e3, C2=5e3, ", "Ogden(C=(5e3, 300.0), alpha=(1.3, 5.0), "])
def test_a_second_process_compiles_nothing(law):
    made = f"pt.materials.{law}density=1000.0, poisson=0.45)"
    for attempt in range(2):  # the first may find nothing yet
        command = [sys.executable, "-c", SECOND_PROCESS, made]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        counts = done.stdout.split()
        if counts == ["1", "0"] * 4:
            break
        assert attempt == 0, done.stdout
    assert done.stderr == ""


def test_another_law_has_another_digest():
    laws = [(law.first, law.second) for law in (pt.materials.NeoHookean, pt.materials.MooneyRivlin)]
    digests = {law_digest(__name__, *law, relaxed) for law in laws for relaxed in (False, True)}
    assert len(digests) == 4
    assert law_digest(__name__, *laws[0], False) == law_digest(__name__, *laws[0], False)


def test_models_of_one_law_share_their_compiled_functions(bar, small_cloud):
    models = [
        pt.Solid(
            cloud,
            pt.materials.MooneyRivlin(C1=c, C2=0, density=1000, poisson=0.4),
            form="strong",
            stiffness_damping=0.0,
        )
        for cloud, c in ((bar, 10e3), (small_cloud, 20e3))
    ]
    assert models[0].formulation is models[1].formulation
    assert models[0]._internal_force is models[1]._internal_force


FORCES = """
import sys
import numpy as np
import palpate as pt
law = pt.materials.NeoHookean(C1=10e3, density=1000, poisson=0.5)
cloud = pt.disc(0.1, 0.02)
u = 0.01 * np.sin(200 * cloud.points[:, [0, 1, 0]])
for kind in sys.argv[1:]:
    model = pt.Membrane(cloud, law, 1e-3, relaxed=kind == "relaxed")
    print(repr(float(np.abs(model.force(u)).sum())))
"""


@pytest.mark.release
def test_a_third_process_does_not_mix_up_code_of_two_others(tmp_path):
    def forces(*kinds):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        command = [sys.executable, "-c", FORCES, *kinds]
        return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout.split()

    relaxed, plain = forces("relaxed"), forces("plain")
    assert relaxed != plain
    assert forces("relaxed", "plain") == relaxed + plain
    assert forces("plain", "relaxed") == plain + relaxed


@pytest.mark.quick
def test_a_function_has_options_of_its_own_and_none_of_its_first_caller():
    @law_njit("test", cached=False)
    def product_sum(a, b, c):
        return a * b / c + c

    @law_njit("test", cached=False, fastmath={"contract", "reassoc"}, error_model="numpy", forceinline=True)
    def caller(a, b, c):
        return product_sum(a, b, c)

    assert caller(1.0, 2.0, 3.0) == pytest.approx(11.0 / 3.0)
    with pytest.raises(ZeroDivisionError):
        product_sum(1.0, 2.0, 0.0)
    (code,) = product_sum.overloads.values()
    text = code.library.get_llvm_str()
    assert "fmul double" in text
    assert "contract" not in text
    assert "alwaysinline" not in text


@pytest.mark.quick
def test_a_subroutine_of_numba_has_no_flags_of_its_first_caller(monkeypatch):
    monkeypatch.setattr(cpu_target.target_context, "cached_internal_func", {})  # as in a new process

    @law_njit("test", cached=False, fastmath={"contract"})
    def first(x, n):
        return x**n + 1.0

    @law_njit("test", cached=False)
    def second(x, n):
        return x**n + 1.0

    assert first(2.0, 3) == second(2.0, 3) == 9.0
    (code,) = second.overloads.values()
    assert "fmul double" in code.library.get_llvm_str()
    assert "contract" not in code.library.get_llvm_str()


@pytest.mark.quick
def test_literal_integers_compile_one_version():
    @law_njit("test", cached=False, inner=True)
    def put(values, k, added=1):
        values[k] += added

    @law_njit("test", cached=False)
    def caller(values):
        put(values, 0, 1)
        put(values, 1, 2)
        put(values, 2, added=3)

    values = np.zeros(3)
    caller(values)
    assert values.tolist() == [1.0, 2.0, 3.0]
    assert len(put.overloads) == 1


def test_digests_are_equal_in_all_processes():
    """The order of a set of options is random: half of the processes would compile what the others have kept."""
    program = "from palpate.reduction.contact.gauss_seidel import kick_by_load as k; print(k._cache._digest)"
    printed = [
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True,
            env={**os.environ, "PYTHONHASHSEED": str(seed)},
        ).stdout
        for seed in range(5)
    ]  # fmt: skip
    assert len(set(printed)) == 1


FILLED = """
import hashlib, sys, warnings
import numpy as np
import palpate as pt
from palpate.compiled.reference import StoredRecord
from palpate.realtime.period import Work

warnings.simplefilter("ignore")
path, part = sys.argv[1:]
tissue = pt.materials.NeoHookean(C1=5e3, density=1000.0, poisson=0.45)
ball = pt.tools.Contact(pt.tools.Sphere(0.006), lambda t: (0.015, 0.015, 0.0212 - 0.1 * t), friction=0.3)


def show(part, *arrays):
    print(part, hashlib.sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)).hexdigest())


def train():
    body = pt.Solid(pt.box((0.03, 0.03, 0.015), spacing=0.005), tissue, fixed="z-")
    run = pt.rollout(body, [ball], duration=0.02, every=0.001, progress=False)
    pt.save(pt.hyper_reduce(body, run, modes=4), path)


def reduced():
    run = pt.rollout(pt.load(path), [ball], duration=0.02, every=0.001, progress=False)
    show("reduced", run.displacements, run.contact_forces)


def engine():
    still = pt.tools.Contact(pt.tools.Sphere(0.006), (0.015, 0.015, 0.0212), friction=0.3)
    model, forces = pt.realtime_model(pt.load(path), contact=still), []
    work, data = Work.at_rest(model.rest, model.tool), StoredRecord(model.data)
    for k in range(30):
        work.target[:3] = 0.0, 0.0, -1e-4 * k
        model.advance(data, work.q, work.v, work.target, 1e-3, work.report)
        forces.append(work.report[8:11].copy())
    show("engine", work.q, forces)


globals()[part]()
"""


def test_a_reduced_press_has_the_same_bits_for_any_order_of_compiling(tmp_path):
    """One empty cache is filled by a reduced run and then by the engine, the other in the reverse order."""
    path = tmp_path / "block.rom"

    def start(part, seed, **variables):
        environment = {**os.environ, "PYTHONHASHSEED": str(seed), **variables}
        command = [sys.executable, "-c", FILLED, str(path), part]
        return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout

    start("train", 0)  # with the code of the user's cache
    order, there, back = ("reduced", "engine"), tmp_path / "there", tmp_path / "back"
    forth = {part: start(part, 0, NUMBA_CACHE_DIR=str(there)) for part in order}
    reverse = {part: start(part, 4, NUMBA_CACHE_DIR=str(back)) for part in order[::-1]}
    assert all(forth.values())
    assert reverse == forth


LOOPS = """
import numpy as np
from numba import prange
from palpate.compiled.jit import kernel_njit

@kernel_njit(parallel=True)
def loop(a):
    for i in prange(len(a)):
        a[i] += i

@kernel_njit()
def caller(a):
    loop(a)

if __name__ == "__main__":
    import loops
    a = np.zeros(5)
    loops.caller(a)
    print(a.sum(), *(sum(f.stats.cache_hits.values()) for f in (loops.caller, loops.loop)))
"""


def test_a_parallel_loop_is_called_by_code_that_was_compiled_when_the_loop_came_from_the_cache(tmp_path):
    """Numba starts its threads for the process that compiles the loop, and not for those that load the caller."""
    (tmp_path / "loops.py").write_text(LOOPS)

    def run():
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        command = [sys.executable, str(tmp_path / "loops.py")]
        return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout

    assert run() == "10.0 0 0\n"
    for file in tmp_path.rglob("*caller*.code"):
        file.unlink()
    assert run() == "10.0 0 1\n"
    assert run() == "10.0 1 0\n"


SOURCES = sorted(Path(palpate.__file__).parent.rglob("*.py"))
KERNELS = [path for path in SOURCES if re.search(r"^ *@(kernel_njit|law_njit)", path.read_text(), re.MULTILINE)]


def module_of(path):
    return ".".join(path.relative_to(SOURCES[0].parent.parent).with_suffix("").parts)


DIGESTS = """
import importlib, json, sys
from palpate.compiled.code_digest import law_digest
for name in sys.argv[1:]:
    importlib.import_module(name)
print(json.dumps({name: law_digest(name) for name in sys.argv[1:]}))
"""


def digests_of(folder, names):
    command = [sys.executable, "-c", DIGESTS, *names]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, cwd=folder)
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sources")
    root = SOURCES[0].parent
    shutil.copytree(root, folder / "palpate", ignore=shutil.ignore_patterns("__pycache__", "page"))
    names = [module_of(path) for path in KERNELS]
    return folder, names, digests_of(folder, names)


def test_editing_a_kernel_source_recompiles_it(copied):
    folder, names, before = copied
    path = folder / "palpate" / "dynamics" / "contact" / "geometry.py"
    text = path.read_text()
    try:
        path.write_text(text + "\nEDITED = True\n")
        after = digests_of(folder, names)
    finally:
        path.write_text(text)
    changed = {name for name in names if after[name] != before[name]}
    for name in names:
        importlib.import_module(name)
    assert changed == {name for name in names if "palpate.dynamics.contact.geometry" in kernel_sources(name)}


@pytest.mark.parametrize("path", KERNELS, ids=module_of)
def test_another_code_of_a_module_recompiles_what_uses_it_and_nothing_else(path, monkeypatch):
    names = [module_of(each) for each in KERNELS]
    for name in names:
        importlib.import_module(name)
    before, code = {name: law_digest(name) for name in names}, code_digest._module_code
    code_digest._sources_digest.cache_clear()
    monkeypatch.setattr(code_digest, "_module_code", lambda name: "edited" if name == module_of(path) else code(name))
    try:
        changed = {name for name in names if law_digest(name) != before[name]}
    finally:
        code_digest._sources_digest.cache_clear()
    assert changed == {name for name in names if module_of(path) in kernel_sources(name)}
    assert module_of(path) in changed


def test_comments_docstrings_and_the_modules_that_keep_code_recompile_nothing(copied):
    folder, names, before = copied
    changed = {path: path.read_text() for path in (folder / "palpate").rglob("*.py")}
    try:
        for path, text in changed.items():
            edited = re.sub(r'^( *)"""(?=\w)', r'\1"""Really. ', "# a comment\n" + text, flags=re.MULTILINE)
            path.write_text(edited.replace("\n\n\n", "\n\n# another\n\n\n\n"))
        for module in ("compiled/code_cache.py", "compiled/code_digest.py", "compiled/jit.py"):
            with (folder / "palpate" / module).open("a") as file:
                file.write("\nEDITED = True\n")
        assert digests_of(folder, names) == before
    finally:
        for path, text in changed.items():
            path.write_text(text)


def test_a_change_of_one_form_does_not_recompile_other_forms():
    """An edit of the strong form must not recompile membranes, or the energy form."""
    for other in ("palpate.dynamics.membrane.passes", "palpate.dynamics.solid.energy_form"):
        importlib.import_module(other)
        assert "palpate.dynamics.solid.strong_form" not in kernel_sources(other)


def test_a_changed_constant_of_a_module_without_kernels_recompiles():
    importlib.import_module("palpate.dynamics.nodal.central_difference")
    sources = kernel_sources("palpate.dynamics.nodal.central_difference")
    assert sources["palpate.dynamics.loads.supports:FIXED"] == repr(FIXED)
    assert "palpate.dynamics.loads.supports" not in sources


def is_compiled(value):
    return hasattr(value, "py_func")
