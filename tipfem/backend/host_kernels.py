"""Kernels that the processor runs beside a GPU: those all of whose arrays are NumPy's.

Repairs of the triangulation and lists of faces are loops that hardly any threads can share, on arrays in the host's
memory. A thread of a GPU takes a hundred times as long for them as one of a processor, and the arrays would be copied
there and back. So their machine code is taken from the library of kernels, as on a processor. One Taichi compiles for
one device only: what is not kept yet is made by a `Compiler`, a process in which Taichi runs on the processor.
"""

import atexit
import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from tipfem.backend.fingerprint import NotKeptError
from tipfem.backend.machine_code import UnsuitableError


class Compiler:
    """A process that makes and keeps machine code for the processor, in "f64" or "f32"; it ends with this one."""

    def __init__(self, precision: str) -> None:
        code = f"from tipfem.backend.host_compiler import serve; serve({precision!r})"
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={name: value for name, value in os.environ.items() if not name.startswith("TI_ARCH")},
            start_new_session=True,  # an interruption from the keyboard is for this process
        )
        self._settings: str | None = None
        atexit.register(self.close)

    def settings(self) -> str:
        """All of Taichi's settings there that code may depend on; `UnsuitableError` if it keeps no kernels."""
        if self._settings is None:
            self._settings = self._answer()
        return self._settings

    def add(self, kernel: Any, arguments: Sequence[Any]) -> None:
        """Compile a kernel for arguments, none of them a device array, and keep its machine code.

        `NotKeptError` if it cannot be found by its module and name, or its code is not kept; `UnsuitableError` if the
        process has ended.
        """
        function = kernel._primal.func
        alike = [np.zeros((1,) * one.ndim, one.dtype) if isinstance(one, np.ndarray) else one for one in arguments]
        try:
            request = pickle.dumps((function.__module__, function.__qualname__, alike))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise NotKeptError(f"an argument cannot be told to another process: {error}") from error
        self.settings()
        with contextlib.suppress(OSError):  # told by the answer that is missing
            assert self._process.stdin is not None
            self._process.stdin.write(request)
            self._process.stdin.flush()
        if reason := self._answer():
            raise NotKeptError(reason)

    def _answer(self) -> str:
        assert self._process.stdout is not None
        try:
            reason, text = pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError, OSError) as error:
            raise UnsuitableError("the process that compiles kernels for the processor has ended") from error
        if reason:
            raise UnsuitableError(reason)
        return str(text)

    def close(self) -> None:
        """End the process."""
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()
        self._process.wait()
