"""Lists of lists by running sums: the same whatever shares the work."""

import numpy as np
import pytest

from tipfem.backend import launch as launches
from tipfem.backend import runtime
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
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


@pytest.mark.parametrize("ends", ["on a torus", "on a square"])
def test_neighbours_are_no_more_than_the_bound(ends):
    """Triangles of a lattice: on a torus each node has six neighbours and itself, which is the bound."""
    count, buffers = 5, Buffers()
    i, j = np.mgrid[: count - (ends == "on a square"), : count - (ends == "on a square")].reshape(2, -1)
    at = [(i + a) % count * count + (j + b) % count for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
    cells = np.concatenate([np.stack([at[0], at[k], at[k + 1]], axis=1) for k in (1, 2)]).astype(np.int32)
    nodes, put, get = count**2, buffers.upload("cells", cells), buffers.get
    offsets, corners = get("offsets", nodes + 1, integer=True), get("corners", cells.size, integer=True)
    list_corners(put, offsets, corners, cells.shape, nodes, buffers)
    lists = get("padded", 2 * cells.size + nodes, integer=True), get("counts", nodes + 1, integer=True)
    slots = get("slots", 2 * cells.size, integer=True)
    launch(sparsity.find_neighbours, put, offsets, corners, *lists, slots, nodes, 2, work=(nodes, sparsity.NEIGHBOURS))
    found, most = running_sums(lists[1], nodes, buffers), sparsity.most_neighbours(nodes, 2)
    assert found == most if ends == "on a torus" else found < most
