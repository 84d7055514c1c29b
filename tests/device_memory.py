"""How much memory the device arrays of a simulation hold."""

from __future__ import annotations

import numpy as np
import taichi as ti


def memory(buffers):
    """Bytes that the arrays hold."""
    sizes = {ti.i32: 4, ti.f32: 4, ti.f64: 8}
    return sum(int(np.prod(array.shape)) * sizes[array.dtype] for array in buffers._arrays.values())
