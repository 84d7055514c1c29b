"""Kernels that are started through what was prepared for their arrays, and loops that one thread does."""

import ast
import importlib.util
import inspect
import sys
import textwrap

import numpy as np
import pytest
import taichi as ti

from tipfem.backend.launch import Launcher, _source
from tipfem.backend.runtime import Buffers, alone, chunks, download, init, settings, spread
from tipfem.linalg import vector_kernels


@ti.kernel
def scaled(source: ti.types.ndarray(), target: ti.types.ndarray(), factor: float, n: ti.i32, twice: ti.template()):
    for i in range(n):
        target[i] = factor * source[i] * (2.0 if ti.static(twice) else 1.0)


@ti.kernel
def count(values: ti.types.ndarray(), n: ti.i32) -> ti.i32:
    total = 0
    for i in range(n):
        total += values[i]
    return total


@ti.data_oriented
class Shifted:
    """A kernel and its function in a class."""

    def __init__(self, shift):
        self.shift = shift

    @ti.func
    def shifted(self, i):
        return i + self.shift

    @ti.kernel
    def fill(self, values: ti.types.ndarray()):
        for i in range(values.shape[0]):
            values[i] = self.shifted(i)


@pytest.fixture(scope="module", autouse=True)
def _runtime():
    init()


def test_numbers_and_templates_may_change_from_launch_to_launch():
    buffers, values = Buffers(), np.arange(20.0)
    source, target = buffers.upload("a", values), buffers.get("b", 20)
    for factor, n, twice in ((1.0, 20, False), (3, 20, False), (-2.0, 20, True), (5.0, 7, False)):
        expected = download(target, 20)
        expected[:n] = factor * values[:n] * (2 if twice else 1)
        buffers.launch(scaled, source, target, factor, n, twice)
        np.testing.assert_array_equal(download(target, 20), expected)


def test_arrays_of_numpy_are_those_of_this_launch():
    buffers = Buffers()
    target = buffers.get("b", 5)
    for k in range(3):
        buffers.launch(scaled, np.full(5, float(k)), target, 2.0, 5, False)
        assert (download(target, 5) == 2 * k).all()
    out = np.zeros(5)
    buffers.launch(scaled, target, out, 0.5, 5, False)
    assert (out == 2).all()


def test_what_a_kernel_returns_comes_back():
    buffers = Buffers()
    values = buffers.upload("a", np.arange(10))
    assert [buffers.launch(count, values, n) for n in (10, 3, 0)] == [45, 3, 0]


def test_arrays_that_have_grown_are_used_and_the_old_ones_let_go():
    buffers = Buffers()
    for n in (16, 40, 1000):
        source, target = buffers.upload("a", np.ones(n)), buffers.get("b", n)
        buffers.launch(scaled, source, target, 4.0, n, False)
        assert (download(target, n) == 4).all()
        assert len(buffers.launch._ready) == 1


def test_two_launchers_do_not_meet():
    one, two, buffers = Launcher(), Launcher(), Buffers()
    source, target = buffers.upload("a", np.ones(16)), buffers.get("b", 16)
    one(scaled, source, target, 2.0, 16, False)
    two(scaled, source, target, 3.0, 16, False)
    assert (download(target, 16) == 3).all()
    assert not buffers.launch._ready


@pytest.mark.parametrize("size", [1, 700, 40_000])
def test_one_thread_and_all_of_them_give_the_same_bits(size):
    buffers, rng = Buffers(), np.random.default_rng(size)
    vector, start, found = rng.normal(size=size), rng.normal(size=3 * size), []
    for single in (False, True):
        basis, out = buffers.upload("basis", start), np.zeros(4)
        w, partial = buffers.upload("w", vector), buffers.get("partial", chunks() * 3)
        buffers.launch(
            vector_kernels.orthogonalise, basis, w, partial, out, 1, size, chunks(), spread(single), single, 0.0
        )
        found.append(np.concatenate([download(w, size), download(basis, 3 * size), out]))
    np.testing.assert_array_equal(*found)


def test_short_loops_are_left_to_one_thread():
    if settings()["threads"] != 1:
        assert alone(100, 10.0)
        assert not alone(1_000_000, 10.0)
    assert spread(True) == 1


def test_messages_of_taichi_say_file_line_and_kernel(tmp_path):
    """One line instead of Taichi's picture of the source: still enough to find the place."""
    source = "import taichi as ti\n\n@ti.kernel\ndef wrong(n: ti.i32):\n    m = n + nowhere\n"
    (tmp_path / "wrong_kernel.py").write_text(source)
    spec = importlib.util.spec_from_file_location("wrong_kernel", tmp_path / "wrong_kernel.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.raises(ti.TaichiCompilationError, match=r'wrong_kernel.py", line 5, in wrong'):
        module.wrong(3)


def test_sources_are_found_as_python_finds_them():
    found = 0
    for module in [m for name, m in sys.modules.items() if name.startswith("tipfem.")]:
        for value in vars(module).values():
            kernel = getattr(value, "__wrapped__", value)  # of one that `on_arrays` starts
            taichi = getattr(kernel, "_primal", None) or getattr(kernel, "func", None)
            function = getattr(taichi, "func", None)
            if inspect.isfunction(function):
                file, lines, first, text = _source(function)
                expected, number = inspect.getsourcelines(function)
                assert (file, first) == (inspect.getsourcefile(function), number)
                assert [line.rstrip() for line in expected] == lines[: len(expected)]
                assert ast.dump(ast.parse(text)) == ast.dump(ast.parse(textwrap.dedent("".join(expected))))
                found += 1
    assert found > 20


def test_kernels_in_classes_are_told_from_others():
    values = np.zeros(3, np.int32)
    Shifted(4).fill(values)
    assert values.tolist() == [4, 5, 6]
    assert inspect.getframeinfo(sys._getframe()).code_context  # as it was before Taichi was imported
