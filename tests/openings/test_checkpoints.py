"""Runs with openings go on from a checkpoint to the bit."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend import launch
from tipfem.casefile.describing import describe
from tipfem.casefile.loading import read_case

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)


def fountain():
    tank = tp.tank((0.3, 0.3), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.3, 0.06)))
    openings = [
        tp.Inlet(wall="bottom", between=((0.1, 0), (0.2, 0)), fluid=WATER, discharge=0.06, ramp=0.05),
        tp.Vent(wall="top", between=((0.02, 0.3), (0.1, 0.3))),
    ]
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings)


def pumped():
    """Under a free surface: a drain, whose water a pump lifts, and a nozzle in the roof with a valve."""
    tank = tp.tank((0.4, 0.3), 0.02).fill(WATER, box=((0, 0), (0.4, 0.12)))
    tank.fill(WATER, box=((0, 0.16), (0.04, 0.26))).fill(WATER, box=((0.2, 0.26), (0.3, 0.3)))
    for side in tank.sides:
        tank.wall(side, slip=True)
    openings = [
        tp.Inlet(wall="left", between=((0, 0.16), (0, 0.26)), fluid="water", pump="drain"),
        tp.Inlet(wall="top", between=((0.2, 0.3), (0.3, 0.3)), fluid="water", velocity=0.7, open=((0.0, 0.1),)),
        tp.Outlet(wall="bottom", between=((0.14, 0), (0.26, 0)), name="drain", pressure=600.0),
    ]
    return tp.Case(tank, [WATER], (0, -9.81), openings=openings, free_surface=True)


def same(one, other):
    assert len({row["particles"] for row in one.history}) > 1
    for name in ("position", "velocity", "acceleration", "pressure", "wall"):
        assert np.array_equal(getattr(one.particles, name), getattr(other.particles, name)), name
    assert np.array_equal(one.mesh.cells, other.mesh.cells)
    for name in ("volume", "total"):
        assert np.array_equal(*(getattr(run.state.parts["openings"], name) for run in (one, other)))


def run_of(case, steps):
    simulation = tp.Simulation(case, time_step=4e-3)
    for _ in range(steps):
        simulation.step()
    return simulation


@pytest.mark.slow
@pytest.mark.parametrize("case", [fountain, pumped])
def test_a_run_goes_on_to_the_bit_while_particles_come_and_go(case, tmp_path):
    parted = tp.Simulation(case(), tmp_path, time_step=4e-3)
    for _ in range(25):
        parted.step()
    parted.write_checkpoint(1.0)
    resumed = tp.Simulation.resume(tmp_path)  # from its own record of the case
    for _ in range(15):
        resumed.step()
    same(run_of(case(), 40), resumed)


@pytest.mark.slow
def test_openings_at_surfaces_do_not_depend_on_threads_and_are_written_to_case_files(monkeypatch):
    monkeypatch.setattr(launch, "is_serial", lambda count, cost: False)
    many = run_of(pumped(), 20)
    monkeypatch.setattr(launch, "is_serial", lambda count, cost: True)
    same(many, run_of(pumped(), 20))
    found = describe(pumped(), 1.0)
    assert not found.missing
    same(many, run_of(read_case(str(found), "again.toml").case(), 20))


def test_within_a_step_openings_are_drawn_on_their_lines():
    run = tp.Simulation(fountain(), time_step=4e-3)
    for _ in range(20):
        run.step()
    start = run.solved.before
    particles, _ = run.solved.at(0.5 * (start.time + run.time))
    for line, on in zip(start.boundary.lines, start.boundary.passages.nodes, strict=True):
        assert np.abs((particles.position[on] - line.a) @ line.inwards).max() < 1e-12
    assert np.abs(run.solved.particles.position[on] - start.particles.position[on]).max() > 1e-4
