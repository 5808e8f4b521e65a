"""LLVM's intermediate representation of compiled functions, before any optimisation and without Python.

Numba's code generator is replaced by one that records text and compiles nothing. Functions that are compiled meanwhile
cannot be called afterwards, so the process must do nothing else with compiled functions. A kernel that allocates an
array fails to compile here, because reference counts are off.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numba import njit, typeof, types
from numba.core.caching import NullCache
from numba.core.codegen import AOTCodeLibrary, AOTCPUCodegen
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target

COMPILE_FLAGS = {"_nrt": False, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class _RecordedLibrary(AOTCodeLibrary):  # type: ignore[misc]
    """A library that keeps its modules as text and optimises nothing."""

    texts: list[str]  # of all libraries of one recording

    def add_ir_module(self, module: Any) -> None:
        self.texts.append(str(module))
        super().add_ir_module(module)

    def _optimize_functions(self, module: Any) -> None:
        pass

    def _optimize_final_module(self) -> None:
        pass

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    def enable_object_caching(self) -> None:
        pass


class _RecordingCodegen(AOTCPUCodegen):  # type: ignore[misc]
    _library_class = _RecordedLibrary

    def set_env(self, name: str, environment: Any) -> None:
        pass


@contextmanager
def recording() -> Iterator[list[str]]:
    """Record functions that are compiled in this context, instead of compiling them.

    Yields the texts of all modules so far.
    """
    dispatchers: list[Any] = [item for item in gc.get_objects() if isinstance(item, Dispatcher)]
    for dispatcher in dispatchers:
        dispatcher._reset_overloads()
        dispatcher.overloads.clear()
        dispatcher._cache = NullCache()
        dispatcher.targetoptions["error_model"] = COMPILE_FLAGS["error_model"]
    context = cpu_target.target_context
    before = context._internal_codegen, context.cached_internal_func
    texts: list[str] = []
    _RecordedLibrary.texts = texts
    context._internal_codegen, context.cached_internal_func = _RecordingCodegen("palpate"), {}
    try:
        yield texts
    finally:
        context._internal_codegen, context.cached_internal_func = before


class LoweredFunction:
    """A compiled function whose modules were recorded; the exported symbol ends in `name`.

    Its arguments are arrays, numbers, and tuples of them. Numbers become constants of the library. `leaves` are the
    flat arguments: an array in place of its address, numbers, or None for null pointers.

    `callee` is the symbol of the function in the recorded modules. It has the calling convention of Numba: addresses of
    the result and of an exception, then the flat arguments. It returns a status.
    """

    def __init__(self, name: str, function: Any, arguments: Sequence[Any]) -> None:
        kinds = tuple(typeof(argument) for argument in arguments)
        options = {key: value for key, value in function.targetoptions.items() if key == "fastmath"}
        compiled = njit(**options, **COMPILE_FLAGS)(function.py_func)
        compiled.compile(kinds)
        result = compiled.overloads[kinds]
        self.name, self.callee = name, result.fndesc.llvm_func_name
        self.function_type = result.target_context.call_conv.get_function_type(result.signature.return_type, kinds)
        self.leaves = [leaf for value, kind in zip(arguments, kinds, strict=True) for leaf in _flat(value, kind)]
        expected = len(self.function_type.args) - 2
        if len(self.leaves) != expected:
            raise RuntimeError(f"{name} must have {expected} flat arguments, got {len(self.leaves)}; use another Numba")


def _flat(value: Any, kind: Any) -> Iterator[Any]:
    """Flatten an argument as Numba does."""
    if isinstance(kind, types.Array):
        yield from (None, None, int(value.size), int(value.itemsize), np.asarray(value))
        yield from map(int, value.shape)
        yield from map(int, value.strides)
    elif isinstance(kind, types.BaseTuple):
        for item, item_kind in zip(value, kind.types, strict=True):
            yield from _flat(item, item_kind)
    else:
        yield value
