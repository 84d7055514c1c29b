"""Functions of reals, against NumPy's."""

import numpy as np
import pytest
import taichi as ti

from tipfem.backend.array_types import Reals1
from tipfem.backend.launch import kernel, launch
from tipfem.backend.real_functions import angle_between, cube_root, exponential, power, sine


@kernel
def evaluate(x: Reals1, y: Reals1, root: Reals1, of_angle: Reals1, angle: Reals1):
    for i in range(x.shape[0]):
        root[i], of_angle[i], angle[i] = cube_root(ti.abs(x[i])), sine(x[i]), angle_between(x[i], y[i])


def test_functions_equal_those_of_numpy():
    x = np.concatenate([np.linspace(-7, 7, 101), np.geomspace(1e-12, 3, 40)])
    y = np.roll(x, 17)
    found = [np.zeros_like(x) for _ in range(3)]
    launch(evaluate, x, y, *found)
    digits = 1e-15 if found[1].dtype == np.float64 else 1e-6
    assert found[0] == pytest.approx(np.cbrt(np.abs(x)), rel=4 * digits, abs=1e-30)
    np.testing.assert_allclose(found[1], np.sin(x), rtol=0, atol=2 * digits)
    np.testing.assert_allclose(found[1][101:], np.sin(x[101:]), rtol=2 * digits)  # small angles keep their digits
    np.testing.assert_allclose(found[2], np.abs(np.arctan2(x, y)), atol=1e-6)


@kernel
def raise_to_powers(x: Reals1, exponent: float, natural: Reals1, raised: Reals1):
    for i in range(x.shape[0]):
        natural[i], raised[i] = exponential(x[i]), power(ti.abs(x[i]) + 1e-20, exponent)


@pytest.mark.parametrize("exponent", [-0.45, 0.3, 1.0])
def test_powers_equal_those_of_numpy(exponent):
    x = np.concatenate([np.linspace(-80, 80, 161), np.geomspace(1e-12, 3, 40)])
    natural, raised = np.zeros_like(x), np.zeros_like(x)
    launch(raise_to_powers, x, exponent, natural, raised)
    np.testing.assert_allclose(natural, np.exp(x), rtol=4e-14)
    np.testing.assert_allclose(raised, (np.abs(x) + 1e-20) ** exponent, rtol=4e-14)
