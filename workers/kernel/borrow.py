"""Borrowed arrays, which the compiler does not reference-count, and rows of batches of records.

A record is a named tuple of arrays. A batch of records is one record with one more leading axis in each field, and a
row of the batch is one of its records.

Reference counting takes several nanoseconds for every array that a kernel receives or reads from a record. The dozens
of arrays of one cell would cost as much time as its flights. The caller keeps all arrays alive, so counting is not
needed. The compiler sees a borrowed array only in the kernel that borrows it. Each hot kernel therefore borrows its
arrays, even arrays passed by reference.
"""

from typing import Any, TypeVar

from numba import types
from numba.core.cgutils import alloca_once, create_struct_proxy, get_null_value, pointer_add, unpack_tuple
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import make_array, populate_array

from workers.model.oscillator import map_fields

__all__ = ["borrow", "many_type", "many_value", "row_of", "row_type", "row_value", "without_counts"]

Given = TypeVar("Given")


def borrow(value: Given) -> Given:
    """Return the same array or record; in kernels it is not reference-counted and must not outlive its memory."""
    return value


@type_callable(borrow)
def _typed(context: Any) -> Any:
    return lambda value: value


@lower_builtin(borrow, types.Any)
def _compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return without_counts(context, builder, signature.return_type, arguments[0])


def without_counts(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Return an LLVM value of the Numba type ``kind`` whose arrays are not reference-counted."""
    if isinstance(kind, types.BaseTuple):
        parts: Any = enumerate(kind)  # type: ignore[arg-type]
        fields = [without_counts(context, builder, part, builder.extract_value(value, i)) for i, part in parts]
        return context.make_tuple(builder, kind, fields)
    if not isinstance(kind, types.Array):
        return value
    view = create_struct_proxy(kind)(context, builder, value=value)
    view.meminfo = get_null_value(view.meminfo.type)
    return view._getvalue()


def row_of(record: Given, r: int) -> Given:
    """Return record r of a batch of records, a named tuple whose fields all have one more leading axis.

    Kernels borrow the record and pass it by reference, see ``by_reference.py``.
    """
    row: Given = map_fields(record, lambda field: field[r])
    return row


def row_type(kind: Any) -> Any:
    """Return the Numba type of one record of a batch of records of type ``kind``: each array has one axis less."""
    if isinstance(kind, types.NamedTuple):
        return types.NamedTuple([row_type(field) for field in kind], kind.instance_class)
    if isinstance(kind, types.Array):
        return kind.dtype if kind.ndim == 1 else kind.copy(ndim=kind.ndim - 1)
    return kind


def row_value(context: Any, builder: Any, kind: Any, value: Any, r: Any) -> Any:
    """Return the LLVM value of record r of a batch of records ``value`` of the Numba type ``kind``."""
    if isinstance(kind, types.NamedTuple):
        fields = [row_value(context, builder, part, builder.extract_value(value, i), r) for i, part in enumerate(kind)]
        return context.make_tuple(builder, row_type(kind), fields)
    if not isinstance(kind, types.Array):
        return value
    many = make_array(kind)(context, builder, value)
    shape, strides = unpack_tuple(builder, many.shape), unpack_tuple(builder, many.strides)
    address = pointer_add(builder, many.data, builder.mul(r, strides[0]))
    if kind.ndim == 1:
        return context.unpack_value(builder, kind.dtype, address)
    row = make_array(row_type(kind))(context, builder)
    populate_array(row, address, shape[1:], strides[1:], many.itemsize, meminfo=None)
    return row._getvalue()


def many_type(kind: Any) -> Any:
    """Return the Numba type of a batch of records of type ``kind``: each array has one more axis.

    Inverse of ``row_type``.
    """
    if isinstance(kind, types.NamedTuple):
        return types.NamedTuple([many_type(field) for field in kind], kind.instance_class)
    if isinstance(kind, types.Array):
        return kind.copy(ndim=kind.ndim + 1)
    return types.Array(kind, 1, "C") if isinstance(kind, types.Number | types.Boolean) else kind


def many_value(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Return the LLVM value of a batch with one record, in the memory of the record ``value``.

    ``kind`` is the Numba type of the record. Numbers of the record are copied to the stack frame of the caller.
    """
    if isinstance(kind, types.NamedTuple):
        fields = [many_value(context, builder, part, builder.extract_value(value, i)) for i, part in enumerate(kind)]
        return context.make_tuple(builder, many_type(kind), fields)
    if not isinstance(kind, types.Array | types.Number | types.Boolean):
        return value
    many, one = make_array(many_type(kind))(context, builder), context.get_constant(types.intp, 1)
    if isinstance(kind, types.Array):
        row = make_array(kind)(context, builder, value)
        shape, strides = unpack_tuple(builder, row.shape), unpack_tuple(builder, row.strides)
        address, size, length = row.data, row.itemsize, builder.mul(row.nitems, row.itemsize)
    else:
        address = alloca_once(builder, context.get_data_type(kind))
        context.pack_value(builder, kind, value, address)
        shape, strides = [], []
        size = length = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind)))
    populate_array(many, address, [one, *shape], [length, *strides], size, meminfo=None)
    return many._getvalue()
