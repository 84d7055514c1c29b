"""Vulkan, on any driver with 64-bit floats: the kernels against their twins, and steps against those of the CPU.

Each run has a process of its own, for a process has one runtime.
"""

import functools
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import taichi as ti

from tipfem.backend import kept_kernels, runtime, taichi_patches, vulkan
from tipfem.backend import launch as launches
from tipfem.backend.array_types import Ints1
from tipfem.backend.launch import kernel, launch

ROOT = Path(__file__).resolve().parents[2]
# What is reached, see below; bodies with convex corners, as a coarse circle has, read forces and growth more often.
CROSSING = {"sharp": 18, "tension": 18, "open": 22, "floating": 48, "corners": 50}
KINDS = ("sharp", "interpolated", "free surface", "graded", "two-sided", "liquids", "floating", "tension", "open")
KINDS += ("corners", "contact", "mud", "axisymmetric", "space", "space of two")

STEPS = """
import sys
import numpy as np
import tipfem as tp
from tipfem.backend.launch import Kernel
from tipfem.step.linear_system import LinearSystem
LAST = 10  # steps that are counted
arch, kind, steps, out = sys.argv[1:]
tp.init(arch=arch)
if arch == "cpu":  # which alone reduces systems to the pressures: both are to solve the same ones
    LinearSystem._is_reducible = lambda system: False
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
tank = tp.tank((0.584, 0.584), 0.04, coordinates="axisymmetric" if kind == "axisymmetric" else "planar")
space = kind.startswith("space")
if space:
    tank = tp.tank((0.4, 0.2, 0.2), 0.05, jitter=0.1)
if kind == "mud":
    law = tp.HerschelBulkley(yield_stress=20.0, consistency=1.0, index=0.5)
    water = tp.Fluid("water", density=1500.0, viscosity=law)
other = tp.Fluid("oil", density=800.0, viscosity=5e-3) if kind == "liquids" else air
free = kind in ("free surface", "contact", "space")
if not free:
    tank.fill(other)
if space:
    tank.fill(water, box=((0, 0, 0), (0.2, 0.2, 0.2 if free else 0.1)))
else:
    tank.fill(water, box=((0, 0), (0.584 if kind in ("liquids", "contact") else 0.146, 0.292)))
gravity = (0.0, 0.0, -9.81) if space else (6.0 if kind == "liquids" else 0.0, -9.81)
if kind == "floating":
    tank.add(tp.Body(tp.shapes.circle((0.34, 0.3), 0.1), density=300.0, angular_velocity=3.0))
    tank.wall("bottom", law="layer")
if kind == "corners":
    tank.add(tp.Body(tp.shapes.rectangle((0.3, 0.2), (0.46, 0.3)), density=500.0, angular_velocity=3.0))
if kind == "contact":  # a box that the water carries along the floor
    box = tp.shapes.rectangle((0.2, 0.0), (0.36, 0.08))
    tank.add(tp.Body(box, density=3000.0, gap="seep", friction=0.1, free=("x", "y"), velocity=(0.3, 0.0)))
options = {
    "interpolated": {"interface": "interpolated"},
    "graded": {"grading": tp.Grading({"air": 0.16})},
    "two-sided": {"numerics": tp.Numerics(pressure="two-sided")},
    "tension": {"surface_tension": {("water", "air"): 20.0}},
    "open": {
        "openings": [
            tp.Inlet(wall="bottom", between=((0.3, 0), (0.5, 0)), fluid=water, velocity=0.5),
            tp.Vent(wall="top", between=((0.1, 0.584), (0.3, 0.584))),
        ]
    },
}.get(kind, {"free_surface": True} if free else {})
fluids = [water] if free else [water, other]
simulation = tp.Simulation(tp.Case(tank, fluids, gravity, **options), time_step=6e-3 if kind == "liquids" else 1.2e-3)
launches, crossing = 0, 0
start = Kernel.start


def counted(self, arguments):
    global launches, crossing
    if not self.on_host(arguments):
        launches += 1
        crossing += sum(isinstance(a, np.ndarray) for a in arguments)
        returned = start(self, arguments)
        crossing += returned is not None
        return returned
    return start(self, arguments)


for step in range(int(steps)):
    if step == int(steps) - LAST:
        Kernel.start = counted
    simulation.step()
Kernel.start = start
assert ("sliding_liquids" in simulation.state.parts) == (kind == "liquids")
state = simulation.particles
krylov = sum(row["krylov_iterations"] for row in simulation.history[-LAST:])
a_step = np.array([launches, crossing, krylov]) / LAST
np.savez(out, a_step=a_step, x=state.position, v=state.velocity, p=state.pressure, cells=simulation.mesh.cells)
"""


def run(*command, **environment):
    """A Python command, in the repository's root."""
    return subprocess.run(
        [sys.executable, *command],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, **environment},
    )


@functools.cache
def why_not():
    """Why Taichi does not start on Vulkan here; an empty string if it does."""
    done = run("-c", "import tipfem as tp; tp.init(arch='vulkan')")
    return done.stderr.strip().splitlines()[-1] if done.returncode else ""


@pytest.fixture
def driver():
    """Skip without a Vulkan driver, unless one is demanded: then the test fails."""
    if why_not():
        assert os.environ.get("TIPFEM_REQUIRE_VULKAN") != "1", why_not()
        pytest.skip(why_not())


@pytest.mark.slow
@pytest.mark.vulkan
@pytest.mark.usefixtures("driver")
def test_kernels_equal_their_twins():
    """Residuals and Jacobians in 2-D and 3-D, Krylov bases: the tests of the CPU, with the same tolerances."""
    files = ["tests/fem/test_element_residual.py", "tests/linalg/test_fgmres.py"]
    wanted = "twin and True-0.5 or derivative and 0.5 and air or limits_and or basis_stays or flexible"
    done = run("-m", "pytest", "-q", *files, "-k", wanted, TIPFEM_TEST_ARCH="vulkan")
    assert done.returncode == 0, done.stdout
    assert "8 passed" in done.stdout


@pytest.mark.vulkan
@pytest.mark.slow
@pytest.mark.usefixtures("driver")
@pytest.mark.parametrize("kind", KINDS)
def test_steps_equal_those_of_the_cpu(tmp_path, kind):
    """20 steps of a dam break, or of liquids that slide, by whole systems; kernels take a minute to compile.

    Of the last ones the launches on the device are counted, too, and all that crosses: arrays of NumPy that these are
    given, of which copies have one each, and numbers that are returned.
    """
    found = []
    for arch in ("cpu", "vulkan"):
        done = run("-c", STEPS, arch, kind, "20", str(tmp_path / f"{arch}.npz"))
        assert done.returncode == 0, done.stderr
        found.append(np.load(tmp_path / f"{arch}.npz"))
    cpu, device = found
    launches, crossing, krylov = device["a_step"]
    assert crossing < CROSSING.get(kind, math.inf)
    if kind == "sharp":
        assert 1 < krylov < 10
        assert launches < 150 + 3 * krylov  # with some 50 that copy on the device, which on CUDA are none
    np.testing.assert_array_equal(device["cells"], cpu["cells"])
    assert abs(cpu["v"]).max() > 0.1
    for name in ("x", "v", "p"):
        # Beside an opening, pressures are equal to the tolerance of the solver only.
        digits = 1e-5 if (kind, name) == ("open", "p") else 1e-9
        np.testing.assert_allclose(device[name], cpu[name], rtol=0, atol=digits * abs(cpu[name]).max())


@pytest.mark.slow
@pytest.mark.vulkan
@pytest.mark.usefixtures("driver")
def test_a_mesh_too_large_for_the_driver_is_refused():
    """Where loops are cut short; other drivers have no limit."""
    code = (
        "import tipfem as tp\n"
        "from tipfem.backend import runtime\n"
        "tp.init(arch='vulkan')\n"
        "print(runtime._driver[0].most_cells)\n"
        "water = tp.Fluid('water', density=998.2, viscosity=1.002e-3)\n"
        "case = tp.Case(tp.tank((1.0, 1.0), 0.025).fill(water), [water], (0, -9.81))\n"
        "tp.Simulation(case, time_step=1e-3).step()\n"
    )
    done = run("-c", code)
    most = done.stdout.split()[-1]
    if most == "None":
        pytest.skip("this driver has no limit")
    assert done.returncode != 0
    assert f"it may have {most} at most" in done.stderr


@kernel
def fill_some(values: Ints1, first: ti.i32):
    """values[first:] = 7; the others are not touched."""
    for i in range(first, values.shape[0]):
        values[i] = 7


def test_entries_that_a_kernel_leaves_alone_are_kept_on_copies(monkeypatch):
    """What is done on Vulkan with arrays of NumPy, done here on the CPU."""
    runtime.require_init()
    monkeypatch.setattr(runtime, "on_vulkan", lambda: True)
    monkeypatch.setattr(kept_kernels, "_library", [])  # with which the processor would run them
    values = np.arange(6, dtype=np.int32)
    launch(fill_some, values, 4)
    assert values.tolist() == [0, 1, 2, 3, 7, 7]
    empty = np.zeros(0, dtype=np.int32)
    launch(fill_some, empty, 0)
    with pytest.raises(ValueError, match="is not C-contiguous"):
        launch(fill_some, np.zeros((4, 2), dtype=np.int32)[:, 0], 1)
    with pytest.raises(TypeError, match="fill_some: values is 3; it must be an array"):
        launch(fill_some, 3, 1)


def test_a_driver_that_loses_counts_counts_on_one_thread(monkeypatch):
    monkeypatch.setattr(launches, "FEW_THREADS", 0)
    assert not launches.few_threads()
    monkeypatch.setattr(runtime, "_driver", [vulkan.Driver(False, True, None)])
    assert launches.few_threads()


def test_the_largest_mesh_follows_from_the_longest_loop(monkeypatch):
    runtime.require_short_loops(10**9)
    monkeypatch.setattr(runtime, "on_gpu", lambda: True)
    assert launches.parts() == launches.PARTS_OF_GPU
    monkeypatch.setattr(runtime, "_driver", [vulkan.Driver(True, True, 65535)])
    runtime.require_short_loops(2047)
    assert launches.parts() == launches.PARTS
    with pytest.raises(RuntimeError, match=r"the mesh has 2048 cells; .* after 65535 iterations, it may have 2047 at"):
        runtime.require_short_loops(2048)
    monkeypatch.setattr(runtime, "_driver", [vulkan.Driver(True, True, None)])
    runtime.require_short_loops(10**9)


def test_a_driver_without_doubles_is_one_clear_error(monkeypatch):
    """Taichi's own message, which its code generator raises for a type that the device lacks, is the cause."""

    def refuse(_values):
        raise RuntimeError("[spirv_ir_builder.cpp:get_primitive_type@394] Type f64 not supported.")

    runtime.require_init()
    monkeypatch.setattr(vulkan, "_thirds", refuse)
    with pytest.raises(RuntimeError, match=r"^init: the Vulkan driver has no 64-bit floats, which the kernels need$"):
        vulkan.examine()
    monkeypatch.setattr(vulkan, "_thirds", lambda values: values.from_numpy(np.float64(np.float32([1 / 3, 2 / 3]))))
    with pytest.raises(RuntimeError, match="does not compute in 64-bit floats"):
        vulkan.examine()


def test_the_processor_has_none_of_the_defects(monkeypatch):
    """The same small kernels on the CPU: they tell a device without defects from others."""
    runtime.require_init()
    monkeypatch.setattr(taichi_patches, "group_serial_loops", [True])
    assert vulkan.examine() == vulkan.Driver(True, True, None)
    assert taichi_patches.group_serial_loops == [False]


@ti.kernel
def walk(following: Ints1, visits: Ints1) -> ti.i32:
    """Follow paths from each entry; how many steps there were."""
    steps = 0
    ti.loop_config(serialize=True)
    for k in range(following.shape[0]):
        i = k
        while i >= 0:
            visits[i] = visits[i] + 1
            steps += 1
            i = following[i]
    return steps


def test_serial_loops_in_groups_give_the_same(monkeypatch):
    runtime.require_init()
    monkeypatch.setattr(taichi_patches, "group_serial_loops", [True])
    following, visits = np.array([1, 2, -1, 0], dtype=np.int32), np.zeros(4, dtype=np.int32)
    assert walk(following, visits) == 3 + 2 + 1 + 4
    assert visits.tolist() == [2, 3, 4, 1]
