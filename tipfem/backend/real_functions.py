"""Functions of reals that not every device has in 64 bits: GPUs have the powers and the sines of 32."""

import math

import taichi as ti

LN_2 = math.log(2.0)


@ti.func
def cube_root(x):  # type: ignore[no-untyped-def]
    """Cube root of ``x`` between 1e-37 and 1e38, to round-off.

    Halley's method triples the number of right digits.
    """
    y = ti.cast(ti.cast(x, ti.f32) ** ti.cast(1.0 / 3.0, ti.f32), float)
    cube = y * y * y
    return y * ((cube + 2.0 * x) / (2.0 * cube + x))


@ti.func
def sine(x):  # type: ignore[no-untyped-def]
    """Sine of ``x``, to round-off where it is an angle of a few turns: its series, within a right angle of a zero."""
    turns = ti.floor(x / math.pi + 0.5)
    y = x - turns * math.pi
    total = ti.cast(1.0, float)
    for k in ti.static(range(11, 0, -1)):
        total = 1.0 - y * y / (2 * k * (2 * k + 1)) * total
    half = 0.5 * turns
    return y * total * (1.0 - 4.0 * (half - ti.floor(half)))


@ti.func
def angle_between(across, along):  # type: ignore[no-untyped-def]
    """Absolute angle of the direction (``along``, ``across``), from 0 to pi, with the digits of 32 bits."""
    size = ti.abs(across) + ti.abs(along)
    return ti.cast(ti.atan2(ti.cast(ti.abs(across) / size, ti.f32), ti.cast(along / size, ti.f32)), float)


@ti.func
def exponential(x):  # type: ignore[no-untyped-def]
    """e to the power of ``x``, to round-off between -700 and 700: a power of two, and the series of what is left."""
    given = ti.min(ti.max(x, -700.0), 700.0)
    twos = ti.floor(given / LN_2 + 0.5)
    rest = given - twos * LN_2
    total = ti.cast(1.0, float)
    for k in ti.static(range(14, 0, -1)):
        total = 1.0 + rest / k * total
    bits, factor = ti.cast(ti.abs(twos), ti.i32), ti.select(twos < 0.0, ti.cast(0.5, float), ti.cast(2.0, float))
    for _ in ti.static(range(10)):
        total *= ti.select(bits % 2 == 1, factor, ti.cast(1.0, float))
        bits, factor = bits // 2, factor * factor
    return total


@ti.func
def power(x, exponent):  # type: ignore[no-untyped-def]
    """``x`` between 1e-37 and 1e38 to the power of ``exponent``, to round-off; Newton's method finds the logarithm."""
    logarithm = ti.cast(ti.log(ti.cast(x, ti.f32)), float)
    for _ in ti.static(range(2)):
        logarithm += x * exponential(-logarithm) - 1.0
    return exponential(exponent * logarithm)
