"""Start Taichi, and return how it was started."""

import contextlib
import os
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

# Without a writable home, Taichi ends the process on import or at exit; so its cache goes to a temporary folder.
_home = os.environ.get("HOME", "")
if "XDG_CACHE_HOME" not in os.environ and not (_home and os.access(_home, os.W_OK)):
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="tipfem-cache-")
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_ENABLE_PYBUF", "0")  # a line about notebooks; kernels here print nothing

from tipfem.backend import taichi_patches  # noqa: E402 # isort: skip - before anything else imports Taichi

import taichi as ti  # noqa: E402 # isort: skip

from tipfem.backend import kept_kernels, vulkan  # noqa: E402
from tipfem.backend.host_kernels import Compiler  # noqa: E402

_ARCHES = {"cpu": ti.cpu, "cuda": ti.cuda, "vulkan": ti.vulkan}
_PRECISIONS = {"f64": ti.f64, "f32": ti.f32}
_running: dict[str, Any] = {}
_program: list[Any] = [None]  # the runtime that `init` has started
_forked = [False]
_threads = [1]
_driver: list[vulkan.Driver] = []
BIND_SWITCH = "TIPFEM_BIND_THREADS"


def init(arch: str = "cpu", precision: str = "f64", threads: int | None = None) -> None:
    """Start Taichi; once per process.

    On the CPU, if Taichi is to use all cores available to the process, each of its threads is bound to a core, unless
    the environment variable ``TIPFEM_BIND_THREADS`` is 0. A runtime that another package has started is replaced, and
    its fields are lost, as by every ``taichi.init``. If the folder in which Taichi keeps compiled kernels cannot be
    written to, a warning says where they go instead.

    Args:
        arch: "cpu"; "cuda" or "vulkan", by which a GPU gives the same: the processor runs the
            kernels that repair the mesh even then. Vulkan needs a driver with 64-bit floats; with Mesa's software
            driver, runs are limited to small meshes, see `require_short_loops`.
        precision: "f64" (the default) or "f32", of all reals in the kernels.
        threads: number of CPU threads; by default, and at most, as many as there are cores that the process may use.

    Raises:
        ValueError: an argument is not one of those.
        RuntimeError: the device is not there or has no 64-bit floats, Taichi already runs with other settings, or see
            `require_own_runtime`.
    """
    if not isinstance(arch, str) or arch not in _ARCHES:
        raise ValueError(f"init: arch is {arch!r}; it must be one of {sorted(_ARCHES)}")
    if not isinstance(precision, str) or precision not in _PRECISIONS:
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
        require_own_runtime()
        if _running != wanted:
            raise RuntimeError(f"init: Taichi already runs with {_running}; one process has one runtime, not {wanted}")
        return
    keep = kept_kernels.chosen()
    options: dict[str, Any] = {"default_fp": _PRECISIONS[precision], "log_level": ti.ERROR}
    options["cpu_max_num_threads"] = threads or cores
    # What is computed is what is written: with "fast math" the order of sums would depend on how a kernel is compiled.
    options["fast_math"] = False
    # On CPUs, LLVM does the same again, in a tenth of the time.
    options["cfg_optimization"] = arch != "cpu"
    _provide_cache()
    compiler = Compiler(precision) if keep and arch != "cpu" else None  # starts while Taichi does
    # "Starting on arch" is a bare print of Taichi's, and a missing GPU must be an error, not a CPU run.
    before = _own_threads()
    try:
        with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
            ti.init(arch=_ARCHES[arch], enable_fallback=False, **options)
    except Exception as error:
        if compiler:
            compiler.close()
        raise RuntimeError(f"init: Taichi cannot start on {arch!r}: {error}") from error
    if arch == "vulkan":
        _driver.append(vulkan.examine())
    _running.update(wanted)
    _program[0] = taichi_patches.program()
    _threads[0] = taichi_patches.running_threads()
    if keep:
        kept_kernels.start(min(_threads[0], kept_kernels.SHARES) if compiler else _threads[0], compiler)
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


def _provide_cache() -> None:
    """Keep Taichi's compiled kernels in a temporary folder if its own is not writable.

    It would end the process with a segmentation fault at its exit, even with its cache switched off.
    """
    folder = taichi_patches.cache_folder()
    reason = _unwritable(folder)
    if not reason:
        return
    user = os.getuid() if hasattr(os, "getuid") else "user"
    instead = Path(tempfile.gettempdir()) / f"tipfem-cache-{user}"
    with contextlib.suppress(OSError):
        instead.mkdir(mode=0o700, exist_ok=True)
    # What is in it will be executed, so nobody else may have made it.
    if _unwritable(instead) or (user != "user" and instead.stat().st_uid != user):
        instead = Path(tempfile.mkdtemp(prefix="tipfem-cache-"))
    os.environ["TI_OFFLINE_CACHE_FILE_PATH"] = str(instead)
    warnings.warn(
        f"compiled kernels cannot be kept in {str(folder)!r} ({reason}), so they go to {str(instead)!r}; let "
        "XDG_CACHE_HOME or TI_OFFLINE_CACHE_FILE_PATH name a folder that can be written to",
        stacklevel=3,
    )


def _unwritable(folder: Path) -> str:
    """Why files cannot be made in a folder, which is made if it is not there; empty if they can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return error.strerror or type(error).__name__


def require_init() -> None:
    """Start Taichi on the CPU in f64 if it does not run yet; see `require_own_runtime` for errors."""
    if _running:
        require_own_runtime()
    else:
        init()


def require_own_runtime() -> None:
    """Check that Taichi still runs as `init` has started it.

    `RuntimeError` if this process has been forked from the one in which it was started, or if other calls have started
    it again, or reset it.
    """
    if _forked[0]:
        raise RuntimeError(
            "this process was forked from one in which Taichi runs, whose threads it does not have; start it by "
            'multiprocessing.get_context("spawn"), or call tipfem.init only in the processes that simulate'
        )
    if taichi_patches.program() is not _program[0]:
        raise RuntimeError(
            "Taichi has been started again or reset since tipfem.init, by taichi.init or taichi.reset; the data of "
            "all simulations on it are lost. Call tipfem.init alone: other kernels can share its runtime"
        )


def _mark_as_forked() -> None:
    """In a child process: its copy of the runtime has no threads, and whatever waits for them would wait for ever."""
    _forked[0] = bool(_running)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_mark_as_forked)


def settings() -> dict[str, Any]:
    """Settings that Taichi was started with: arch, precision, threads; empty if it was not."""
    return dict(_running)


def on_cpu() -> bool:
    """Whether Taichi was started on the CPU."""
    return _running.get("arch") == "cpu"


def on_gpu() -> bool:
    """Whether Taichi was started on a GPU."""
    return _running.get("arch") in ("cuda", "vulkan")


def on_cuda() -> bool:
    """Whether Taichi was started on CUDA."""
    return _running.get("arch") == "cuda"


def on_vulkan() -> bool:
    """Whether Taichi was started on Vulkan."""
    return _running.get("arch") == "vulkan"


def counts_by_atomics() -> bool:
    """Whether atomic operations in loops can be relied on."""
    return not _driver or _driver[0].counts_in_loops


def longest_loop() -> int | None:
    """Number of iterations that one thread can make; None for any number."""
    return _driver[0].longest_loop if _driver else None


def require_short_loops(cells: int) -> None:
    """Raise `RuntimeError` unless one thread can loop over that many cells, see `tipfem.backend.vulkan.Driver`."""
    most = _driver[0].most_cells if _driver else None
    if most is not None and cells > most:
        raise RuntimeError(
            f"the mesh has {cells} cells; with this Vulkan driver, which ends every loop after "
            f"{_driver[0].longest_loop} iterations, it may have {most} at most. Choose arch 'cpu', or a GPU"
        )


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
    """Number of CPU threads of Taichi."""
    return _threads[0]
