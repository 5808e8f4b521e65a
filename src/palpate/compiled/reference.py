"""References: large records of compiled code that functions pass by their address.

Numba passes a named tuple by value: every number in it, and every field of every array in it, is an argument. A
function that only hands on a record of a thousand of them takes seconds to compile. A reference is one argument, and
its attributes are those of the record; a field that is a named tuple is a reference, too.

Python passes a `StoredRecord`: a copy of the numbers and of the addresses of the arrays, in the layout of compiled
code.
"""

from __future__ import annotations

import struct
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.core.cgutils import alloca_once_value, gep_inbounds
from numba.core.datamodel import models, register_default
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.core.registry import cpu_target
from numba.core.types.containers import BaseNamedTuple, BaseTuple
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, typeof_impl, unbox


class Reference(types.Type):
    """Type of the address of a named tuple."""

    def __init__(self, record: Any) -> None:
        self.record = record
        super().__init__(f"Reference({record})")


@register_default(Reference)
class _ReferenceModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Reference) -> None:
        super().__init__(manager, kind, manager.lookup(kind.record).get_value_type().as_pointer())


@infer_getattr
class _ReferenceAttributes(AttributeTemplate):  # type: ignore[misc]
    key = Reference

    def generic_resolve(self, kind: Reference, name: str) -> Any:
        fields = kind.record.fields
        if name not in fields:
            return None
        field = kind.record[fields.index(name)]
        return Reference(field) if isinstance(field, BaseNamedTuple) else field


@lower_getattr_generic(Reference)
def _read_field(context: Any, builder: Any, kind: Reference, address: Any, name: str) -> Any:
    index = kind.record.fields.index(name)
    place = gep_inbounds(builder, address, 0, index)
    if isinstance(kind.record[index], BaseNamedTuple):
        return place
    value = builder.load(place)
    return impl_ret_borrowed(context, builder, kind.record[index], value)  # the record keeps its arrays


@intrinsic
def reference(typing_context, record):
    """Return a reference of a named tuple, for calls from the present compiled function.

    The record is copied to the stack of that function, so that a reference must not outlive it. Arrays are not copied.
    A reference is returned as it is.
    """
    if isinstance(record, Reference):
        return record(record), lambda context, builder, signature, arguments: arguments[0]

    def copy_to_stack(context, builder, signature, arguments):
        return alloca_once_value(builder, arguments[0])

    return Reference(record)(record), copy_to_stack


class _Memory(bytearray):
    """Bytes that keep the arrays to which they have addresses."""

    record: Any


class StoredRecord:
    """A named tuple of arrays, numbers and tuples of these, that Python passes to compiled code by its address.

    Arrays are shared with the record; numbers are copied. `memory` (bytes) has the layout of compiled code.
    """

    def __init__(self, record: Any) -> None:
        self.record, self.kind = record, numba.typeof(record)
        memory = _Memory()
        memory.record = record
        context = cpu_target.target_context
        _append(memory, context, self.kind, record)
        expected = context.get_abi_sizeof(context.get_value_type(self.kind))
        if not isinstance(self.kind, BaseNamedTuple) or len(memory) != expected:
            raise TypeError(f"record must be a named tuple of {expected} bytes, got {self.kind} of {len(memory)} bytes")
        self.memory = np.frombuffer(memory, dtype=np.uint8)
        self.address, self.numba_type = self.memory.ctypes.data, Reference(self.kind)


def _append(memory: bytearray, context: Any, kind: Any, value: Any) -> None:
    """Append a value in the layout of its type: fields one after the other, each aligned as its type requires."""
    if isinstance(kind, BaseTuple):
        alignment = context.get_abi_alignment(context.get_value_type(kind)) if len(kind) else 1
        memory += bytes(-len(memory) % alignment)
        for each, part in zip(kind, value, strict=True):
            _append(memory, context, each, part)
        memory += bytes(-len(memory) % alignment)
        return
    if isinstance(kind, types.Array):  # no reference count and no parent; the record keeps the array
        numbers = 0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides
        packed, size = struct.pack(f"={len(numbers)}q", *numbers), 8
    elif kind in (types.float64, types.int64):
        packed, size = struct.pack("=d" if kind == types.float64 else "=q", value), 8
    elif kind == types.boolean:
        packed, size = struct.pack("=?", value), 1
    else:
        raise TypeError(f"fields of a record must be arrays, float64, int64, bool or tuples, got {kind}")
    memory += bytes(-len(memory) % size) + packed


@typeof_impl.register(StoredRecord)
def _type_of_record(value: StoredRecord, context: Any) -> Reference:
    return value.numba_type


@unbox(Reference)
def _address_of_record(kind: Reference, value: Any, c: Any) -> NativeValue:
    number = c.pyapi.object_getattr_string(value, "address")
    address = c.builder.inttoptr(c.pyapi.long_as_ulonglong(number), c.context.get_value_type(kind))
    c.pyapi.decref(number)
    return NativeValue(address)
