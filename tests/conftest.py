"""What all tests share: one Taichi runtime, in f64, on the CPU or where TIPFEM_TEST_ARCH says."""

from __future__ import annotations

import os

import pytest

import tipfem as tp


@pytest.fixture(scope="session", autouse=True)
def taichi_runtime():
    """Start Taichi once; a second start would break what the first one compiled."""
    tp.init(arch=os.environ.get("TIPFEM_TEST_ARCH", "cpu"))


@pytest.fixture
def water():
    """Water at 20 degrees Celsius."""
    return tp.Fluid("water", density=998.2, viscosity=1.002e-3)


@pytest.fixture
def air():
    """Air at 20 degrees Celsius and one atmosphere."""
    return tp.Fluid("air", density=1.204, viscosity=1.825e-5)


@pytest.fixture
def glycerin():
    """Glycerin at 20 degrees Celsius."""
    return tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
