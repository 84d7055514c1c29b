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
