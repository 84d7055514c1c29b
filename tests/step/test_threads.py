"""Steps by loops that threads share equal those by loops on one thread, bit by bit."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend import launch as launches

SHARED = {"list_cells", "exchange_momentum", "mark_changed", "exchanged_energy"}


@pytest.fixture
def started(monkeypatch):
    """Names of the kernels that are started."""
    names, start = set(), launches.Kernel.start

    def starting(kernel, arguments):
        names.add(kernel.__name__)
        return start(kernel, arguments)

    monkeypatch.setattr(launches.Kernel, "start", starting)
    return names


def test_shared_loops_give_the_same_bits(monkeypatch, started):
    water, air = tp.Fluid("water", 998.2, 1.002e-3), tp.Fluid("air", 1.204, 1.825e-5)
    found = []
    for single in (True, False):
        monkeypatch.setattr(launches, "is_serial", lambda count, cost, single=single: single)
        tank = tp.tank((0.4, 0.4), 0.02, jitter=0.2).fill(air).fill(water, box=((0, 0), (0.14, 0.28)))
        simulation = tp.Simulation(tp.Case(tank, [water, air], gravity=(0, -9.81)), time_step=5e-3)
        for _ in range(12):
            simulation.step()
        state = simulation.state
        fields = state.particles.position, state.particles.velocity, state.particles.pressure
        found.append([*fields, state.mesh.cells, state.mesh.components.interface_cells, state.mass])
    assert started >= SHARED
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
