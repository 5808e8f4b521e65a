"""Calls of a model's functions by their addresses, so that the engine's loop is compiled once for all models.

A loop that contained the step of a body would be compiled again, with all of that step, for each law and kind of body.
Instead it calls the step as C calls a function by a pointer: the functions and the data of a model are numbers in a
`ModelCalls`, whose type is that of every model.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import float64, intp, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.compiled.reference import StoredRecord
from palpate.core.arrays import Ints

FLOAT_VECTOR, FLOAT_MATRIX = float64[::1], float64[:, ::1]
ADVANCE_TYPES = FLOAT_VECTOR, FLOAT_VECTOR, FLOAT_VECTOR, float64, FLOAT_VECTOR  # q, v, target, period, report
STIFFNESS_TYPES = FLOAT_VECTOR, FLOAT_MATRIX  # q, out
ADVANCE_PLACE, STIFFNESS_PLACE = range(2)  # entries of `ModelCalls.functions`


class ModelCalls(NamedTuple):
    """Functions and data of a model, as addresses."""

    functions: Ints  # (2,) array: addresses of `advance` and `stiffness`; 0 for no stiffness
    memory: NDArray[np.uint8]  # the data in the layout of compiled code; keeps the arrays of the data


def model_calls(advance: Any, stiffness: Any, data: Any) -> ModelCalls:
    """Return the calls of compiled functions of palpate with a named tuple of arrays and numbers.

    All three are as those of `palpate.realtime.contract.Realtime`.
    """
    stored = StoredRecord(data)
    addresses = [_address(advance, stored, ADVANCE_TYPES), 0]
    if stiffness is not None:
        addresses[STIFFNESS_PLACE] = _address(stiffness, stored, STIFFNESS_TYPES)
    return ModelCalls(np.array(addresses), stored.memory)


def _address(function: Any, stored: StoredRecord, argument_types: tuple[Any, ...]) -> int:
    """Return the address of a function that is compiled for a record and arguments of some types."""
    signature = (stored.numba_type, *argument_types)
    function.compile(signature)
    compiled = function.overloads[signature]
    if compiled.signature.return_type != types.none:
        raise TypeError(f"{function.py_func.__qualname__} must return nothing, got {compiled.signature.return_type}")
    address = int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))
    if not address:
        raise RuntimeError(f"{function.py_func.__qualname__} must have an address, got none from Numba")
    return address


@intrinsic
def _call(typing_context, function, data, arguments):
    """Call the function at an address with the record at an address and a tuple of arguments; it returns nothing."""
    if tuple(arguments.types) not in (ADVANCE_TYPES, STIFFNESS_TYPES):
        raise TypingError(f"arguments must have the types of a model's functions, got {arguments}")
    argument_types = types.voidptr, *arguments.types

    def generate(context, builder, signature, values):
        address, record, packed = values
        convention = context.call_conv
        kind = convention.get_function_type(types.none, argument_types).as_pointer()
        place = builder.inttoptr(record, context.get_value_type(types.voidptr))
        call_arguments = [place, *cgutils.unpack_tuple(builder, packed, len(arguments))]
        status, _ = convention.call_function(
            builder, builder.inttoptr(address, kind), types.none, argument_types, call_arguments
        )
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.none(intp, intp, arguments), generate


@kernel_njit(inline="always")
def call_advance(calls, q, v, target, period, report):
    """Call `advance` of a model; see `palpate.realtime.contract.Realtime`."""
    _call(calls.functions[ADVANCE_PLACE], calls.memory.ctypes.data, (q, v, target, period, report))


@kernel_njit(inline="always")
def call_stiffness(calls, q, out):
    """Call `stiffness` of a model; see `palpate.realtime.contract.Realtime`."""
    _call(calls.functions[STIFFNESS_PLACE], calls.memory.ctypes.data, (q, out))
