"""Start Taichi for drawing, unless it already runs in this process."""

import contextlib
import os
import tempfile
from pathlib import Path
from typing import Any

# Both are read when Taichi is imported: no banner, and a writable place for its cache, without which
# it ends the process.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_ENABLE_PYBUF", "0")  # a line about notebooks; kernels here print nothing
_home = os.environ.get("HOME", "")
if "XDG_CACHE_HOME" not in os.environ and not (_home and os.access(_home, os.W_OK)):
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="tipfem-cache-")

import taichi as ti  # noqa: E402  (the environment must be set before)

__all__ = ["ensure_runtime", "ti"]

# Arrays of kernels, by the type of their numbers and how many dimensions they have.
Bytes3 = ti.types.ndarray(dtype=ti.u8, ndim=3)
Signs1 = ti.types.ndarray(dtype=ti.i8, ndim=1)
Longs1 = ti.types.ndarray(dtype=ti.i64, ndim=1)
Ints1, Ints2 = (ti.types.ndarray(dtype=ti.i32, ndim=n) for n in (1, 2))
Floats1, Floats2, Floats3, Floats4 = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (1, 2, 3, 4))
Doubles2, Doubles3 = (ti.types.ndarray(dtype=ti.f64, ndim=n) for n in (2, 3))


def ensure_runtime() -> Any:
    """The program of Taichi, started on the CPU unless it runs; a restart makes another and frees device memory."""
    if ti.lang.impl.get_runtime().prog is None:
        _provide_cache()
        with contextlib.redirect_stdout(None):  # "Starting on arch" is a bare print
            ti.init(arch=ti.cpu, log_level=ti.ERROR)
    return ti.lang.impl.get_runtime().prog


def _provide_cache() -> None:
    """Keep Taichi's compiled kernels in a temporary folder if its own is not writable, or it ends the process."""
    folder = Path(os.environ.get("TI_OFFLINE_CACHE_FILE_PATH") or ti.lang.impl.default_cfg().offline_cache_file_path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        os.environ["TI_OFFLINE_CACHE_FILE_PATH"] = tempfile.mkdtemp(prefix="tipfem-cache-")
