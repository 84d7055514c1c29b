"""Types of arrays, points, boxes and colours."""

from typing import Any, TypeAlias

from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
Point: TypeAlias = tuple[float, float]  # x, y [px], y down
Box: TypeAlias = tuple[float, float, float, float]  # left, top, right, bottom [px]
Range: TypeAlias = tuple[float, float]  # low, high
