"""Runs with openings go on from a checkpoint to the bit."""

from __future__ import annotations

import numpy as np

import tipfem as tp

WATER = tp.Fluid("water", 1000.0, 1e-3)
AIR = tp.Fluid("air", 1.2, 1.8e-5)


def fountain():
    tank = tp.tank((0.3, 0.3), 0.02).fill(AIR).fill(WATER, box=((0, 0), (0.3, 0.06)))
    openings = [
        tp.Inlet(wall="bottom", between=((0.1, 0), (0.2, 0)), fluid=WATER, discharge=0.06, ramp=0.05),
        tp.Vent(wall="top", between=((0.02, 0.3), (0.1, 0.3))),
    ]
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings)


def test_a_run_goes_on_to_the_bit_while_particles_come_and_go(tmp_path):
    whole = tp.Simulation(fountain(), time_step=4e-3)
    for _ in range(40):
        whole.step()
    parted = tp.Simulation(fountain(), tmp_path, time_step=4e-3)
    for _ in range(25):
        parted.step()
    parted.write_checkpoint(1.0)
    resumed = tp.Simulation.resume(tmp_path, fountain())
    for _ in range(15):
        resumed.step()
    assert len({row["particles"] for row in whole.history}) > 1
    for name in ("position", "velocity", "acceleration", "pressure", "wall"):
        assert np.array_equal(getattr(whole.particles, name), getattr(resumed.particles, name)), name
    assert np.array_equal(whole.mesh.cells, resumed.mesh.cells)
    for name in ("volume", "total"):
        assert np.array_equal(*(getattr(run.state.parts["openings"], name) for run in (whole, resumed)))


def test_within_a_step_openings_are_drawn_on_their_lines():
    run = tp.Simulation(fountain(), time_step=4e-3)
    for _ in range(20):
        run.step()
    start = run.solved.before
    particles, _ = run.solved.at(0.5 * (start.time + run.time))
    for line, on in zip(start.boundary.lines, start.boundary.passages.nodes, strict=True):
        assert np.abs((particles.position[on] - line.a) @ line.inwards).max() < 1e-12
    assert np.abs(run.solved.particles.position[on] - start.particles.position[on]).max() > 1e-4
