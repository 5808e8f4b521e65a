"""Digests of the code on which compiled functions depend.

The key of Numba's cache contains the closure of a function, and a closure over other compiled functions never compares
equal in a new process. Numba does not detect a change of an inlined function either. Here the key is a digest of a law
and of the code that a kernel uses: its own module, and the imported modules of compiled functions. It is one of
bytecode, so comments, docstrings and places of lines do not change it.
"""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np

IMPORT_PATTERN = re.compile(r"^from (palpate\.[\w.]+) import (\([^)]*\)|[^\n(]+)", re.MULTILINE)
PLAIN_TYPES = (bool, int, float, str, tuple)  # types of constants in compiled code
# modules that compile and keep functions; what they pass to the compiler is a part of the digests
STORING_MODULES = frozenset({"palpate.compiled.code_cache", "palpate.compiled.code_digest", "palpate.compiled.jit"})
FUNCTION_FLAGS = inspect.CO_OPTIMIZED | inspect.CO_NEWLOCALS
DOCSTRING_FLAG = 0x4000000  # of Python 3.13


@cache
def _source(module: str) -> str:
    """Return the text of a loaded module; empty for one without a file, such as a notebook."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file).read_text(encoding="utf-8") if file and file.endswith(".py") else ""


@cache
def kernel_sources(module: str) -> dict[str, str]:
    """Return the sources on which the compiled functions of a loaded module depend.

    They are texts by the name of a module, and values by ``module:constant``. Imports of modules with compiled
    functions are followed recursively. Of other modules of palpate only the values of imported constants are included.
    """
    sources: dict[str, str] = {}
    remaining = [module]
    while remaining:
        name = remaining.pop()
        if name in sources:
            continue
        sources[name] = _source(name)
        for imported, names in IMPORT_PATTERN.findall(sources[name]):
            if imported in STORING_MODULES:
                continue
            if _compiles(imported):
                remaining.append(imported)
                continue
            for word in re.findall(r"\w+", re.sub(r" as \w+|#.*", "", names)):
                value = getattr(sys.modules.get(imported), word, None)
                if isinstance(value, PLAIN_TYPES):
                    sources[f"{imported}:{word}"] = repr(value)
    return sources


def _compiles(module: str) -> bool:
    """Return True for a module with compiled functions."""
    text = _source(module)
    return any(word in text for word in ("from numba", "palpate.compiled"))


@cache
def _module_code(module: str) -> str:
    """Return a digest of what a loaded module executes; empty for one without a file."""
    if not _source(module):
        return ""
    loader: Any = getattr(sys.modules[module].__spec__, "loader", None)
    code = loader.get_code(loader.name) if hasattr(loader, "get_code") and hasattr(loader, "name") else None
    return _digest(repr(_described(code if code is not None else compile(_source(module), module, "exec"))))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _described(code: CodeType) -> tuple[object, ...]:
    """Return what a code object executes, without names of files, places of lines and docstrings."""
    is_function, texts = code.co_flags & FUNCTION_FLAGS == FUNCTION_FLAGS, list[object]()
    for k, value in enumerate(code.co_consts):
        has_docstring = sys.version_info < (3, 13) or code.co_flags & DOCSTRING_FLAG
        first = k == 0 and has_docstring if is_function else k <= 1 and "__doc__" in code.co_names
        is_docstring = isinstance(value, str) and first
        is_line = "__firstlineno__" in code.co_names and value == code.co_firstlineno
        if isinstance(value, CodeType):
            texts.append(_described(value))
        elif isinstance(value, frozenset):  # whose order is random
            texts.append(sorted(map(repr, value)))
        else:
            texts.append(None if is_docstring or is_line else repr(value))
    return (
        code.co_code, texts, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount,
        code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags & ~DOCSTRING_FLAG, code.co_exceptiontable,
    )  # fmt: skip


@cache
def _sources_digest(module: str) -> str:
    texts = [(name, text if ":" in name else _module_code(name)) for name, text in kernel_sources(module).items()]
    return _digest(repr(sorted(texts)))


def law_digest(module: str, *what: object) -> str:
    """Return the digest of a module's kernels, of functions (by their code) and of other values.

    `module` is the ``__name__`` of the caller, whose code and imported compiled functions are included. `what` are
    functions of a law, flags and further digests.
    """
    return _digest("".join([_sources_digest(module), *map(_text, what)]))


def _text(item: object) -> str:
    """Return the code of a function and of all functions that it uses, or the repr of another value."""
    if not inspect.isfunction(item):
        return _value_text(item)
    sources: dict[object, str] = {}
    remaining: list[Any] = [item]
    while remaining:
        value = remaining.pop()
        if not inspect.isfunction(value):
            sources[_value_text(value)] = ""
        elif value not in sources:
            sources[value] = repr((_described(value.__code__), value.__defaults__, value.__kwdefaults__))
            cells = [cell.cell_contents for cell in value.__closure__ or ()]
            remaining += [getattr(other, "py_func", other) for other in cells]
            used = [value.__globals__.get(name) for name in _names(value.__code__)]
            used = [getattr(other, "py_func", other) for other in used]
            kinds = *PLAIN_TYPES, np.ndarray
            remaining += [other for other in used if isinstance(other, kinds) or inspect.isfunction(other)]
    return "".join(text or str(value) for value, text in sources.items())


def _names(code: CodeType) -> list[str]:
    """Return the global names that a code object and those in it use."""
    inner = [name for each in code.co_consts if isinstance(each, CodeType) for name in _names(each)]
    return [*code.co_names, *inner]


def _value_text(value: object) -> str:
    """Return a text of a value that is equal in all processes.

    That of an array is the digest of its content, since its repr leaves numbers out. That of a set is sorted, since its
    order is random.
    """
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if isinstance(value, set | frozenset):
        return "{" + ", ".join(sorted(map(_value_text, value))) + "}"
    if isinstance(value, list) or type(value) is tuple:
        return "(" + ", ".join(map(_value_text, value)) + ")"
    return repr(value)
