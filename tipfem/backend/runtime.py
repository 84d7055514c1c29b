"""Start Taichi, and return how it was started."""

import contextlib
import os
import tempfile
from typing import Any

import numpy as np

# Without a writable home, Taichi ends the process on import or at exit; so its cache goes to a temporary folder.
_home = os.environ.get("HOME", "")
if "XDG_CACHE_HOME" not in os.environ and not (_home and os.access(_home, os.W_OK)):
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="tipfem-cache-")
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

from tipfem.backend import taichi_patches  # noqa: E402 - before anything else imports Taichi

import taichi as ti  # noqa: E402 # isort: skip

_ARCHES = {"cpu": ti.cpu, "cuda": ti.cuda}
_PRECISIONS = {"f64": ti.f64, "f32": ti.f32}
_running: dict[str, Any] = {}
_threads = [1]
BIND_SWITCH = "TIPFEM_BIND_THREADS"


def init(arch: str = "cpu", precision: str = "f64", threads: int | None = None) -> None:
    """Start Taichi; once a process.

    On the CPU, if Taichi is to use all cores available to the process, each of its threads is bound to a core, unless
    the environment variable ``TIPFEM_BIND_THREADS`` is 0.

    Args:
        arch: "cpu", or "cuda", which has not been tried on a GPU.
        precision: "f64" (the default) or "f32", of all reals in the kernels.
        threads: number of CPU threads; by default, and at most, as many as there are cores that the process may use.

    Raises:
        ValueError: an argument is not one of those.
        RuntimeError: the device is not there, or Taichi already runs with other settings.
    """
    if arch not in _ARCHES:
        raise ValueError(f"init: arch is {arch!r}; it must be one of {sorted(_ARCHES)}")
    if precision not in _PRECISIONS:
        raise ValueError(f"init: precision is {precision!r}; it must be one of {sorted(_PRECISIONS)}")
    cores = (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()) or 1
    if threads is not None and (not isinstance(threads, int) or isinstance(threads, bool) or threads < 1):
        raise ValueError(f"init: threads is {threads!r}; it must be a whole number >= 1")
    if threads is not None and threads > cores:  # threads wait for each other in kernels, see `barrier`
        raise ValueError(
            f"init: threads is {threads}, but this process may use {cores} core(s); more threads would hang"
        )
    wanted = {"arch": arch, "precision": precision, "threads": threads}
    if _running:
        if _running != wanted:
            raise RuntimeError(f"init: Taichi already runs with {_running}; one process has one runtime, not {wanted}")
        return
    options: dict[str, Any] = {"default_fp": _PRECISIONS[precision], "log_level": ti.ERROR}
    options["cpu_max_num_threads"] = threads or cores
    # "Starting on arch" is a bare print of Taichi's, and a missing GPU must be an error, not a CPU run.
    before = _own_threads()
    try:
        with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
            ti.init(arch=_ARCHES[arch], enable_fallback=False, **options)
    except Exception as error:
        raise RuntimeError(f"init: Taichi cannot start on {arch!r}: {error}") from error
    _running.update(wanted)
    _threads[0] = taichi_patches.running_threads()
    if arch == "cpu" and os.environ.get(BIND_SWITCH, "1") != "0":
        _bind_to_cores([thread for thread in _own_threads() if thread not in before], _threads[0])


def _own_threads() -> list[int]:
    """The threads of this process in the order of their creation; empty where the system does not list them."""
    try:
        return [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return []


def _bind_to_cores(started: list[int], threads: int) -> None:
    """Bind Taichi's workers, the last of the threads it ``started``, to a core each, if they are to use all cores.

    Their loops are short, and so are the pauses between them. Schedulers then tend to keep them on one core, where two
    threads are no faster than one.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_setaffinity") else []
    if len(cores) > 1 and len(cores) == threads and len(started) >= len(cores):
        for thread, core in zip(started[-len(cores) :], cores, strict=True):
            os.sched_setaffinity(thread, {core})


def require_init() -> None:
    """Start Taichi on the CPU in f64 if it does not run yet."""
    if not _running:
        init()


def settings() -> dict[str, Any]:
    """How Taichi was started: arch, precision, threads; empty if it was not."""
    return dict(_running)


def on_cpu() -> bool:
    """Whether Taichi was started on the CPU."""
    return _running.get("arch") == "cpu"


def on_gpu() -> bool:
    """Whether Taichi was started on a GPU."""
    return _running.get("arch") == "cuda"


def real() -> type[np.floating[Any]]:
    """The NumPy type of the kernels' reals."""
    return np.float32 if _running.get("precision") == "f32" else np.float64


def taichi_real() -> Any:
    """Taichi's type of the kernels' reals."""
    return _PRECISIONS[_running["precision"]]


def round_off() -> float:
    """Displacement in spacings below which a residual is round-off, for a light fluid under a heavy one's pressure."""
    return 1e-4 if _running.get("precision") == "f32" else 1e-13


def threads() -> int:
    """How many CPU threads Taichi has."""
    return _threads[0]
