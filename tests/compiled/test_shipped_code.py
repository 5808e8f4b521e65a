"""Packs of compiled functions: read where they fit and are sound, and only from an installed package of one owner."""

from __future__ import annotations

import os

import pytest

from palpate.compiled import code_cache, shipped_code
from palpate.compiled.code_cache import cached_njit, code_files
from palpate.compiled.shipped_code import PROCESSOR_FAMILIES, Pack, machine_processor, pack_name, write_pack


def double(x):
    return 2 * x


def hits(function) -> int:
    return sum(function.stats.cache_hits.values())


@pytest.fixture
def packed(tmp_path, monkeypatch):
    """An installed package with the pack of `double`, and an empty folder of the user."""
    triple, _, features = machine_processor()
    families = [
        each for each, needed in PROCESSOR_FAMILIES.items() if set(needed.split(",")) <= set(features.split(","))
    ]
    if not families:
        pytest.skip("no family of processors has this one")
    family = families[0]
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "first"))
    made = cached_njit()(double)
    assert made(2.0) == 4.0
    (file,) = code_files()
    name = made._cache.entry_name(made.signatures[0], (triple, family, ""))
    package = tmp_path / "installed" / "palpate_kernels"
    package.mkdir(parents=True, mode=0o755)
    (package / "__init__.py").touch()
    path = package / pack_name(triple, family)
    write_pack(path, {"another": b"code", name: file.path.read_bytes()[32:]})
    path.chmod(0o644)
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "second"))
    code_cache._checked.cache_clear()
    shipped_code.installed_packs.cache_clear()
    yield path
    shipped_code.installed_packs.cache_clear()


def test_a_function_of_a_pack_is_not_compiled(packed):
    function = cached_njit()(double)
    assert function(2.0) == 4.0
    assert hits(function) == 1
    assert not code_files()
    assert function(2) == 4  # a signature that is not in the pack
    assert hits(function) == 1
    assert len(code_files()) == 1


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-1] + bytes([b[-1] ^ 1]), lambda b: b[:100], lambda b: b"", lambda b: b[9:]]
)
@pytest.mark.filterwarnings("ignore:functions are compiled")
def test_a_damaged_pack_is_not_used(packed, damage):
    packed.write_bytes(damage(packed.read_bytes()))
    function = cached_njit()(double)
    assert function(2.0) == 4.0
    assert hits(function) == 0


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX's")
@pytest.mark.parametrize("where", ["file", "folder"])
@pytest.mark.filterwarnings("ignore:functions are compiled")
def test_a_pack_that_others_can_write_is_not_used(packed, where):
    (packed if where == "file" else packed.parent).chmod(0o777)
    function = cached_njit()(double)
    assert function(2.0) == 4.0
    assert hits(function) == 0


def test_a_pack_of_another_numba_is_not_used(packed):
    packed.rename(packed.with_name(packed.name.replace("numba", "numba9")))
    functions = [cached_njit()(double) for _ in range(2)]
    with pytest.warns(RuntimeWarning, match="palpate-kernels has none") as found:
        assert [each(2.0) for each in functions] == [4.0, 4.0]
    assert len(found) == 1
    assert [hits(each) for each in functions] == [0, 1]  # the second from the folder of the user


def test_entries_are_read_by_name(tmp_path):
    write_pack(tmp_path / "a.pack", {"one": b"1", "two": b"", "three": bytes(1000)})
    pack = Pack(tmp_path / "a.pack")
    assert len(pack) == 3
    assert [pack.read(name) for name in ("one", "two", "three", "four")] == [b"1", b"", bytes(1000), None]


def test_a_pack_without_a_folder_of_the_user_warns_of_nothing(packed, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "file"))
    function = cached_njit()(double)
    assert function(2.0) == 4.0  # warnings are errors in tests
    assert hits(function) == 1
