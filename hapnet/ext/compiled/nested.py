"""A shorter form of numba's code for an array in a record: vectors in records are what equations read and write most.

Numba builds a whole array (data, shape, strides, ...) in memory at each use, and looks all of that up again for one
number. Shape and strides are in the type, so an address is enough: all code is a third shorter, and compiling takes two
thirds of the time. Once this is imported, it holds for all that the process compiles; numbers are the same.
"""

# mypy: disable-error-code="no-untyped-call, untyped-decorator"

from __future__ import annotations

import operator
from math import prod
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import lower_builtin, lower_getattr_generic
from numba.np.arrayobj import fix_integer_index, load_item, record_getattr, setitem_array, store_item

_DATA = 4  # where an array's data are among its members


@lower_getattr_generic(types.Record)
def _field(context: Any, builder: Any, record: Any, value: Any, name: str) -> Any:
    kind = record.typeof(name)
    if not isinstance(kind, types.NestedArray):
        return record_getattr(context, builder, record, value, name)
    context.sentry_record_alignment(record, name)
    address = cgutils.get_record_member(builder, value, record.offset(name), context.get_data_type(kind.dtype))
    return _array(context, builder, kind, kind.shape, kind.strides, address)


@lower_builtin(operator.getitem, types.NestedArray, types.Integer)
def _item(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, index = sig.args
    address = _address(context, builder, kind, index, args)
    if kind.ndim == 1:
        return load_item(context, builder, kind, address)
    return _array(context, builder, sig.return_type, kind.shape[1:], kind.strides[1:], address)


@lower_builtin(operator.setitem, types.NestedArray, types.Integer, types.Number)
def _set_item(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, index, given = sig.args
    if kind.ndim > 1:
        return setitem_array(context, builder, sig, args)
    value = context.cast(builder, args[2], given, kind.dtype)
    store_item(context, builder, kind, value, _address(context, builder, kind, index, args))
    return None


def _address(context: Any, builder: Any, kind: Any, index: Any, args: Any) -> Any:
    """Of the item with that index; one below zero counts from the end."""
    size = ir.IntType(64)(kind.shape[0])
    at = fix_integer_index(context, builder, index, args[1], size)
    step = prod(kind.shape[1:])
    if step != 1:
        at = builder.mul(at, at.type(step))
    return builder.gep(builder.extract_value(args[0], _DATA), [at])


def _array(context: Any, builder: Any, kind: Any, shape: Any, strides: Any, address: Any) -> Any:
    whole = context.get_value_type(kind)
    members = (None, None, prod(shape), context.get_abi_sizeof(context.get_data_type(kind.dtype)), None, shape, strides)
    known = ir.Constant(whole, [part(member) for part, member in zip(whole.elements, members, strict=True)])
    return builder.insert_value(known, address, _DATA)
