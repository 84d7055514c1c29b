"""Types of the demos' options: what is said on the command line is checked before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, TypeVar

from cyclopts import Parameter

from tipfem.app.options import Flag as Flag

T = TypeVar("T")


def positive(text: str) -> float:
    """A number > 0 from the command line.

    Raises:
        ValueError: it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{text!r} is not a number > 0")
    return value


def count(text: str) -> int:
    """A whole number > 0 from the command line.

    Raises:
        ValueError: it is none.
    """
    if not text.isdecimal() or int(text) < 1:
        raise ValueError(f"{text!r} is not a whole number > 0")
    return int(text)


def _positive(_type: Any, tokens: Sequence[Any]) -> float:
    return positive(tokens[0].value)


def _positives(_type: Any, tokens: Sequence[Any]) -> tuple[float, ...]:
    return tuple(positive(token.value) for token in tokens)


def _count(_type: Any, tokens: Sequence[Any]) -> int:
    return count(tokens[0].value)


def _counts(_type: Any, tokens: Sequence[Any]) -> tuple[int, ...]:
    return tuple(count(token.value) for token in tokens)


Positive = Annotated[float, Parameter(converter=_positive)]
Count = Annotated[int, Parameter(converter=_count)]
# One or more values after one option: --across 20 40.
Several = Annotated[tuple[T, ...], Parameter(consume_multiple=(1, None), negative=())]
Positives = Annotated[tuple[float, ...], Parameter(converter=_positives, consume_multiple=(1, None), negative=())]
Counts = Annotated[tuple[int, ...], Parameter(converter=_counts, consume_multiple=(1, None), negative=())]
Arch = Literal["cpu", "cuda", "vulkan"]
Rule = Literal["sharp", "interpolated"]  # of the interface between two fluids
