"""What Numba does not offer by itself: operations of the processor, and a hint to the compiler."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic, lower_builtin, overload, type_callable

from tasklift.tasks import choice


def _lowest_bit(context: Any, word: Any) -> Any:
    """Return the number of the lowest bit that is set in a uint64 other than 0."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.uint64(types.uint64), build


def _count_eight(context: Any, rising: Any, first: Any, target: Any) -> Any:
    """Return :func:`tasklift.tasks.choice.at_or_below` by one comparison of eight numbers."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        eight, array = ir.VectorType(ir.DoubleType(), 8), context.make_array(signature.args[0])
        start = builder.gep(array(context, builder, arguments[0]).data, [arguments[1]])
        numbers = builder.load(builder.bitcast(start, eight.as_pointer()), align=8)
        one = builder.insert_element(ir.Constant(eight, ir.Undefined), arguments[2], ir.Constant(ir.IntType(32), 0))
        same = builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), 8), [0] * 8))
        above = builder.bitcast(builder.fcmp_unordered(">", numbers, same), ir.IntType(8))
        bits = builder.or_(builder.zext(above, ir.IntType(64)), ir.Constant(ir.IntType(64), 256))
        return builder.cttz(bits, ir.Constant(ir.IntType(1), 1))

    return types.int64(rising, types.int64, types.float64), build


def _take_next(context: Any, counter: Any) -> Any:
    """Return the number in an int64 (1,) and raise it by one, so that no two threads get the same."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])
        number = array(context, builder, arguments[0]).data
        return builder.atomic_rmw("add", number, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), build


lowest_bit: Any = intrinsic(_lowest_bit)
take_next: Any = intrinsic(_take_next)
_eight: Any = intrinsic(_count_eight)


@overload(choice.at_or_below)
def _at_or_below(rising, first, target):  # type: ignore[no-untyped-def]
    return lambda rising, first, target: _eight(rising, first, target)


@type_callable(choice.rarely)
def _type_of_rarely(context):  # type: ignore[no-untyped-def]
    return lambda condition: types.boolean


@lower_builtin(choice.rarely, types.boolean)
def _expected_false(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    bit = ir.IntType(1)
    expect = get_or_insert_function(builder.module, ir.FunctionType(bit, [bit, bit]), "llvm.expect.i1")
    return builder.call(expect, [arguments[0], ir.Constant(bit, 0)])
