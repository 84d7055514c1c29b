"""The other end of a `tipfem.backend.host_kernels.Compiler`: a process in which Taichi runs on the processor."""

import contextlib
import importlib
import os
import pickle
import sys
from collections.abc import Sequence
from typing import Any


def serve(precision: str) -> None:
    """Answer a `Compiler` until it closes the pipe: first with Taichi's settings, then with what kept kernels away."""
    # A parent whose device is not there has closed the pipe already.
    with contextlib.suppress(BrokenPipeError), os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # what is printed from here on, as Taichi is imported too, is no answer
        from tipfem.backend import kept_kernels, runtime, taichi_patches

        runtime.init("cpu", precision, threads=1)
        kept = kept_kernels.open_library()
        pickle.dump(("" if kept else "it keeps no kernels", taichi_patches.compiled_for()), answers)
        answers.flush()
        while kept:
            try:
                module, name, arguments = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            pickle.dump(("", _make(module, name, arguments)), answers)
            answers.flush()


def _make(module: str, name: str, arguments: Sequence[Any]) -> str:
    """Compile a kernel for arguments of the kinds of these; why that cannot be done, empty if it was."""
    from tipfem.backend.launch import Kernel

    try:
        kernel = getattr(importlib.import_module(module), name, None)
    except ImportError:
        kernel = None
    if not isinstance(kernel, Kernel):
        return f"{module} has no kernel {name}"
    return "" if kernel.keep(arguments) else "it cannot be kept"
