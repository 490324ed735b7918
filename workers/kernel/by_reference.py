"""Passing records and arrays between kernels by reference: one pointer instead of the 200 words of an oscillator.

A record is a named tuple of arrays and numbers. Numba passes it by value, field by field. The Numba types here
represent a record by its address. The caller keeps the arrays alive. References are not counted (see ``borrow.py``) and
are valid as long as the function that created them. No function may return one. In plain Python ``by_reference`` and
``by_value`` return their argument.
"""

from typing import Any, TypeVar

from numba import types
from numba.core.cgutils import alloca_once_value, create_struct_proxy
from numba.core.datamodel import models
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, lower_builtin, lower_getattr_generic, register_model, type_callable

from workers.kernel.borrow import many_type, many_value, row_of, row_type, row_value, without_counts
from workers.model.oscillator import many_of

__all__ = [
    "as_many",
    "by_reference",
    "by_value",
    "make_reference",
    "row_in",
    "type_by_reference",
    "with_phase",
    "without_mode_table",
]

Given = TypeVar("Given")


def by_reference(value: Given) -> Given:
    """Return the same record, a named tuple. In kernels its address is passed on; its fields are read as before."""
    return value


def row_in(record: Given, r: int) -> Given:
    """Return record r of a batch of records, a named tuple whose fields have one more leading axis, by reference.

    Its fields are loaded when they are used, which suits large records.
    """
    return row_of(record, r)


def as_many(record: Given) -> Given:
    """Return a batch of records that has this record as its only row, in the same memory; kernels pass it by reference.

    Kernels that take a batch and a row number, and the functions of ``external.py``, accept the result.
    """
    return many_of(record)


def by_value(value: Given) -> Given:
    """Return the same record or array; in kernels, undo ``by_reference``."""
    return value


def with_phase(oscillator: Any, tau: Any) -> Any:
    """Return the oscillator with another forcing phase ``tau`` at its section; kernels pass it by reference.

    The section is the instant, once a period, at which motions start.
    """
    return oscillator._replace(tau=tau)


def without_mode_table(oscillators: Any) -> Any:
    """Return a batch of oscillators without its last field, the table of their modes (sets of linear equations).

    Machines with one rigid contact have an empty table, and kernels read rows of the batch faster without it. The batch
    is passed by reference.
    """
    return oscillators


class RecordRef(types.Type):
    """Numba type of a record or array of type ``kind`` that is represented by its address."""

    def __init__(self, kind: types.Type) -> None:
        self.kind: Any = kind
        super().__init__(f"Reference({kind})")


def type_by_reference(kind: Any) -> Any:
    """Return the Numba type for passing a value of type ``kind`` by reference. Records and arrays become an address.

    Numbers stay as they are.
    """
    return RecordRef(kind) if isinstance(kind, types.BaseTuple | types.Array) else kind


class RowRef(types.Type):
    """Numba type of one record of a batch of records of type ``kind``, by the batch's address and a row number."""

    def __init__(self, kind: types.Type) -> None:
        self.kind: Any = kind
        super().__init__(f"RowReference({kind})")


@register_model(RecordRef)
class _RecordRefModel(models.PrimitiveModel):
    def __init__(self, manager: Any, reference: RecordRef) -> None:
        super().__init__(manager, reference, manager.lookup(reference.kind).get_value_type().as_pointer())


@infer_getattr
class _RecordRefAttributes(AttributeTemplate):
    key = RecordRef

    def generic_resolve(self, reference: RecordRef, name: str) -> Any:  # type: ignore[override]
        fields = getattr(reference.kind, "fields", ())
        if name not in fields:
            return None
        field = reference.kind[fields.index(name)]
        return RecordRef(field) if isinstance(field, types.BaseTuple) else field


@lower_getattr_generic(RecordRef)
def _attribute(context: Any, builder: Any, reference: RecordRef, address: Any, name: str) -> Any:
    index = reference.kind.fields.index(name)
    at = builder.gep(address, [context.get_constant(types.int32, part) for part in (0, index)], inbounds=True)
    field = reference.kind[index]
    return at if isinstance(field, types.BaseTuple) else without_counts(context, builder, field, builder.load(at))


@register_model(RowRef)
class _RowRefModel(models.StructModel):
    def __init__(self, manager: Any, row: RowRef) -> None:
        super().__init__(manager, row, [("record", RecordRef(row.kind)), ("number", types.intp)])


@infer_getattr
class _RowRefAttributes(AttributeTemplate):
    key = RowRef

    def generic_resolve(self, row: RowRef, name: str) -> Any:  # type: ignore[override]
        if name not in row.kind.fields:
            return None
        field = row.kind[row.kind.fields.index(name)]
        return RowRef(field) if isinstance(field, types.BaseTuple) else row_type(field)


@lower_getattr_generic(RowRef)
def _row_attribute(context: Any, builder: Any, row: RowRef, value: Any, name: str) -> Any:
    proxy = create_struct_proxy(row)(context, builder, value=value)
    index = row.kind.fields.index(name)
    at = builder.gep(proxy.record, [context.get_constant(types.int32, part) for part in (0, index)], inbounds=True)
    field = row.kind[index]
    if isinstance(field, types.BaseTuple):
        return _row_at(context, builder, RowRef(field), at, proxy.number)
    return row_value(context, builder, field, builder.load(at), proxy.number)


def _row_at(context: Any, builder: Any, row: RowRef, record: Any, number: Any) -> Any:
    """Return the LLVM value of record ``number`` of the batch at the address ``record``; its Numba type is ``row``."""
    proxy = create_struct_proxy(row)(context, builder)
    proxy.record, proxy.number = record, number
    return proxy._getvalue()


@type_callable(row_in)
def _row_in_typed(context: Any) -> Any:
    return lambda record, r: RowRef(record.kind) if isinstance(record, RecordRef) else None


@lower_builtin(row_in, types.Any, types.Integer)
def _row_in_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    number = context.cast(builder, arguments[1], signature.args[1], types.intp)
    return _row_at(context, builder, signature.return_type, arguments[0], number)


@type_callable(as_many)
def _as_many_typed(context: Any) -> Any:
    return lambda row: RecordRef(row.kind if isinstance(row, RowRef) else many_type(type_by_reference(row).kind))


@lower_builtin(as_many, types.Any)
def _as_many_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, value = signature.args[0], arguments[0]
    if isinstance(kind, RowRef):
        proxy = create_struct_proxy(kind)(context, builder, value=value)
        record, kind = builder.load(proxy.record), kind.kind
        value = row_value(context, builder, kind, record, proxy.number)
        kind = row_type(kind)
    else:
        kind, value = type_by_reference(kind).kind, given_value(builder, kind, value)
    return alloca_once_value(builder, many_value(context, builder, kind, value))


@type_callable(by_reference)
def _lend_typed(context: Any) -> Any:
    return lambda kind: type_by_reference(kind)


@lower_builtin(by_reference, types.Any)
def _lend_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return make_reference(context, builder, signature.args[0], arguments[0])


def given_value(builder: Any, kind: types.Type, value: Any) -> Any:
    """Return the LLVM value of a record or array of type ``kind``.

    If it is passed by reference, it is loaded from its address ``value``.
    """
    return builder.load(value) if isinstance(kind, RecordRef) else value


def make_reference(context: Any, builder: Any, kind: types.Type, value: Any) -> Any:
    """Return the LLVM value with which a value of type ``kind`` is passed by reference, see ``type_by_reference``."""
    return alloca_once_value(builder, value) if type_by_reference(kind) != kind else value


@type_callable(row_of)
def _row_typed(context: Any) -> Any:
    return lambda record, r: RecordRef(row_type(type_by_reference(record).kind))


@lower_builtin(row_of, types.Any, types.Integer)
def _row_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    record, r = given_value(builder, signature.args[0], arguments[0]), signature.args[1]
    r = context.cast(builder, arguments[1], r, types.intp)
    return alloca_once_value(builder, row_value(context, builder, type_by_reference(signature.args[0]).kind, record, r))


@type_callable(without_mode_table)
def _rigid_typed(context: Any) -> Any:
    def typer(oscillators: types.Type) -> RecordRef:
        kind = type_by_reference(oscillators).kind
        return RecordRef(types.NamedTuple([*kind.types[:-1], types.none], kind.instance_class))

    return typer


@lower_builtin(without_mode_table, types.Any)
def _rigid_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    address = make_reference(context, builder, signature.args[0], arguments[0])
    return builder.bitcast(address, context.get_value_type(signature.return_type))


@type_callable(with_phase)
def _phase_typed(context: Any) -> Any:
    return lambda osc, tau: type_by_reference(osc)


@lower_builtin(with_phase, types.Any, types.Float)
def _phase_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    osc = given_value(builder, signature.args[0], arguments[0])
    index = signature.return_type.kind.fields.index("tau")
    return alloca_once_value(builder, builder.insert_value(osc, arguments[1], index))


@type_callable(by_value)
def _whole_typed(context: Any) -> Any:
    return lambda kind: kind.kind if isinstance(kind, RecordRef) else kind


@lower_builtin(by_value, types.Any)
def _whole_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    value = given_value(builder, signature.args[0], arguments[0])
    return without_counts(context, builder, signature.return_type, value)
