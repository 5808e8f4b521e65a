"""References: large records of compiled code that functions pass by their address.

Numba passes a named tuple by value: every number in it, and every field of every array in it, is an argument. A
function that only hands on a record of a thousand of them takes seconds to compile. A reference is one argument, and
its attributes are those of the record; a field that is a named tuple is a reference, too.
"""

from __future__ import annotations

from typing import Any

from numba.core import types
from numba.core.cgutils import alloca_once_value, gep_inbounds
from numba.core.datamodel import models, register_default
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.core.types.containers import BaseNamedTuple
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic

__all__ = ["reference"]


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
def reference(typing_context, record):  # type: ignore[no-untyped-def]
    """Return a reference of a named tuple, for calls from the present compiled function.

    The record is copied to the stack of that function, so that a reference must not outlive it. Arrays are not copied.
    A reference is returned as it is.
    """
    if isinstance(record, Reference):
        return record(record), lambda context, builder, signature, arguments: arguments[0]

    def copy_to_stack(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return alloca_once_value(builder, arguments[0])

    return Reference(record)(record), copy_to_stack
