"""Compiled functions on disk, by their content, in one folder of a user.

A file belongs to one function, signature, processor and version of Python, Numba and NumPy, and to a digest of all code
that the function uses (`palpate.compiled.code_digest`). So every clone and environment of a user finds what another has
compiled, and nothing has to be discarded. The files hold machine code, so nothing is read that others than root and the
user can write. A folder that this process cannot write is read, and new code is not kept. Files are written under
another name and renamed, and start with a digest of their content: what a power cut or another program has damaged
counts as missing. The folder keeps at most `MAX_BYTES`; what was not used for longest goes first.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import sys
import sysconfig
import time
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numba
from numba import njit
from numba.core import serialize, types
from numba.core.compiler import CompileResult
from numba.core.registry import cpu_target

from palpate.compiled.code_digest import law_digest
from palpate.compiled.shipped_code import NUMPY_VERSION, find_shipped
from palpate.compiled.threads import loops_share_threads
from palpate.core.working_folder import cache_folder, foreign_writer, make_private

MAX_BYTES, KEPT_SHARE = 500_000_000, 0.8  # of all files, and the share of it that is left when it is exceeded
SAVES_BETWEEN_CHECKS = 50
FILE_SUFFIX, DIGEST_BYTES = ".code", 32  # of files, and of the digest of their content, which comes first
DAY_SECONDS = 86_400.0  # [s] from which on the time of the last use is written again, and a partial file removed
ENTRY_FORMAT = "1"  # of the content of a file
FILE_MODE = 0o644  # only its owner writes it, whatever the umask
ANNOTATION_PLACE = 6  # place of a text in a reduced compile result, which holds paths
# options that Numba takes from the first caller where they are not given
CALLER_OPTIONS = {"fastmath": False, "error_model": "python", "forceinline": False, "_nrt": True}
SERIAL_KEY = () if loops_share_threads() else ("serial",)  # of code that was compiled without parallel loops


def _compile_plain_subroutines() -> None:
    """Compile subroutines of Numba, such as powers by integers, without the fast-math flags of their first caller.

    A caller is compiled in a copy of this context, with its flags, and Numba keeps one version of a subroutine for all.
    """
    context: Any = cpu_target.target_context
    context._compile_subroutine_no_cache = context._compile_subroutine_no_cache  # of the context itself, also in copies


_compile_plain_subroutines()


def own_options(options: dict[str, Any]) -> dict[str, Any]:
    """Return options of `numba.njit` that do not depend on the caller.

    Numba compiles a function without these options with those of the function that calls it first, and the others call
    that code. Its content would depend on the order of compiling. ``parallel`` is off where several threads cannot run
    parallel loops at once.
    """
    serial = {} if loops_share_threads() else {"parallel": False}
    return {**CALLER_OPTIONS, **options, **serial}


class _Reasons:
    """Warns once that functions are not kept, with the reason."""

    def __init__(self) -> None:
        self._warned = False

    def warn(self, reason: str) -> None:
        if not self._warned:
            self._warned = True
            message = f"newly compiled code is not kept, so every start compiles it again: {reason}"
            warnings.warn(f"{message}; set NUMBA_CACHE_DIR to a folder of yours", RuntimeWarning, stacklevel=4)


REASONS = _Reasons()


class CodeFile(NamedTuple):
    """A file of a compiled function: path, bytes and the time [s] of its last use."""

    path: Path
    size: int
    used: float


def code_folder() -> Path | None:
    """Return the folder of compiled functions, or None if there is none that others cannot write.

    It is ``palpate/code`` in the cache of the user, or in the folder that ``NUMBA_CACHE_DIR`` names.
    """
    folder, why = _found_folder()
    return None if why else folder


def _found_folder() -> tuple[Path, str]:
    """Return the folder of compiled functions, and why it cannot be used; empty if it can."""
    configured = numba.config.CACHE_DIR
    if configured:
        return _checked(Path(configured) / "palpate-code")
    folder = cache_folder()
    return (Path(), "the user has no home folder") if folder is None else _checked(folder / "code")


@cache
def _checked(folder: Path) -> tuple[Path, str]:
    """Create a folder, and return it and why it cannot be used."""
    try:
        make_private(folder)
        os.scandir(folder).close()
    except OSError as error:
        return folder, f"{folder}: {error.strerror or error}"
    return folder, foreign_writer(folder)


def code_files() -> list[CodeFile]:
    """Return the files of compiled functions, with partial ones; the oldest first."""
    folder = code_folder()
    return [] if folder is None else sorted(_files(folder), key=lambda each: each.used)


def _files(folder: Path) -> Iterator[CodeFile]:
    with os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):  # removed by another process
                status = entry.stat()
                yield CodeFile(Path(entry.path), status.st_size, status.st_mtime)


_saves = 0


def _limit(folder: Path) -> None:
    """Remove the files that were not used for longest where there are too many, and old partial ones."""
    files = sorted(_files(folder), key=lambda each: each.used)
    total, now = sum(each.size for each in files), time.time()
    is_full = total > MAX_BYTES
    for each in files:
        is_partial = each.path.suffix != FILE_SUFFIX and now - each.used > DAY_SECONDS
        if is_partial or (is_full and total > KEPT_SHARE * MAX_BYTES):
            with suppress(OSError):
                each.path.unlink()
                total -= each.size


def _save(folder: Path, name: str, content: bytes) -> None:
    """Write a file under another name, and rename it."""
    global _saves
    partial = folder / f"{name}.{os.getpid()}.{os.urandom(4).hex()}.partial"
    try:
        partial.touch(FILE_MODE)
        partial.write_bytes(content)
        partial.replace(folder / name)
    except OSError:
        with suppress(OSError):
            partial.unlink()
        if _load(folder, name) is None:  # else another process has written it, and reads it
            raise
    if _saves % SAVES_BETWEEN_CHECKS == 0:
        _limit(folder)
    _saves += 1


def _load(folder: Path, name: str) -> bytes | None:
    """Return the content of a file; None if there is none, or others can write it, or it is damaged."""
    path = folder / name
    try:
        content, used = path.read_bytes(), path.stat().st_mtime
    except OSError:
        return None
    if foreign_writer(path):
        return None
    if time.time() - used > DAY_SECONDS:
        with suppress(OSError):  # the folder cannot be written
            os.utime(path)
    code = content[DIGEST_BYTES:]
    return code if hashlib.sha256(code).digest() == content[:DIGEST_BYTES] else None


def _signature_text(kind: Any) -> str:
    """Return a text of a type or signature, with the names of the fields of tuples."""
    if isinstance(kind, tuple):
        return "(" + ", ".join(map(_signature_text, kind)) + ")"
    if hasattr(kind, "record"):  # of a reference
        return f"{type(kind).__name__}({_signature_text(kind.record)})"
    if isinstance(kind, types.BaseNamedTuple):  # type: ignore[attr-defined]
        return f"{kind.instance_class.__name__}{kind.fields}{_signature_text(tuple(kind.types))}"
    if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
        return f"tuple{_signature_text(tuple(kind.types))}"
    return repr(kind)


def _versions() -> tuple[object, ...]:
    """Return the versions and settings that decide what a function compiles to."""
    config = numba.config
    settings = int(config.OPT), config.BOUNDSCHECK, config.LOOP_VECTORIZE, config.SLP_VECTORIZE
    python = sys.implementation.cache_tag, sysconfig.get_config_var("SOABI")
    return (
        *python, numba.__version__, NUMPY_VERSION, *settings, config.DEBUGINFO_DEFAULT, config.USING_SVML, *SERIAL_KEY,
        ENTRY_FORMAT,
    )  # fmt: skip


class CodeCache:
    """The compiled versions of one function, in the interface that a dispatcher of Numba requires.

    `digest` is that of all code that it uses.
    """

    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        words = re.sub(r"[^\w.]", "", f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}")
        self._name, self._digest = words.replace(".locals", "")[:80], digest

    @property
    def cache_path(self) -> str:
        return str(code_folder() or "")

    def enable(self) -> None:
        """Do nothing: functions are always kept."""

    disable = flush = enable

    def entry_name(self, signature: Any, processor: tuple[str, ...]) -> str:
        """Return the name of the entry of a signature for a triple, processor and features of LLVM."""
        key = repr((_signature_text(signature), processor, _versions(), self._digest))
        return f"{self._name}.{hashlib.sha256(key.encode()).hexdigest()[:32]}"

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return compiled code, from the folder of the user or the installed package; None where there is none.

        Numba starts its threads when it loads a function that was compiled together with a parallel loop. It does not
        do so for one that was compiled when its loops came from the cache, and calling that one crashes. So they are
        started here.
        """
        numba.get_num_threads()
        target_context.refresh()
        processor, folder = target_context.codegen().magic_tuple(), code_folder()
        content = None if folder is None else _load(folder, self.entry_name(signature, processor) + FILE_SUFFIX)
        if content is None:
            content = find_shipped(lambda family: self.entry_name(signature, family), processor)
        if content is None:
            return None
        try:
            # which only root and the user can write
            return CompileResult._rebuild(target_context, *pickle.loads(zlib.decompress(content)))  # noqa: S301
        except Exception:  # a class that has changed raises errors of any type; the code is compiled and saved again
            return None

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep compiled code if a folder takes it; warn once if none does."""
        folder, why = _found_folder()
        if why:
            REASONS.warn(why)
        if why or data.lifted or data.library.has_dynamic_globals:
            return
        reduced = list(data._reduce())
        reduced[ANNOTATION_PLACE] = ""
        content = zlib.compress(serialize.dumps(tuple(reduced)), 1)
        name = self.entry_name(signature, data.codegen.magic_tuple()) + FILE_SUFFIX
        try:
            _save(folder, name, hashlib.sha256(content).digest() + content)
        except OSError as error:
            REASONS.warn(f"{folder}: {error.strerror or error}")


def enable_cache(compiled: Any, function: Callable[..., Any], digest: str) -> None:
    """Let a compiled function keep its code."""
    compiled._cache = CodeCache(function, digest)


def cached_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with `numba.njit` and its options, and keep its code."""

    def decorate(function: Callable[..., Any]) -> Any:
        compiled = njit(**own_options(options))(function)
        chosen = sorted((CALLER_OPTIONS | options).items())
        enable_cache(compiled, function, law_digest(function.__module__, chosen))
        return compiled

    return decorate
