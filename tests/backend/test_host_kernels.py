"""Kernels that the processor runs beside a GPU, by machine code that another process makes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import kept_kernels
from tipfem.backend.fingerprint import NotKeptError
from tipfem.backend.host_kernels import Compiler
from tipfem.backend.launch import kernel
from tipfem.backend.machine_code import UnsuitableError
from tipfem.remesh.volume_kernels import measure_cells

ROOT = Path(__file__).resolve().parents[2]
TRIANGLE = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]], dtype=np.int32), np.zeros(1)


@pytest.fixture
def compiler(tmp_path, monkeypatch):
    """A process with a library of its own."""
    if not kept_kernels.open_library():
        pytest.skip("kernels are not kept here")
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(tmp_path))
    made = Compiler("f64")
    yield made
    made.close()


def test_a_library_takes_what_another_process_compiles(compiler, tmp_path):
    library = kept_kernels.Library(tmp_path / "tipfem", 1, compiler)
    single = [each.astype(np.float32) if each.dtype.kind == "f" else each for each in TRIANGLE]  # which no wheel has
    area = np.empty(1, dtype=np.float32)
    prepared = library.prepare(measure_cells.taichi, measure_cells._annotations, (*single, area, True))
    assert prepared is not None
    prepared((*single, area, True))
    assert area[0] == 1.0
    on_device = (*TRIANGLE, ti.ndarray(ti.f64, 1), True)
    assert library.prepare(measure_cells.taichi, measure_cells._annotations, on_device) is None


def test_what_cannot_be_compiled_is_told(compiler):
    @kernel
    def local(values: ti.types.ndarray(ndim=1)):
        for i in range(1):
            values[i] = 0.0

    with pytest.raises(NotKeptError, match=r"has no kernel .*local"):
        compiler.add(local.taichi, (np.zeros(1),))
    with pytest.raises(NotKeptError, match="cannot be told to another process"):
        compiler.add(local.taichi, (lambda: 0,))
    compiler._process.kill()
    with pytest.raises(UnsuitableError, match="has ended"):
        compiler.add(measure_cells.taichi, (*TRIANGLE, np.empty(1), True))


@pytest.mark.slow
@pytest.mark.vulkan
def test_beside_vulkan_the_processor_runs_kernels_on_arrays_of_numpy():
    code = (
        "import numpy as np, tipfem as tp\n"
        "from tipfem.backend import kept_kernels\n"
        "from tipfem.mesh.mesh import Mesh\n"
        "from tipfem.remesh.volumes import areas\n"
        "tp.init(arch='vulkan')\n"
        "position, cells = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]], dtype=np.int32)\n"
        "print(areas(position, Mesh(position, cells))[0], kept_kernels.kept())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    if "cannot start on 'vulkan'" in done.stderr and os.environ.get("TIPFEM_REQUIRE_VULKAN") != "1":
        pytest.skip("there is no Vulkan driver")
    assert done.stdout.split() == ["1.0", "1"], done.stderr
