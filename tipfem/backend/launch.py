"""The one way to define a kernel, `kernel`, and to start it, `launch`.

A kernel may end its list of parameters with some of these names, in any order. They determine how its loops are shared
among threads; `launch` fills them in, so that callers need not:

- ``parts``: into how many parts long loops and their sums are split. It does not depend on the number of threads, so
  that sums are repeatable bit by bit. Arrays of partial sums have as many rows, see `tipfem.backend.arrays`.
- ``stride`` (a template): how many iterations of a parallel loop belong to one part, of which only the first works, see
  `part_of`. Taichi gives a CPU thread at least 512 iterations: a loop over as many parts as there are threads would
  run on one thread.
- ``serial`` (a template): whether the loops run on one thread, ``ti.loop_config(serialize=serial)``, because there is
  less to do than waking the others costs. Results are the same.
- ``one_counts`` (a template): whether one thread counts and lists faster than several do by atomic operations.
- ``threads`` and ``barrier``: how many threads share the kernel, and the array by which they wait for each other; see
  `tipfem.backend.barrier`.

Arrays and numbers that belong together may be one parameter, see `tipfem.backend.bundles`.

An example, started by ``launch(add, x, y, n, work=(n, 2.0))``:

    @kernel
    def add(x: Reals1, y: Reals1, n: ti.i32, serial: Template):
        ti.loop_config(serialize=serial)
        for i in range(n):
            y[i] = y[i] + x[i]
"""

import functools
import inspect
import os
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import taichi as ti

from tipfem.backend import barrier as barriers
from tipfem.backend import kept_kernels, runtime
from tipfem.backend.array_types import Array1, Array2, mismatch
from tipfem.backend.bundles import unbundle
from tipfem.backend.kept_kernels import KeptLaunch
from tipfem.backend.taichi_patches import ENABLED, PreparedLaunch, program

PARTS, PARTS_OF_GPU = 16, 4096
ITERATIONS = 512  # of a parallel loop that Taichi gives to one CPU thread at least
WORTH_WAKING = 1.2e5  # [ns] of work of one thread above which waking the others, which takes 10 to 50 us, pays
FEW_THREADS = 4  # with no more than these, atomic operations cost more than sharing a loop saves
RECENT = 4  # launches of a kernel with one first array, but others beside it, that are tried before the longer way
_INTEGER = type(ti.i32)
SCHEDULING: dict[str, Any] = {
    "parts": _INTEGER,
    "stride": ti.template,
    "serial": ti.template,
    "one_counts": ti.template,
    "threads": _INTEGER,
    "barrier": ti.types.ndarray,
}

# Device arrays, by their identity, whose values are still on the host and what brings them there; and those of which a
# copy on the host is as they are, with it: see `tipfem.backend.staging`.
awaited: dict[int, Any] = {}
flushes: list[Callable[[], None]] = []
fetched: dict[int, tuple[Any, np.ndarray]] = {}
_imposed: list[bool] = []  # see `every_schedule`
_kernels: "weakref.WeakSet[Kernel]" = weakref.WeakSet()
# Launches prepared for each device array; they are dropped with the array.
_users: dict[int, tuple[Any, set[tuple["Kernel", Any]]]] = {}


class Kernel:
    """A Taichi kernel that `launch` starts; made by `kernel`.

    Attributes:
        taichi: the kernel as `ti.kernel` returns it.
        parameters: names of those that the caller passes.
        count: of the arguments, with the fields of bundles one by one.
        unbundled: makes the fields of passed arguments single ones; None where there are no bundles.
        scheduling: names of those that `launch` fills in.
        waits: whether its threads wait for each other at barriers.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        passed = inspect.signature(function).parameters
        self.parameters = tuple(name for name in passed if name not in SCHEDULING)
        self.unbundled = unbundle(function, SCHEDULING)
        self.taichi: Any = ti.kernel(function)
        self.__name__, self.__qualname__ = function.__name__, function.__qualname__
        self.__doc__, self.__module__, self.__wrapped__ = function.__doc__, function.__module__, function
        parameters = inspect.signature(function).parameters
        names = list(parameters)
        self.scheduling = tuple(name for name in names if name in SCHEDULING)
        self._names = names
        self.count = count = len(names) - len(self.scheduling)
        if any(name in SCHEDULING for name in names[:count]):
            raise TypeError(f"{self.__name__}: {', '.join(self.scheduling)} must be the last parameters")
        kinds = [parameters[name].annotation for name in names]
        self._annotations = kinds
        for name, kind in zip(names, kinds, strict=True):
            if name in SCHEDULING and not isinstance(kind, SCHEDULING[name]):
                raise TypeError(f"{self.__name__}: {name} is filled in by launch, but is not of the type for that")
        self._arrays = [i for i, kind in enumerate(kinds) if isinstance(kind, ti.types.ndarray)]
        self._templates = [i for i, kind in enumerate(kinds) if isinstance(kind, ti.template)]
        self._may_be_serial = "serial" in self.scheduling
        self._counts = "one_counts" in self.scheduling
        self.waits = "threads" in self.scheduling
        self._prepared: dict[Any, KeptLaunch | PreparedLaunch] = {}
        self._not_kept: set[Any] = set()  # keys of launches on the host for which there is no machine code
        # Those that can be started by `quick_launch`, by the first device array, 0 for NumPy's; the last first.
        self._recent: dict[int, list[KeptLaunch]] = {}
        self._first = next((i for i in self._arrays if i < count), None)
        self._schedules: dict[Any, tuple[Any, ...]] = {}
        _kernels.add(self)

    def __repr__(self) -> str:
        return f"<kernel {self.__name__}({', '.join(self.parameters)})>"

    def schedule(self, work: tuple[float, float] | None, host: bool = True) -> tuple[Any, ...]:
        """Values of the parameters in ``scheduling``, by ``work``, see `launch`; one thread for those that wait."""
        serial = False
        if self._may_be_serial:
            if work is None:
                raise TypeError(f"launch: {self.__name__} has a parameter serial; pass work=(count, nanoseconds)")
            serial = host and is_serial(*work)
        one_counts = self._counts and (host or not runtime.counts_by_atomics()) and few_threads()
        known = self._schedules.get((serial, one_counts, host))
        if known is None:
            values = {
                "parts": PARTS if host else parts(),
                "stride": ITERATIONS if host and not serial else 1,
                "serial": serial,
                "one_counts": one_counts,
                "threads": 1,
                "barrier": barriers.array() if self.waits else None,
            }
            known = self._schedules[serial, one_counts, host] = tuple(values[name] for name in self.scheduling)
        return known

    def start(self, arguments: tuple[Any, ...]) -> Any:
        """Start the kernel with all of its arguments; what it returns."""
        present = program()
        for recent in self._recent.get(self._number(arguments), ()):
            if recent.program is present and recent.quick(arguments, recent.plan) == 0:
                return recent.returned()
        if runtime.on_vulkan() and self not in (copy, copy_rows) and not self._prepare_on_host(arguments):
            return self._start_on_copies(arguments)
        return self._start(arguments)

    def on_host(self, arguments: tuple[Any, ...]) -> bool:
        """Whether a processor runs the kernel, beside a GPU, too."""
        return runtime.on_cpu() or (kept_kernels.open_library() and kept_kernels.on_host(self._annotations, arguments))

    def keep(self, arguments: Sequence[Any]) -> KeptLaunch | None:
        """The kernel by its machine code, which is made and kept where it is not yet; None if it cannot be kept."""
        return kept_kernels.prepare(self.taichi, self._annotations, arguments)

    def _prepare_on_host(self, arguments: tuple[Any, ...]) -> bool:
        """Prepare the kernel for the processor, if that runs it; whether it does."""
        if not (ENABLED and self.on_host(arguments)):
            return False
        key = self._key(arguments)
        known = self._prepared.get(key)
        if (known is None or known.program is not program()) and key not in self._not_kept:
            self._check(arguments)
            known = self.keep(arguments)
            if known is None:
                self._not_kept.add(key)
            else:
                self._prepared[key] = known
        return known is not None

    def _start_on_copies(self, arguments: tuple[Any, ...]) -> Any:
        """Start the kernel with device arrays in place of the arrays of NumPy, which are read back afterwards.

        On Vulkan, Taichi does not copy an array of NumPy to the device if the kernel only writes it, but reads all of
        it back: entries that the kernel leaves alone would be lost.
        """
        self._check(arguments)
        given, staged = list(arguments), []
        for i in self._arrays:
            host = arguments[i]
            if isinstance(host, np.ndarray) and host.size:
                if not host.flags.c_contiguous:
                    raise ValueError(f"{self.__name__}: an array of shape {host.shape} is not C-contiguous")
                given[i] = device = ti.ndarray(_TYPES[host.dtype.type], host.shape)
                if host.ndim > 2:
                    device.from_numpy(host)
                    continue
                copying = copy if host.ndim == 1 else copy_rows
                copying._start((host, device, len(host)))
                staged.append((copying, device, host))
        result = self._start(tuple(given))
        for copying, device, host in staged:
            copying._start((device, host, len(host)))
        return result

    def _start(self, arguments: tuple[Any, ...]) -> Any:
        if awaited or fetched:
            numbers = set(map(id, arguments))
            if not awaited.keys().isdisjoint(numbers):
                flushes[0]()
            for number in fetched.keys() & numbers:
                del fetched[number]
        if not ENABLED:
            runtime.require_own_runtime()
            self._check(arguments)
            return self.taichi(*arguments)
        key = self._key(arguments)
        prepared = self._prepared.get(key)
        if prepared is None or prepared.program is not program():
            prepared = self._prepare(key, arguments)
        if isinstance(prepared, KeptLaunch) and prepared.plan:
            number = self._number(arguments)
            recent = self._recent.get(number, [])
            if prepared not in recent:
                self._recent[number] = [prepared, *recent[: RECENT - 1]]
        try:
            return prepared(arguments)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{self.__name__}: {error}") from error

    def _number(self, arguments: tuple[Any, ...]) -> int:
        """Number of the first array, by which a recent launch is found; 0 for one of NumPy, or none."""
        first = None if self._first is None else arguments[self._first]
        return id(first) if isinstance(first, ti.Ndarray) else 0

    def _key(self, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        """Common key of launches that share their preparation."""
        arrays = map(arguments.__getitem__, self._arrays)
        kinds = [(a.dtype.num, a.ndim) if type(a) is np.ndarray else id(a) for a in arrays]
        return (*kinds, *map(arguments.__getitem__, self._templates))

    def _prepare(self, key: Any, arguments: tuple[Any, ...]) -> KeptLaunch | PreparedLaunch:
        runtime.require_own_runtime()
        self._check(arguments)
        prepared = self._prepared[key] = self.keep(arguments) or PreparedLaunch(self.taichi, arguments)
        for i in self._arrays:
            array = arguments[i]
            if isinstance(array, ti.Ndarray):
                number = id(array)
                if number not in _users:
                    _users[number] = (weakref.ref(array, functools.partial(_forget, number)), set())
                _users[number][1].add((self, key))
        return prepared

    def _check(self, arguments: tuple[Any, ...]) -> None:
        """Raises TypeError unless all arrays are given and are of the right kind."""
        for i in self._arrays:
            name = self._names[i].replace("__", ".")
            if not isinstance(arguments[i], (np.ndarray, ti.Ndarray)):
                raise TypeError(f"{self.__name__}: {name} is {arguments[i]!r}; it must be an array")
            wrong = mismatch(self._annotations[i], arguments[i])
            if wrong:
                raise TypeError(f"{self.__name__}: {name} {wrong}")


def _forget(number: int, _: Any) -> None:
    """Drop the launches prepared for a device array that was deleted."""
    _, users = _users.pop(number)
    for user, key in users:
        user._prepared.pop(key, None)
        user._recent = {}


def _forget_all() -> None:
    """In a child process: prepare all launches anew, which is refused there; see `runtime.require_own_runtime`."""
    for each in list(_kernels):
        each._prepared.clear()
        each._recent = {}


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_all)


def kernel(function: Callable[..., Any]) -> Kernel:
    """A decorator: the function becomes a Taichi kernel that `launch` starts.

    It is defined in a module, and annotated with types of `tipfem.backend.array_types` or Taichi's own; `TypeError` if
    a parameter that `launch` fills in comes before one that it does not.
    """
    return Kernel(function)


def launch(kernel: Kernel, *arguments: Any, work: tuple[float, float] | None = None) -> Any:
    """Start a kernel; what it returns.

    ``arguments`` are for the parameters that are not filled in here, see above: device arrays of scalars, C-contiguous
    NumPy arrays, and numbers. Their types are examined once and remembered, because that takes Taichi longer than many
    kernels run. ``work`` is how much there is to do, a count, and how many nanoseconds one thread takes for each, which
    kernels with ``serial`` need. `TypeError` if arguments are missing, too many, or of the wrong type; `ValueError` if
    an array is not C-contiguous.
    """
    if len(arguments) != len(kernel.parameters):
        wanted = ", ".join(kernel.parameters)
        raise TypeError(
            f"{kernel.__name__} takes {len(kernel.parameters)} arguments ({wanted}); {len(arguments)} given"
        )
    if kernel.unbundled is not None:
        try:
            arguments = kernel.unbundled(*arguments)
        except TypeError as error:
            raise TypeError(f"{kernel.__name__}: a bundle is missing: {error}") from None
        if len(arguments) != kernel.count:
            raise TypeError(f"{kernel.__name__}: its bundles have {kernel.count} fields in all, not those given")
    if not kernel.scheduling:
        return kernel.start(arguments)
    schedule = kernel.schedule(work, runtime.on_cpu() or kernel.on_host((*arguments, *kernel.scheduling)))
    if not kernel.waits:
        return kernel.start(arguments + schedule)
    serial = work is not None and is_serial(*work)
    with barriers.sharing(1 if serial else min(runtime.threads(), parts())) as count:
        at = kernel.scheduling.index("threads")
        return kernel.start((*arguments, *schedule[:at], count, *schedule[at + 1 :]))


def parts() -> int:
    """Into how many parts long loops and their sums are split; a constant, so that sums are repeatable."""
    return PARTS_OF_GPU if runtime.on_gpu() and runtime.longest_loop() is None else PARTS


def is_serial(count: float, cost: float) -> bool:
    """Whether loops of ``count`` iterations of ``cost`` nanoseconds each are faster on one thread."""
    if _imposed:
        return _imposed[0]
    return runtime.threads() == 1 or count * cost < WORTH_WAKING


def every_schedule() -> Iterator[None]:
    """Three rounds in which all loops count as short, as long, and as long with many threads.

    They are for compiling kernels ahead: in each round kernels are launched as they are in runs of some size.
    """
    try:
        for schedule in (True, True), (False, True), (False, False):
            _imposed[:] = schedule
            yield
    finally:
        _imposed.clear()


def few_threads() -> bool:
    """Whether one thread is to count and list: atomic operations cost more than sharing saves, or are not reliable."""
    if _imposed:
        return _imposed[1]
    return runtime.threads() <= FEW_THREADS or not runtime.counts_by_atomics()


@kernel
def copy(source: Array1, target: Array1, n: ti.i32):  # type: ignore[no-untyped-def]
    """Copy the first ``n`` entries."""
    for i in range(n):
        target[i] = source[i]


@kernel
def copy_rows(source: Array2, target: Array2, n: ti.i32):  # type: ignore[no-untyped-def]
    """Copy the first ``n`` rows."""
    for i in range(n):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


_TYPES = {np.int8: ti.i8, np.int32: ti.i32, np.int64: ti.i64, np.float32: ti.f32, np.float64: ti.f64}


@ti.func
def part_of(t, parts, stride: ti.template(), n):  # type: ignore[no-untyped-def]
    """The range of iteration ``t`` of ``parts * stride`` in 0 ... n, first and last + 1; empty for idle iterations."""
    first, last = 0, 0
    if t % stride == 0:
        size = (n + parts - 1) // parts
        first = ti.min(t // stride * size, n)
        last = ti.min(first + size, n)
    return first, last


@ti.func
def close_gaps(listed: ti.template(), found: ti.template(), parts, n):  # type: ignore[no-untyped-def]
    """Number of those listed in all, where part p lists found[p] of its range of 0 ... n - 1 from its first place on.

    They are moved behind those of the parts before: so a list is ascending if each part's is.
    """
    count = 0
    for part in range(parts):
        first = ti.min(part * ((n + parts - 1) // parts), n)
        if count < first:
            for k in range(found[part]):
                listed[count + k] = listed[first + k]
        count += found[part]
    return count


FEW_PARTS = 64  # that one thread adds up; a GPU's are folded to so many before


def shared_by_gpu(stride: int, serial: bool = False) -> bool:
    """In ``ti.static``: whether a kernel's loops over parts are compiled for a GPU."""
    return stride == 1 and not serial


@ti.func
def folds(parts, columns):  # type: ignore[no-untyped-def]
    """Number of iterations of the loop that folds partial sums (parts, columns); 0 where there are few parts."""
    return ti.select(parts > FEW_PARTS, FEW_PARTS * columns, 0)


@ti.func
def fold_parts(partial: ti.template(), t, columns, parts):  # type: ignore[no-untyped-def]
    """Iteration ``t`` of this loop: add a column's entries in every `FEW_PARTS`-th row, ``parts`` of them in all."""
    first, k = t // columns, t % columns
    total = partial[first, k]
    for m in range(1, (parts - first + FEW_PARTS - 1) // FEW_PARTS):
        total += partial[first + m * FEW_PARTS, k]
    partial[first, k] = total


@ti.func
def add_parts(result: ti.template(), partial: ti.template(), k, parts):  # type: ignore[no-untyped-def]
    """Add column ``k`` of the partial sums (parts, .) to result[k], part by part."""
    total = result[k]  # in a register: a GPU would wait for its memory at every part
    for c in range(parts):
        total += partial[c, k]
    result[k] = total
