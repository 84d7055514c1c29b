"""Copies by CUDA's driver, by a driver that copies in the host's memory, where the arrays of the CPU are."""

import ctypes

import numpy as np
import pytest

from tipfem.backend import arrays, cuda_copies, runtime
from tipfem.backend.arrays import Buffers, download


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
    monkeypatch.setattr(arrays, "on_cuda", lambda: True)
    monkeypatch.setattr(arrays, "on_cpu", lambda: False)
    monkeypatch.setattr(cuda_copies, "_copies", [])


@pytest.mark.usefixtures("on_cuda")
@pytest.mark.parametrize("failing", ["", "cuDevicePrimaryCtxRetain"])
def test_there_and_back(monkeypatch, failing):
    """Without a context, the arrays are copied by kernels."""
    driver = Driver(failing)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: driver)
    buffers = Buffers()
    for values in (np.arange(7.0), np.arange(12).reshape(4, 3), np.zeros((0, 2)), np.array([True, False])):
        there = download(buffers.upload(f"{values.dtype} {values.ndim}", values), len(values))
        np.testing.assert_array_equal(there, values)
    assert driver.calls.count("cuMemcpyHtoD_v2") == driver.calls.count("cuMemcpyDtoH_v2") == (0 if failing else 3)


@pytest.mark.usefixtures("on_cuda")
def test_a_copy_that_fails_is_an_error(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Driver("cuMemcpyHtoD_v2"))
    with pytest.raises(OSError, match="cuMemcpyHtoD_v2 of the CUDA driver failed with status 999"):
        Buffers().upload("x", np.arange(3.0))
