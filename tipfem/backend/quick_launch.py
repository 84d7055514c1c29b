"""A kept kernel started by one call of machine code, which reads its arguments as they lie in Python's memory.

To look at each argument in Python takes longer than many kernels run. So a kernel that was prepared for some arguments
has a plan: for each argument, of what type it must be, and where the kernel expects its value. Machine code compares a
tuple of arguments with the plan, puts numbers, addresses and shapes in their places, and calls the kernel. Where an
argument is not what the plan says, it calls nothing, and `launch` goes the longer way, which tells errors, too.

This depends on how CPython and NumPy lay out tuples, numbers and arrays; `layout_is_known` compares examples.
"""

import ctypes
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

SAME, INTEGER, REAL, SINGLE, ARRAY = range(5)
KINDS = {"i32": INTEGER, "f64": REAL, "f32": SINGLE}
# Offsets in bytes: of an object's type; a tuple's length and items; a float; an array's fields; a type's number.
_TYPE, _LENGTH, _ITEMS, _FLOAT = 8, 16, 24, 16
_DATA, _NDIM, _SHAPE, _DTYPE, _FLAGS, _NUMBER = 16, 24, 32, 56, 64, 28
_CONTIGUOUS = 0x1  # in C's order


class _Entry(ctypes.Structure):
    _fields_ = (
        ("kind", ctypes.c_int32),
        ("number", ctypes.c_int32),  # of the array's type
        ("ndim", ctypes.c_int64),
        ("expected", ctypes.c_uint64),  # the object, if it must be the same one
        ("value", ctypes.c_uint64),  # where the number goes, or the array's address
        ("shape", ctypes.c_uint64),  # where the array's shape goes
    )


class _Head(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_int64),
        ("integer", ctypes.c_uint64),  # types that numbers and arrays may have
        ("truth", ctypes.c_uint64),
        ("real", ctypes.c_uint64),
        ("real_of_numpy", ctypes.c_uint64),
        ("array", ctypes.c_uint64),
        ("as_integer", ctypes.c_uint64),  # a function of Python
        ("kernel", ctypes.c_uint64),
        ("context", ctypes.c_uint64),
    )


TEXT = f"""
define internal i64 @word(i64 %base, i64 %offset) {{
  %at = add i64 %base, %offset
  %place = inttoptr i64 %at to i64*
  %value = load i64, i64* %place, align 8
  ret i64 %value
}}

define internal i32 @half(i64 %base, i64 %offset) {{
  %at = add i64 %base, %offset
  %place = inttoptr i64 %at to i32*
  %value = load i32, i32* %place, align 4
  ret i32 %value
}}

define i32 @quick_launch(i64 %tuple, i64 %plan) {{
  %length = call i64 @word(i64 %tuple, i64 {_LENGTH})
  %count = call i64 @word(i64 %plan, i64 0)
  %fits = icmp eq i64 %length, %count
  br i1 %fits, label %head, label %other
head:
  %k = phi i64 [ 0, %0 ], [ %next, %done ]
  %more = icmp slt i64 %k, %count
  br i1 %more, label %look, label %run
look:
  %skip = mul i64 %k, 8
  %items = add i64 %tuple, {_ITEMS}
  %item = call i64 @word(i64 %items, i64 %skip)
  %type = call i64 @word(i64 %item, i64 {_TYPE})
  %skipped = mul i64 %k, {ctypes.sizeof(_Entry)}
  %entries = add i64 %plan, {ctypes.sizeof(_Head)}
  %entry = add i64 %entries, %skipped
  %kind = call i32 @half(i64 %entry, i64 0)
  %value = call i64 @word(i64 %entry, i64 {_Entry.value.offset})
  switch i32 %kind, label %other [
    i32 {SAME}, label %same
    i32 {INTEGER}, label %integer
    i32 {REAL}, label %real
    i32 {SINGLE}, label %real
    i32 {ARRAY}, label %array
  ]
same:
  %expected = call i64 @word(i64 %entry, i64 {_Entry.expected.offset})
  %is_same = icmp eq i64 %item, %expected
  br i1 %is_same, label %done, label %other
integer:
  %integer_type = call i64 @word(i64 %plan, i64 {_Head.integer.offset})
  %is_whole = icmp eq i64 %type, %integer_type
  %truth_type = call i64 @word(i64 %plan, i64 {_Head.truth.offset})
  %is_truth = icmp eq i64 %type, %truth_type
  %is_integer = or i1 %is_whole, %is_truth
  br i1 %is_integer, label %put_integer, label %other
put_integer:
  %as_word = call i64 @word(i64 %plan, i64 {_Head.as_integer.offset})
  %as_integer = inttoptr i64 %as_word to i64 (i64)*
  %wide = call i64 %as_integer(i64 %item)
  %narrow = trunc i64 %wide to i32
  %integer_place = inttoptr i64 %value to i32*
  store i32 %narrow, i32* %integer_place, align 4
  br label %done
real:
  %real_type = call i64 @word(i64 %plan, i64 {_Head.real.offset})
  %numpy_type = call i64 @word(i64 %plan, i64 {_Head.real_of_numpy.offset})
  %is_real = icmp eq i64 %type, %real_type
  %is_numpy = icmp eq i64 %type, %numpy_type
  %is_either = or i1 %is_real, %is_numpy
  br i1 %is_either, label %put_real, label %other
put_real:
  %float_at = add i64 %item, {_FLOAT}
  %float_place = inttoptr i64 %float_at to double*
  %float = load double, double* %float_place, align 8
  %is_single = icmp eq i32 %kind, {SINGLE}
  br i1 %is_single, label %put_single, label %put_double
put_single:
  %single = fptrunc double %float to float
  %single_place = inttoptr i64 %value to float*
  store float %single, float* %single_place, align 4
  br label %done
put_double:
  %double_place = inttoptr i64 %value to double*
  store double %float, double* %double_place, align 8
  br label %done
array:
  %array_type = call i64 @word(i64 %plan, i64 {_Head.array.offset})
  %is_array = icmp eq i64 %type, %array_type
  br i1 %is_array, label %examine, label %other
examine:
  %flags = call i32 @half(i64 %item, i64 {_FLAGS})
  %masked = and i32 %flags, {_CONTIGUOUS}
  %is_contiguous = icmp ne i32 %masked, 0
  %dtype = call i64 @word(i64 %item, i64 {_DTYPE})
  %number = call i32 @half(i64 %dtype, i64 {_NUMBER})
  %wanted = call i32 @half(i64 %entry, i64 {_Entry.number.offset})
  %is_of_type = icmp eq i32 %number, %wanted
  %narrow_ndim = call i32 @half(i64 %item, i64 {_NDIM})
  %ndim = zext i32 %narrow_ndim to i64
  %axes = call i64 @word(i64 %entry, i64 {_Entry.ndim.offset})
  %has_axes = icmp eq i64 %ndim, %axes
  %both = and i1 %is_contiguous, %is_of_type
  %all = and i1 %both, %has_axes
  br i1 %all, label %put_array, label %other
put_array:
  %data = call i64 @word(i64 %item, i64 {_DATA})
  %data_place = inttoptr i64 %value to i64*
  store i64 %data, i64* %data_place, align 8
  %lengths = call i64 @word(i64 %item, i64 {_SHAPE})
  %shape = call i64 @word(i64 %entry, i64 {_Entry.shape.offset})
  br label %axis
axis:
  %j = phi i64 [ 0, %put_array ], [ %following, %put_axis ]
  %left = icmp slt i64 %j, %axes
  br i1 %left, label %put_axis, label %done
put_axis:
  %from = mul i64 %j, 8
  %extent = call i64 @word(i64 %lengths, i64 %from)
  %small = trunc i64 %extent to i32
  %to = mul i64 %j, 4
  %axis_at = add i64 %shape, %to
  %axis_place = inttoptr i64 %axis_at to i32*
  store i32 %small, i32* %axis_place, align 4
  %following = add i64 %j, 1
  br label %axis
done:
  %next = add i64 %k, 1
  br label %head
run:
  %kernel_word = call i64 @word(i64 %plan, i64 {_Head.kernel.offset})
  %kernel = inttoptr i64 %kernel_word to void (i8*)*
  %context_word = call i64 @word(i64 %plan, i64 {_Head.context.offset})
  %context = inttoptr i64 %context_word to i8*
  call void %kernel(i8* %context)
  ret i32 0
other:
  ret i32 1
}}
"""


def layout_is_known() -> bool:
    """Whether this interpreter and NumPy lay out objects as `TEXT` expects them."""
    if sys.implementation.name != "cpython" or not getattr(sys, "_is_gil_enabled", lambda: True)():
        return False
    array, real = np.arange(6.0).reshape(2, 3), 0.1

    def word(at: int) -> int:
        return ctypes.c_uint64.from_address(at).value

    def half(at: int) -> int:
        return ctypes.c_int32.from_address(at).value

    example = (array, real, np.float64(0.2))
    at = id(array)
    return (
        [word(id(each) + _TYPE) for each in example] == [id(type(each)) for each in example]
        and word(id(example) + _LENGTH) == len(example)
        and [word(id(example) + _ITEMS + 8 * k) for k in range(3)] == [id(each) for each in example]
        and [ctypes.c_double.from_address(id(each) + _FLOAT).value for each in example[1:]] == [0.1, 0.2]
        and (word(at + _DATA), half(at + _NDIM)) == (array.ctypes.data, 2)
        and [word(word(at + _SHAPE) + 8 * k) for k in range(2)] == [2, 3]
        and word(at + _DTYPE) == id(array.dtype)
        and half(id(array.dtype) + _NUMBER) == array.dtype.num
        and [half(id(each) + _FLAGS) & _CONTIGUOUS for each in (array, array.T)] == [1, 0]
    )


class Plan:
    """Pattern that `TEXT` compares a tuple of arguments with, as it was prepared for them.

    For each of them ``places`` has where its value goes, None if it must be the very same object: the kind of a number
    and its address, or `ARRAY`, the address of the array's address, and that of its shape. ``kernel`` is the address of
    the machine code, ``context`` of what it is given, ``at`` of the plan.
    """

    def __init__(
        self, arguments: Sequence[Any], places: Sequence[tuple[int, int, int] | None], kernel: int, context: int
    ) -> None:
        count = len(arguments)
        self._memory = (ctypes.c_uint8 * (ctypes.sizeof(_Head) + count * ctypes.sizeof(_Entry)))()
        as_integer = ctypes.cast(ctypes.pythonapi.PyLong_AsUnsignedLongMask, ctypes.c_void_p).value
        types = (id(kind) for kind in (int, bool, float, np.float64, np.ndarray))
        _Head.from_buffer(self._memory).__init__(count, *types, as_integer, kernel, context)  # type: ignore[misc]
        entries = (_Entry * count).from_buffer(self._memory, ctypes.sizeof(_Head))
        for entry, argument, place in zip(entries, arguments, places, strict=True):
            if place is None:
                entry.kind, entry.expected = SAME, id(argument)
                continue
            entry.kind, entry.value, entry.shape = place
            if entry.kind == ARRAY:
                entry.number, entry.ndim = argument.dtype.num, argument.ndim
        self.at = ctypes.addressof(self._memory)
