"""Arrays that count no references, for as long as someone else keeps their memory.

A kernel counts every array that it is given, or takes out of a record, up and down again, in several nanoseconds each:
for the dozens that make one cell as long as its flights take. Who calls it keeps them all the while. The compiler sees
that nothing is to be counted only in the kernel that borrows: so each of the hot ones does, even what is lent already.
"""

from typing import Any, TypeVar

from numba import types
from numba.core.cgutils import create_struct_proxy, get_null_value
from numba.extending import lower_builtin, type_callable

__all__ = ["borrowed", "without_counts"]

Given = TypeVar("Given")


def borrowed(given: Given) -> Given:
    """The same array, or record of arrays; in kernels one that must not outlive those that keep its memory."""
    return given


@type_callable(borrowed)
def _typed(context: Any) -> Any:
    return lambda given: given


@lower_builtin(borrowed, types.Any)
def _compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return without_counts(context, builder, signature.return_type, arguments[0])


def without_counts(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """A value of this type whose arrays are known to no reference count."""
    if isinstance(kind, types.BaseTuple):
        parts: Any = enumerate(kind)  # type: ignore[arg-type]
        fields = [without_counts(context, builder, part, builder.extract_value(value, i)) for i, part in parts]
        return context.make_tuple(builder, kind, fields)
    if not isinstance(kind, types.Array):
        return value
    view = create_struct_proxy(kind)(context, builder, value=value)
    view.meminfo = get_null_value(view.meminfo.type)
    return view._getvalue()
