"""What is changed in Taichi does not change results, and can be switched off."""

import ast
import importlib.util
import inspect
import json
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import taichi_patches
from tipfem.backend.launch import Kernel
from tipfem.backend.runtime import init

FIGURES = """
import hashlib, json
import tipfem as tp
from tipfem.backend import taichi_patches
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
filled = tp.tank((0.584, 0.584), 0.04).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
simulation = tp.Simulation(tp.Case(filled, [water, air], (0, -9.81), interface="interpolated"), time_step=2e-3)
while simulation.time < 0.02:
    simulation.step(0.02)
state = simulation.particles
bits = b"".join(a.tobytes() for a in (state.position, state.velocity, state.pressure, simulation.mesh.cells))
figures = [taichi_patches.ENABLED, hashlib.sha256(bits).hexdigest(), simulation.energy()[0]]
"""


@ti.data_oriented
class Shifted:
    """A kernel and its function in a class."""

    def __init__(self, shift):
        self.shift = shift

    @ti.func
    def shifted(self, i):
        return i + self.shift

    @ti.kernel
    def fill(self, values: ti.types.ndarray()):
        for i in range(values.shape[0]):
            values[i] = self.shifted(i)


@pytest.fixture(scope="module", autouse=True)
def _runtime():
    init()


def run(**environment):
    """Whether patches were made, and figures of a coarse dam break, computed with such an environment.

    With the interface rule that has fewer kernels: without patches each takes long to be made ready.
    """
    command = [sys.executable, "-c", FIGURES + "print(json.dumps(figures))"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_without_patches_and_without_binding_threads_the_bits_are_the_same():
    names = {}
    exec(FIGURES, names)  # in this process
    patched = names["figures"] if taichi_patches.ENABLED else run(TIPFEM_TAICHI_PATCHES="1")
    plain = run(TIPFEM_TAICHI_PATCHES="0", TIPFEM_BIND_THREADS="0")
    assert patched[0] is True
    assert plain[0] is False
    assert patched[1:] == plain[1:]
    assert patched[2] > 0


def test_threads_are_bound_to_cores_unless_they_must_not_be():
    code = (
        "import os, tipfem as tp; tp.init(); "
        "print(sum(len(os.sched_getaffinity(int(t))) == 1 for t in os.listdir('/proc/self/task')))"
    )
    bound = {}
    for switch in ("1", "0"):
        environment = {**os.environ, "TIPFEM_BIND_THREADS": switch}
        out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
        bound[switch] = int(out.stdout.split()[-1])
    cores = len(os.sched_getaffinity(0))
    assert bound == {"1": cores if cores > 1 else bound["0"], "0": bound["0"]}
    assert cores == 1 or bound["0"] == 0


def test_messages_of_taichi_say_file_line_and_kernel(tmp_path):
    """One line instead of Taichi's picture of the source: still enough to find the place."""
    source = "import taichi as ti\n\n@ti.kernel\ndef wrong(n: ti.i32):\n    m = n + nowhere\n"
    (tmp_path / "wrong_kernel.py").write_text(source)
    spec = importlib.util.spec_from_file_location("wrong_kernel", tmp_path / "wrong_kernel.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.raises(ti.TaichiCompilationError, match=r'wrong_kernel.py", line 5, in wrong'):
        module.wrong(3)


@pytest.mark.slow
def test_sources_are_found_as_python_finds_them():
    importlib.import_module("tipfem.run.simulation")  # which imports most of the kernels
    found = 0
    for module in [m for name, m in sys.modules.items() if name.startswith("tipfem.")]:
        for value in vars(module).values():
            function = (
                value.__wrapped__ if isinstance(value, Kernel) else getattr(getattr(value, "func", None), "func", None)
            )
            if inspect.isfunction(function):
                file, lines, first, text = taichi_patches._source(function)
                expected, number = inspect.getsourcelines(function)
                assert (file, first) == (inspect.getsourcefile(function), number)
                assert [line.rstrip() for line in expected] == lines[: len(expected)]
                assert ast.dump(ast.parse(text)) == ast.dump(ast.parse(textwrap.dedent("".join(expected))))
                found += 1
    assert found > 20


def test_kernels_in_classes_are_told_from_others():
    values = np.zeros(3, np.int32)
    Shifted(4).fill(values)
    assert values.tolist() == [4, 5, 6]
    assert inspect.getframeinfo(sys._getframe()).code_context  # as it was before Taichi was imported
