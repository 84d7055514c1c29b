"""Checks of arguments that users pass: what counts as a number, an array of numbers, and a path.

Of these, only `path_of` raises: for the others the caller does, because it has the argument's name and its valid range.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import os
from collections.abc import Callable, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray


def is_number(value: Any) -> bool:
    """Whether ``value`` is one finite real number; strings, truth values and None are not."""
    if not isinstance(value, Real) or isinstance(value, bool | np.bool_):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond what a float can hold
        return False


def numbers(values: Any) -> NDArray[Any]:
    """``values`` as a new array of floats; one NaN of shape () if they are not an array of real numbers.

    Truth values count as 0 and 1. The NaN fails every check of shape or finiteness, so those checks refuse strings,
    None and ragged lists too.
    """
    try:
        array = np.array(values)
    except ValueError:  # rows of different lengths
        return np.array(math.nan)
    return array.astype(np.float64, copy=False) if array.dtype.kind in "biuf" else np.array(math.nan)


P = ParamSpec("P")
R = TypeVar("R")


def explained(hint: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator: calls with the wrong number of arguments report how, as the hint "say run(until=0.4)"."""

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def called(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                signature.bind(*args, **kwargs)
            except TypeError as error:
                raise TypeError(f"{function.__name__}: {error}; {hint}") from None
            return function(*args, **kwargs)

        return called

    return decorated


def rounded(values: Any) -> str:
    """Numbers for messages, with six digits: ``[0.315, 0.2]`` of an array of 0.31499999999999995 and 0.2."""
    array = np.asarray(values, dtype=float)
    return f"{float(array):.6g}" if array.ndim == 0 else f"[{', '.join(rounded(value) for value in array)}]"


def closest(word: str, choices: Sequence[str]) -> list[str]:
    """The choices that are close to a word: the closest first, and at most two that are nearly as close."""
    word, lower = word.lower(), {choice.lower(): choice for choice in reversed(choices)}
    found = difflib.get_close_matches(word, list(lower), 3, 0.65)
    near = [difflib.SequenceMatcher(None, choice, word).ratio() for choice in found]
    return [lower[choice] for choice, ratio in zip(found, near, strict=True) if ratio > near[0] - 0.1]


def meant(word: str, choices: Sequence[str]) -> str:
    """``; did you mean 'density'?`` where one of the choices is close to a word; else nothing."""
    return "".join(f"; did you mean {found!r}?" for found in closest(word, choices)[:1])


def brief(value: Any) -> str:
    """A value for messages, at most 60 characters of it."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def path_of(what: str, value: Any) -> Path:
    """A path that a user has given as ``what``, as "read_results: out"; `ValueError` if it is none, or empty."""
    if not isinstance(value, str | os.PathLike) or not str(value):
        raise ValueError(f"{what} is {value!r}; it must be a path, as text or a pathlib.Path")
    return Path(value)
