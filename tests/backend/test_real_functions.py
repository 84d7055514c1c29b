"""Functions of reals, against NumPy's."""

import numpy as np
import pytest
import taichi as ti

from tipfem.backend.array_types import Reals1
from tipfem.backend.launch import kernel, launch
from tipfem.backend.real_functions import angle_between, cube_root, sine


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
