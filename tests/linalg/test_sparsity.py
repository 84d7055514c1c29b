"""Lists of lists by running sums: the same whatever shares the work."""

import numpy as np
import pytest

from tipfem.backend import launch as launches
from tipfem.backend import runtime
from tipfem.backend.arrays import Buffers, download
from tipfem.linalg import sparsity
from tipfem.linalg.sparsity import list_corners, running_sums


@pytest.fixture(params=["serial", "shared", "as on a GPU"])
def shared(request, monkeypatch):
    """Loops on one thread, or shared in as many parts as on a GPU, with lists by atomic operations."""
    runtime.require_init()
    if request.param != "serial":
        monkeypatch.setattr(launches, "is_serial", lambda *_: False)
        monkeypatch.setattr(launches, "FEW_THREADS", 0)
        monkeypatch.setattr(launches, "PARTS", launches.PARTS_OF_GPU)
        monkeypatch.setattr(sparsity.sum_up, "_schedules", {})  # which keep the number of parts
    if request.param == "as on a GPU":
        monkeypatch.setattr(launches, "ITERATIONS", 1)


@pytest.mark.usefixtures("shared")
@pytest.mark.parametrize("n", [0, 1, 15, 4097, 30_001])
def test_running_sums(n):
    counts, buffers = np.random.default_rng(n).integers(0, 9, n + 1, dtype=np.int32), Buffers()
    sums, cursor = buffers.upload("sums", counts), buffers.get("cursor", n, integer=True)
    assert running_sums(sums, n, buffers, cursor) == counts.sum()
    np.testing.assert_array_equal(download(sums, n + 1), np.cumsum(counts))
    np.testing.assert_array_equal(download(cursor, n), np.cumsum(counts)[:-1])


@pytest.mark.usefixtures("shared")
def test_list_corners():
    cells, nodes, buffers = np.random.default_rng(3).integers(0, 500, (2000, 3), dtype=np.int32), 501, Buffers()
    offsets, corners = buffers.get("offsets", nodes + 1, integer=True), buffers.get("corners", cells.size, integer=True)
    list_corners(buffers.upload("cells", cells), offsets, corners, cells.shape, nodes, buffers)
    np.testing.assert_array_equal(download(corners, cells.size), np.argsort(cells.ravel(), kind="stable"))
    wanted = np.append(0, np.cumsum(np.bincount(cells.ravel(), minlength=nodes)))
    np.testing.assert_array_equal(download(offsets, nodes + 1), wanted)
