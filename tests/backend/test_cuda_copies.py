"""Copies by CUDA's driver, by a driver that copies in the host's memory, where the arrays of the CPU are."""

import ctypes

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import arrays, cuda_copies, runtime, staging
from tipfem.backend.array_types import Reals1
from tipfem.backend.arrays import Buffers, download, expect
from tipfem.backend.launch import kernel, launch


class Driver:
    """What is called of libcuda; ``failing`` is the call that fails."""

    def __init__(self, failing=""):
        self.failing, self.calls = failing, []

    def __getattr__(self, name):
        def call(*arguments):
            self.calls.append(name)
            if "Memcpy" in name:
                target, source, size = (argument.value for argument in arguments)
                ctypes.memmove(target, source, size)
            return 999 if name == self.failing else 0

        return call


@pytest.fixture
def on_cuda(monkeypatch):
    runtime.require_init()
    monkeypatch.setattr(staging, "on_cuda", lambda: True)
    monkeypatch.setattr(arrays, "on_cpu", lambda: False)
    monkeypatch.setattr(cuda_copies, "_copies", [])


GIVEN = np.arange(7.0), np.arange(12).reshape(4, 3), np.zeros((0, 2)), np.array([True, False, True])


@pytest.mark.usefixtures("on_cuda")
@pytest.mark.parametrize("failing", ["", "cuDevicePrimaryCtxRetain"])
@pytest.mark.parametrize("together", [False, True])
def test_there_and_back(monkeypatch, failing, together):
    """One copy to the device for small arrays, one back for those expected; by kernels without a context."""
    driver = Driver(failing)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: driver)
    buffers = Buffers()
    on_device = [buffers.upload(f"{values.dtype} {values.ndim}", values) for values in GIVEN]
    if together:
        for array, values in zip(on_device, GIVEN, strict=True):
            expect(array, len(values))
    for array, values in zip(on_device, GIVEN, strict=True):
        np.testing.assert_array_equal(download(array, len(values)), values)
    wanted = (0, 0) if failing else (1, 1 if together else 3)
    assert tuple(driver.calls.count(name) for name in ("cuMemcpyHtoD_v2", "cuMemcpyDtoH_v2")) == wanted


@pytest.mark.usefixtures("on_cuda")
def test_what_a_kernel_is_given_is_there_and_read_anew(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Driver())
    buffers = Buffers()
    x, large = buffers.upload("x", np.arange(3.0)), np.arange(staging.SMALL // 8 + 1.0)
    buffers.upload("x", 2 * np.arange(3.0))  # the last of two that wait
    y = buffers.upload("y", large)  # does not wait, nor for the others
    np.testing.assert_array_equal(download(y, len(large)), large)
    launch(double, x, 3)
    expect(x, 3)
    assert download(y, 2).tolist() == [0, 1]
    assert download(x, 3).tolist() == [0, 4, 8]
    double._recent = {}  # a GPU's kernels are never started so quickly
    launch(double, x, 3)
    assert download(x, 3).tolist() == [0, 8, 16]


@kernel
def double(x: Reals1, n: ti.i32):
    """x = 2 x for the first n entries."""
    for i in range(n):
        x[i] = 2.0 * x[i]


@pytest.mark.usefixtures("on_cuda")
def test_a_copy_that_fails_is_an_error(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Driver("cuMemcpyHtoD_v2"))
    with pytest.raises(OSError, match="cuMemcpyHtoD_v2 of the CUDA driver failed with status 999"):
        download(Buffers().upload("x", np.arange(3.0)), 3)
