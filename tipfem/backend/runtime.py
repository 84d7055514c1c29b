"""Start Taichi, and keep its arrays.

Taichi recompiles a kernel for every new field, but not for an ndarray of another length, and it
never frees ndarrays of vectors. So all device arrays here are scalar ndarrays that grow and are
used again; kernels are told how much of them is alive.
"""

import contextlib
import inspect
import os
import tempfile
from typing import Any

import numpy as np

# Without a writable home, Taichi ends the process on import or at exit; a cache elsewhere cures it.
_home = os.environ.get("HOME", "")
if "XDG_CACHE_HOME" not in os.environ and not (_home and os.access(_home, os.W_OK)):
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="tipfem-cache-")
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")


def _place(frame: Any, context: int = 1) -> Any:
    """What `inspect.getframeinfo` says of a frame, without the source: Taichi reads that to tell whether its own
    kernels stand in a class, which takes a third of its import. None of them does; no source means the same to it."""
    return inspect.Traceback(frame.f_code.co_filename, frame.f_lineno, frame.f_code.co_name, None, None)


_getframeinfo, inspect.getframeinfo = inspect.getframeinfo, _place
try:
    import taichi as ti
finally:
    inspect.getframeinfo = _getframeinfo

from taichi.lang import impl  # noqa: E402

from tipfem.backend.launch import Launcher, on_host, seen  # noqa: E402

_ARCHES = {"cpu": ti.cpu, "cuda": ti.cuda}
_PRECISIONS = {"f64": ti.f64, "f32": ti.f32}
_running: dict[str, Any] = {}
_threads = [1]


def init(arch: str = "cpu", precision: str = "f64", threads: int | None = None) -> None:
    """Start Taichi; once a process.

    Args:
        arch: "cpu" or "cuda".
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
    _threads[0] = int(impl.current_cfg().cpu_max_num_threads)  # which the environment may change
    if arch == "cpu":
        _give_each_a_core([thread for thread in _own_threads() if thread not in before], _threads[0])


def _own_threads() -> list[int]:
    """The threads of this process in the order of their creation; none where the system does not tell."""
    try:
        return [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return []


def _give_each_a_core(started: list[int], threads: int) -> None:
    """Bind Taichi's workers, the last of the threads it ``started``, to a core each, if they are to use all cores.

    Their turns are short and so are the pauses between them. Schedulers then like to keep them on one core, and two
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


def real() -> Any:
    """The NumPy type of the kernels' reals."""
    return np.float32 if _running.get("precision") == "f32" else np.float64


def round_off() -> float:
    """Displacement in spacings below which a residual is noise, with a light fluid under a heavy one's pressure."""
    return 1e-4 if _running.get("precision") == "f32" else 1e-13


def chunks() -> int:
    """Into how many parts long loops and their sums are split; a constant, so that sums are repeatable."""
    return 4096 if _running.get("arch") == "cuda" else 16


def spread(alone: bool = False) -> int:
    """How many turns of a parallel loop each of those parts takes, all but one of them idle.

    On the CPU, Taichi hands 512 turns at least to a thread: a loop over as many parts as threads would run in one.
    """
    return 1 if alone or _running.get("arch") == "cuda" else 512


def alone(turns: int, cost: float) -> bool:
    """Whether loops of so many turns, ``cost`` nanoseconds each on one thread, had better be done by one thread.

    To wake the others takes 10 to 50 us a loop. It is an argument ``alone`` of kernels; results are the same.
    """
    return _running.get("arch") == "cpu" and (_threads[0] == 1 or turns * cost < WORTH_WAKING)


WORTH_WAKING = 1.2e5  # [ns]


def together() -> bool:
    """Whether threads can wait for each other inside a kernel, see `tipfem.backend.barrier`."""
    return _running.get("arch") == "cpu"


def threads() -> int:
    """How many threads Taichi has on the processor."""
    return _threads[0]


@ti.func
def part_of(t, parts, spread: ti.template(), n):  # type: ignore[no-untyped-def]
    """First and last + 1 of 0 ... n that turn ``t`` of ``parts * spread`` has to do; nothing for idle turns."""
    first, last = 0, 0
    if t % spread == 0:
        size = (n + parts - 1) // parts
        first = ti.min(t // spread * size, n)
        last = ti.min(first + size, n)
    return first, last


class Buffers:
    """Device arrays by name, grown when needed and used again.

    Attributes:
        launch: starts kernels that work on them.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Any] = {}
        self.launch = Launcher()

    def get(self, name: str, rows: int, columns: int = 0, *, integer: bool = False) -> Any:
        """A device array with at least ``rows`` rows; what it holds is undefined.

        Args:
            name: the array's name; one name keeps one width and type.
            rows: how many rows will be used.
            columns: width of a two-dimensional array; 0 for a one-dimensional one.
            integer: int32 instead of real.
        """
        array = self._arrays.get(name)
        if array is None or array.shape[0] < rows or (columns and array.shape[1] != columns):
            capacity = max(rows + rows // 8, 16)
            if array is not None and array.shape[0] >= rows:
                capacity = array.shape[0]
            shape = (capacity, columns) if columns else (capacity,)
            if array is not None:
                self.launch.forget()  # or the old one would be kept
            array = ti.ndarray(ti.i32 if integer else _PRECISIONS[_running["precision"]], shape)
            self._arrays[name] = array
        return array

    def grow(self, name: str, rows: int) -> Any:
        """A one-dimensional array of reals with at least ``rows`` rows, which keeps what it holds when it grows."""
        old = self._arrays.get(name)
        array = self.get(name, rows)
        if old is not None and array is not old:
            _copy(old, array, old.shape[0])
        return array

    def upload(self, name: str, values: np.ndarray) -> Any:
        """Copy a NumPy array of one or two dimensions into the device array of that name."""
        integer = values.dtype.kind in "iub"
        columns = values.shape[1] if values.ndim == 2 else 0
        array = self.get(name, len(values), columns, integer=integer)
        if on_host():
            seen(array)[: len(values)] = values
        elif len(values):
            values = np.ascontiguousarray(values, dtype=np.int32 if integer else real())
            (_copy_rows if values.ndim == 2 else _copy)(values, array, len(values))
        return array

    def memory(self) -> int:
        """Bytes held."""
        return sum(int(np.prod(a.shape)) * (4 if a.dtype in (ti.i32, ti.f32) else 8) for a in self._arrays.values())


def download(array: Any, rows: int) -> np.ndarray:
    """The first ``rows`` rows of a device array, as a NumPy array."""
    if on_host():
        return seen(array)[:rows].copy()
    width = array.shape[1:]
    values = np.empty((rows, *width), dtype=np.int32 if array.dtype == ti.i32 else real())
    if rows:
        (_copy_rows if width else _copy)(array, values, rows)
    return values


@ti.kernel
def _copy(source: ti.types.ndarray(), target: ti.types.ndarray(), n: ti.i32):
    for i in range(n):
        target[i] = source[i]


@ti.kernel
def _copy_rows(source: ti.types.ndarray(), target: ti.types.ndarray(), n: ti.i32):
    for i in range(n):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@ti.kernel
def _copy_parts(
    source: ti.types.ndarray(), target: ti.types.ndarray(), n: ti.i32, parts: ti.i32, spread: ti.template()
):
    for t in range(parts * spread):
        first, last = part_of(t, parts, spread, n)
        for i in range(first, last):
            target[i] = source[i]


def copy(source: Any, target: Any, n: int) -> None:
    """Copy the first ``n`` entries as fast as the memory allows: the measure of what kernels could reach."""
    _copy_parts(source, target, n, chunks(), spread())


def finish() -> None:
    """Wait until the device has done all that was asked of it; the CPU always has."""
    ti.sync()
