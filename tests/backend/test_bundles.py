"""Kernels whose parameters are named tuples: the bits and the machine code of kernels with as many parameters."""

import inspect
from typing import NamedTuple

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import taichi_patches
from tipfem.backend.array_types import Ints1, Reals1, Template
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.bundles import fields
from tipfem.backend.kept_kernels import KeptLaunch
from tipfem.backend.launch import kernel, launch


class Rows(NamedTuple):
    """A matrix in CSR, and a number by which it is multiplied."""

    offsets: "Ints1"
    columns: "Ints1"
    values: "Reals1"
    factor: "ti.f64"


class Way(NamedTuple):
    """Twice or once."""

    twice: "Template"


@ti.func
def row(rows: Template, x: Template, i):
    """Row i of the product."""
    total = 0.0
    for s in range(rows.offsets[i], rows.offsets[i + 1]):
        total += rows.values[s] * x[rows.columns[s]]
    return rows.factor * total


@kernel
def multiply(rows: Rows, x: Reals1, way: Way, out: Reals1, n: ti.i32, serial: Template):
    """out = A x."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        out[i] = row(rows, x, i) * (2.0 if ti.static(way.twice) else 1.0)


MATRIX = np.array([[1.0, 0.1, 0.0], [0.0, 3.0, 0.7], [0.2, 0.0, 0.3]])
X = np.array([0.3, 0.7, 1.1])


def in_rows(factor: float = 1.0) -> Rows:
    """The matrix by rows."""
    there = MATRIX != 0
    offsets = np.append(0, np.cumsum(there.sum(axis=1))).astype(np.int32)
    return Rows(offsets, there.nonzero()[1].astype(np.int32), MATRIX[there], factor)


@pytest.mark.parametrize("twice", [False, True])
def test_a_kernel_reads_the_fields_of_its_bundles(twice):
    out = np.zeros(3)
    for factor in (1.0, -2.5):
        launch(multiply, in_rows(factor), X, Way(twice), out, 3, work=(3, 1.0))
        np.testing.assert_allclose(out, (1 + twice) * factor * (MATRIX @ X), rtol=1e-15)


def test_fields_may_be_device_arrays():
    buffers = Buffers()
    rows = in_rows()
    uploaded = [buffers.upload(name, values) for name, values in zip("abc", rows[:3], strict=True)]
    x, out = buffers.upload("x", X), buffers.get("out", 3)
    for _ in range(3):  # the longer way, and again as prepared
        launch(multiply, Rows(*uploaded, 2.0), x, Way(False), out, 3, work=(3, 1.0))
    np.testing.assert_allclose(download(out, 3), 2.0 * (MATRIX @ X), rtol=1e-15)


def test_taichi_is_given_the_fields_one_by_one():
    names = [each.name for each in multiply.taichi._primal.arguments]
    bundled = ["rows__offsets", "rows__columns", "rows__values", "rows__factor", "x", "way__twice"]
    assert names == [*bundled, "out", "n", "serial"]
    assert multiply.parameters == ("rows", "x", "way", "out", "n")
    assert fields(Rows) == {"offsets": Ints1, "columns": Ints1, "values": Reals1, "factor": ti.f64}
    assert inspect.signature(multiply.taichi._primal.func).parameters["rows__values"].annotation is Reals1


@pytest.mark.skipif(not taichi_patches.ENABLED, reason="launches are not prepared")
def test_launches_of_bundles_are_prepared_once():
    out = np.zeros(3)
    launch(multiply, in_rows(), X, Way(False), out, 3, work=(3, 1.0))
    before = len(multiply._prepared)
    launch(multiply, in_rows(0.5), X.copy(), Way(False), out, 3, work=(3, 1.0))
    assert len(multiply._prepared) == before
    kept = [each for each in multiply._prepared.values() if isinstance(each, KeptLaunch) and each.plan]
    assert bool(multiply._recent.get(0)) == bool(kept)  # started by one call of machine code


def test_what_is_no_bundle_is_refused():
    rows, out = in_rows(), np.zeros(3)
    with pytest.raises(TypeError, match=r"multiply takes 5 arguments \(rows, x, way, out, n\); 4 given"):
        launch(multiply, rows, X, Way(False), out, work=(3, 1.0))
    with pytest.raises(TypeError, match="multiply: its bundles have 8 fields in all"):
        launch(multiply, rows[:3], X, Way(False), out, 3, work=(3, 1.0))
    with pytest.raises(TypeError, match="multiply: a bundle is missing"):
        launch(multiply, 1.0, X, Way(False), out, 3, work=(3, 1.0))
    with pytest.raises(TypeError, match=r"multiply: rows\.values is of int32 instead of reals"):
        launch(multiply, rows._replace(values=rows.columns), X, Way(False), out, 3, work=(3, 1.0))


@kernel
def last_offset(rows: Rows) -> ti.i32:
    """Number of entries."""
    last = 0
    ti.loop_config(serialize=True)
    for i in range(rows.offsets.shape[0]):
        last = ti.max(last, rows.offsets[i])
    return last


def test_a_kernel_of_bundles_returns_what_it_says():
    assert launch(last_offset, in_rows()) == 6
