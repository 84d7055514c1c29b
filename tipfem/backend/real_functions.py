"""Functions of reals that not every device has in 64 bits."""

import taichi as ti


@ti.func
def cube_root(x):  # type: ignore[no-untyped-def]
    """Cube root of ``x`` between 1e-37 and 1e38, to round-off.

    GPUs have powers in 32 bits at least; Newton's method doubles the number of right digits in each iteration.
    """
    y = ti.cast(ti.cast(x, ti.f32) ** ti.cast(1.0 / 3.0, ti.f32), float)
    for _ in ti.static(range(3)):
        y = y - (y - x / (y * y)) / 3.0
    return y
