"""The same step in single precision, and on a GPU: each in a process of its own, for a process has one runtime."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys

import pytest

import tipfem as tp

FIGURES = """
def figures(interface):
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
    filled = tp.tank((0.584, 0.584), 0.02).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    case = tp.Case(filled, [water, air], (0, -9.81), interface=interface)
    simulation = tp.Simulation(case, time_step=1e-3)
    while simulation.time < 0.04:
        simulation.step(0.04)
    position = simulation.particles.position[simulation.particles.fluid == 0]
    return [*simulation.energy(), simulation.volume("water"), *position.max(axis=0).tolist(),
            float(simulation.particles.pressure.max())]
"""
SCRIPT = f"""
import json, sys
import tipfem as tp
tp.init(**json.loads(sys.argv[2]))
{FIGURES}
print(json.dumps(figures(sys.argv[1])))
"""


def run(interface="sharp", **settings):
    """Figures of a coarse dam break at t = 0.04 s, computed with ``tipfem.init(**settings)``."""
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, interface, json.dumps(settings)], capture_output=True, text=True, check=False
    )


@functools.cache
def on_the_cpu(interface):
    """The figures on the CPU in f64, in this process where it has that runtime."""
    if os.environ.get("TIPFEM_TEST_ARCH", "cpu") == "cpu":
        names = {"tp": tp}
        exec(FIGURES, names)
        return json.loads(json.dumps(names["figures"](interface)))
    done = run(interface, arch="cpu", precision="f64")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture
def reference():
    """The figures of the default rule for interfaces."""
    return on_the_cpu("sharp")


@pytest.mark.slow
@pytest.mark.parametrize("interface", ["interpolated", pytest.param("sharp", marks=pytest.mark.slow)])
def test_single_precision_gives_the_same_flow(interface):
    """In f32 the figures agree to 3 %, pressure to 10 %: corrections below its round-off are not made.

    No other test needs kernels in f32, and the rule that is quick has fewer of them to compile.
    """
    done = run(interface, arch="cpu", precision="f32")
    assert done.returncode == 0, done.stderr
    figures, reference = json.loads(done.stdout), on_the_cpu(interface)
    assert figures[:-1] == pytest.approx(reference[:-1], rel=0.03)
    assert figures[-1] == pytest.approx(reference[-1], rel=0.1)


@pytest.mark.slow
def test_one_thread_gives_the_same_bits(reference):
    """Sums do not depend on how many threads there are."""
    done = run(arch="cpu", precision="f64", threads=1)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == reference


@pytest.mark.gpu
def test_a_gpu_gives_the_same_flow(reference):
    """The same kernels on CUDA in f64; only the order of sums differs."""
    done = run(arch="cuda", precision="f64")
    if done.returncode and "cannot start on 'cuda'" in done.stderr:
        pytest.skip("no CUDA device")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == pytest.approx(reference, rel=1e-3)


@pytest.mark.slow
def test_a_missing_gpu_is_an_error_and_not_a_run_on_the_cpu():
    """Where CUDA is not there, one line says so."""
    done = run(arch="cuda")
    if done.returncode == 0:
        pytest.skip("there is a CUDA device")
    assert "RuntimeError: init: Taichi cannot start on 'cuda'" in done.stderr


def script(text, tmp_path, **environment):
    """A script run in a process of its own, from a file, for kernels are read from their source."""
    path = tmp_path / "script.py"
    path.write_text(text)
    return subprocess.run(
        [sys.executable, str(path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env={**os.environ, **environment},
    )


CASE = """
import multiprocessing
import numpy as np
import taichi as ti
import tipfem as tp
from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import kernel, launch
from tipfem.backend.array_types import Reals1

@kernel
def add(x: Reals1, n: ti.i32):
    for i in range(n):
        x[i] = x[i] + 1.0

water, air = tp.Fluid("water", 998.2, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
tank = tp.tank((0.5, 0.5), 0.05).fill(air).fill(water, box=((0, 0), (0.2, 0.2)))
case, buffers = tp.Case(tank, [water, air], (0, -9.81)), Buffers()

def answer(act):
    try:
        return ACTS[act]()
    except RuntimeError as error:
        return str(error)

ACTS = {
    "start": tp.init,
    "simulate": lambda: tp.Simulation(case),
    "array": lambda: buffers.upload("x", np.zeros(9)),
    "launch": lambda: launch(add, array, 9),  # it has been launched before
    "read": lambda: download(array, 9),
}
"""

FORKED = (
    CASE
    + """
tp.init(threads=1)
array = buffers.upload("y", np.zeros(9))
launch(add, array, 9)
with multiprocessing.get_context("fork").Pool(1) as pool:
    for act in ACTS:
        print(pool.apply_async(answer, [act]).get(timeout=60))
launch(add, array, 9)
print("the parent goes on:", download(array, 9)[0])
"""
)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "register_at_fork"), reason="there is no fork")
def test_a_forked_child_is_told_at_once_to_be_spawned(tmp_path):
    done = script(FORKED, tmp_path)
    assert done.returncode == 0, done.stderr
    *children, parent = done.stdout.splitlines()
    assert len(children) == 5
    assert all('multiprocessing.get_context("spawn")' in line for line in children)
    assert parent == "the parent goes on: 2.0"


RESTARTED = (
    CASE
    + """
ti.init(arch=ti.cpu, log_level=ti.ERROR)  # before the first start it does no harm
tp.init(threads=1)
array = buffers.upload("y", np.zeros(9))
launch(add, array, 9)
ti.init(arch=ti.cpu, log_level=ti.ERROR)
for act in ACTS:
    print("refused:", answer(act))
"""
)


@pytest.mark.slow
@pytest.mark.parametrize("patches", ["0", "1"])
def test_a_second_start_of_taichi_is_an_error_and_not_a_run_in_single_precision(patches, tmp_path):
    done = script(RESTARTED, tmp_path, TIPFEM_TAICHI_PATCHES=patches)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("refused")]
    assert len(lines) == 5
    assert all("has been started again or reset since tipfem.init" in line for line in lines)


def test_a_cache_that_cannot_be_written_is_said_in_a_warning(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "other").mkdir()
    text = "from tipfem.backend import kept_kernels as kept; kept.SHIPPED /= 'none'\n"  # a wheel was built in this tree
    text += "import tipfem as tp; from tipfem.backend.arrays import Buffers; tp.init(threads=1)\n"
    text += "import numpy; b = Buffers(); b.upload('x', numpy.zeros(3)); b.grow('x', 99)"
    done = script(text, tmp_path, TI_OFFLINE_CACHE_FILE_PATH=str(tmp_path / "file"), TMPDIR=str(tmp_path / "other"))
    assert done.returncode == 0, done.stderr  # it was a segmentation fault
    assert f"compiled kernels cannot be kept in '{tmp_path / 'file'}'" in done.stderr
    kept = [path for path in (tmp_path / "other").rglob("*") if path.is_file()]
    assert kept, "kernels are kept nowhere"
