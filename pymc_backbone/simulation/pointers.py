"""Bare pointers inside compiled code.

An array that numba hands to another function travels as seven numbers, a pointer as one: the integrator calls forces
so often that this matters. Whoever owns the array must keep it alive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from numba import types
from numba.core import cgutils
from numba.core.typing import signature
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

INTEGERS = types.CPointer(types.int64)
FLOATS = types.CPointer(types.float64)


class Floats(Protocol):
    """A bare pointer to numbers, to Python's type checker; compiled code knows it as `FLOATS`."""

    def __getitem__(self, index: int) -> float: ...
    def __setitem__(self, index: int, value: float) -> None: ...


class Integers(Protocol):
    """A bare pointer to integers, to Python's type checker; compiled code knows it as `INTEGERS`."""

    def __getitem__(self, index: int) -> int: ...
    def __setitem__(self, index: int, value: int) -> None: ...


if TYPE_CHECKING:
    # What the intrinsics below are to whoever calls them: numba's decorator hides it.
    from collections.abc import Callable
    from typing import overload

    from .._common.checks import FloatArray, IntArray

    @overload
    def address(array: IntArray) -> Integers: ...
    @overload
    def address(array: FloatArray) -> Floats: ...
    def address(array: Any) -> Any: ...  # noqa: D103
    def shifted[Pointer: (Floats, Integers)](pointer: Pointer, count: int) -> Pointer: ...  # noqa: D103
    def view(pointer: Floats, first: int, last: int) -> FloatArray: ...  # noqa: D103
    def matrix(pointer: Floats, rows: int, columns: int) -> FloatArray: ...  # noqa: D103
    def function_type(sig: Any) -> Callable[[int], Callable[..., float]]: ...  # noqa: D103

else:

    @intrinsic
    def address(typing_context: Any, array: Any) -> Any:
        """Return a pointer to the first element of a contiguous array."""

        def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
            return context.make_array(sig.args[0])(context, builder, arguments[0]).data

        return signature(types.CPointer(array.dtype), array), generate

    @intrinsic
    def shifted(typing_context: Any, pointer: Any, count: Any) -> Any:
        """Return the pointer ``count`` elements further on."""

        def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
            return builder.gep(arguments[0], [arguments[1]])

        return signature(pointer, pointer, types.int64), generate

    def _array(context: Any, builder: Any, kind: Any, data: Any, shape: list[Any]) -> Any:
        """Build an array that owns nothing."""
        array = context.make_array(kind)(context, builder)
        size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
        strides = [size] if len(shape) == 1 else [builder.mul(size, shape[1]), size]
        populate_array(
            array,
            data=data,
            shape=cgutils.pack_array(builder, shape),
            strides=cgutils.pack_array(builder, strides),
            itemsize=size,
            meminfo=None,
        )
        return array._getvalue()

    @intrinsic
    def view(typing_context: Any, pointer: Any, first: Any, last: Any) -> Any:
        """Return elements ``first`` to ``last`` (exclusive) as an array that owns nothing."""
        kind = types.Array(pointer.dtype, 1, "C")

        def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
            data, start, stop = arguments
            return _array(context, builder, kind, builder.gep(data, [start]), [builder.sub(stop, start)])

        return signature(kind, pointer, types.int64, types.int64), generate

    @intrinsic
    def matrix(typing_context: Any, pointer: Any, rows: Any, columns: Any) -> Any:
        """Return the elements behind ``pointer`` as a matrix that owns nothing."""
        kind = types.Array(pointer.dtype, 2, "C")

        def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
            data, height, width = arguments
            return _array(context, builder, kind, data, [height, width])

        return signature(kind, pointer, types.int64, types.int64), generate

    def function_type(sig: Any) -> Any:
        """Return an intrinsic that turns an address into a function of the given signature that can be called."""
        kind = types.FunctionType(sig)

        @intrinsic
        def function_at(typing_context: Any, number: Any) -> Any:
            def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
                function = cgutils.create_struct_proxy(kind)(context, builder)
                pointer = context.get_value_type(types.voidptr)
                function.c_addr = builder.inttoptr(arguments[0], pointer)
                function.py_addr = cgutils.get_null_value(pointer)
                function.jit_addr = cgutils.get_null_value(pointer)
                return function._getvalue()

            return signature(kind, types.int64), generate

        return function_at
