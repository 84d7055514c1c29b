"""Outlines as bytes, for pages that draw them: see page/outlines.js, which reads them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tipfem.render.outlines import Loop
from tipfem.typing import Array


def packed(loops: Sequence[Loop], lower: Array, scale: Array, wide: bool = False) -> bytes:
    """Loops of a layer: their number; of each the number of points, x and y as differences, and fixed points as bits.

    Args:
        loops: of one layer of a picture.
        lower: (2,) place of the number 0 [m].
        scale: (2,) between the places of two numbers [m].
        wide: numbers of 32 bits instead of 16.

    Raises:
        ValueError: a loop has more points than can be counted so.
    """
    kind, most = ("<u4", 2**32 - 1) if wide else ("<u2", 65_535)
    parts = [np.array(len(loops), kind).tobytes()]
    for points, fixed in loops:
        if max(len(points), len(loops)) > most:
            raise ValueError(f"an outline has {len(points)} points; at most {most} can be shared")
        places = np.clip(np.rint((points - lower) / scale), 0, most).astype(np.int64)
        steps = np.diff(places, axis=0, prepend=0) % (most + 1)
        parts += [np.array(len(points), kind).tobytes(), steps.T.astype(kind).tobytes(), np.packbits(fixed).tobytes()]
    return b"".join(parts)
