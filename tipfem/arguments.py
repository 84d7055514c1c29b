"""What a number is, and an array of numbers: the checks that every argument from outside passes.

Neither function raises: the caller does, for it knows what the argument is called and what would fit.
"""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import numpy as np


def is_number(value: Any) -> bool:
    """Whether ``value`` is one finite real number; texts, truth values and None are not."""
    if not isinstance(value, Real) or isinstance(value, bool | np.bool_):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond what a float can hold
        return False


def numbers(values: Any) -> np.ndarray:
    """``values`` as a new array of floats; one NaN of shape () for what is not an array of real numbers.

    Truth values count as 0 and 1.
    That NaN passes no check of shape or finiteness, so those checks refuse texts, None and ragged lists too.
    """
    try:
        array = np.array(values)
    except ValueError:  # rows of different lengths
        return np.array(math.nan)
    return array.astype(np.float64, copy=False) if array.dtype.kind in "biuf" else np.array(math.nan)
