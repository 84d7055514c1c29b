"""Places of particles, which decide ties between them, so that nothing depends on the order of their numbers."""

from __future__ import annotations

import numpy as np

from tipfem.typing import Array

# Along the golden section, and the root of two: no two particles of a lattice of moderate size have the same place.
DIRECTION = (1.0, 0.6180339887498949, 0.4142135623730951)


def places(position: Array) -> Array:
    """Coordinates (K,) of positions (K, d) along a direction that is none of a lattice's [m]."""
    # Column by column: a product by BLAS may round the same row differently at another place of the array.
    result = np.zeros(len(position))
    for part, column in zip(DIRECTION, position.T, strict=False):
        result += part * column
    return result


def along_curve(position: Array, spacing: float) -> Array:
    """Numbers (K,) of positions (K, d) along a curve that fills space (G. M. Morton, 1966): close ones are near."""
    steps, code = ((position - position.min(axis=0)) / spacing).astype(np.int64), np.zeros(len(position), np.int64)
    for bit in range(63 // position.shape[1]):
        for axis, column in enumerate(steps.T):
            code |= (column >> bit & 1) << (bit * position.shape[1] + axis)
        if not (steps >> (bit + 1)).any():
            break
    return code
