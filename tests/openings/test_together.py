"""Openings with bodies, gradings, layers at walls, liquids that slide, inclined sides, and several threads."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend import launch

WATER = tp.Fluid("water", 1000.0, 1e-3)
OIL = tp.Fluid("oil", 900.0, 0.05)
AIR = tp.Fluid("air", 1.2, 1.8e-5)
SYRUP = tp.Fluid("syrup", 1.0, 0.01)


def channel(law=None, body=None, **options):
    """Syrup at 1 m/s through a channel of 0.4 by 0.3 m."""
    tank = tp.tank((0.4, 0.3), 0.02).fill(SYRUP)
    for side in ("top", "bottom"):
        tank.wall(side, slip=law is None, law=law)
    if body is not None:
        tank.add(body)
    openings = [tp.Inlet(wall="left", fluid=SYRUP, velocity=1.0, ramp=0.1), tp.Outlet(wall="right")]
    return tp.Case(tank, [SYRUP], (0, 0), openings=openings, **options)


def filling(tank, low, high, roof, *bodies):
    """Water that enters a tank of air at 0.2 m/s between two points, and a vent."""
    tank.fill(AIR).fill(WATER, box=((0, 0), (1, 0.1)))
    for side in tank.sides:
        tank.wall(side, slip=True)
    for body in bodies:
        tank.add(body)
    openings = [tp.Inlet(between=(low, high), fluid=WATER, velocity=0.2, ramp=0.05), tp.Vent(between=roof)]
    return tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings)


def afloat():
    box = tp.Body([(0.16, 0.06), (0.28, 0.06), (0.28, 0.14), (0.16, 0.14)], density=500.0)
    return filling(tp.tank((0.4, 0.24), 0.02), (0, 0), (0, 0.08), ((0.04, 0.24), (0.14, 0.24)), box)


def leaning():
    corners = [(0, 0), (0.4, 0), (0.5, 0.2), (0.1, 0.2)]
    tank = tp.tank(shape=tp.shapes.polygon(corners), spacing=0.02)
    return filling(tank, (0.005, 0.01), (0.045, 0.09), ((0.26, 0.2), (0.4, 0.2)))


def sliding():
    tank = tp.tank((0.3, 0.2), 0.02).fill(OIL, velocity=(0.1, 0))
    tank.fill(WATER, box=((0, 0), (0.3, 0.1)), velocity=(0.3, 0))
    for side in tank.sides:
        tank.wall(side, slip=True)

    def fluid(x, _):
        return np.where(x[:, 1] < 0.1, 0, 1)

    def profile(s, _):
        return np.where(s < 0.1, 0.3, 0.1)

    openings = [
        tp.Inlet(wall="left", fluid=fluid, profile=profile),
        tp.Outlet(wall="right", pressure="hydrostatic", direction="normal"),
    ]
    # What Newton's method leaves of the momentum is more than that of others at the default tolerance.
    exact = tp.Numerics(newton_tolerance=1e-7)
    return tp.Case(tank, [WATER, OIL], (0, -9.81), openings=openings, numerics=exact)


CASES = {
    "obstacle": lambda: channel(body=tp.Body(tp.shapes.circle((0.2, 0.15), 0.05))),
    "obstacle with corners": lambda: channel(body=tp.Body(tp.shapes.rectangle((0.15, 0.1), (0.25, 0.2)), slip=True)),
    "turning body": lambda: channel(
        body=tp.Body(tp.shapes.circle((0.2, 0.15), 0.05), motion=tp.Motion(angle=lambda t: 20 * t * t))
    ),
    "grading": lambda: channel(grading=tp.Grading(where=lambda x: np.where(x[:, 0] > 0.2, 0.04, 0.02))),
    "layers": lambda: channel("layer"),
    "no-slip walls": lambda: channel("no-slip"),
    "floating body": afloat,
    "shape": leaning,
    "liquids that slide": sliding,
}


@pytest.mark.slow(only=("obstacle", "obstacle with corners", "turning body", "floating body"))
@pytest.mark.parametrize("name", CASES)
def test_volume_momentum_and_energy_are_accounted_for_with(name):
    simulation = tp.Simulation(CASES[name](), time_step=5e-3)
    start, exact = simulation.state.volume.copy(), simulation.state.parts["openings"].total
    while simulation.time < 0.1:
        simulation.step(0.1)
    passed, history = simulation.state.parts["openings"].total, simulation.history
    assert (exact == 0).all()
    assert simulation.state.volume - start == pytest.approx(passed.sum(axis=0), abs=1e-12 * np.abs(passed).max())
    assert np.abs(passed).max() > 1e-4
    flux = [abs(row["opening_work"]) + abs(row["opening_energy"]) for row in history]
    assert sum(abs(row["energy_residual"]) for row in history) < 1e-9 * sum(flux)
    assert 0 < sum(abs(row["newton_dissipation"]) for row in history) < 1e-4 * sum(flux)
    forces = [0.005 * (abs(row["opening_force_x"]) + abs(row["wall_force_x"])) for row in history]
    momentum = sum(forces) + sum(abs(row["opening_momentum_x"]) for row in history)
    left = sum(abs(row["momentum_residual_x"]) for row in history)
    assert left < 5e-5 * momentum  # in proportion to the tolerance
    assert sum(row["refused_steps"] for row in history) == 0
    if "bodies" in simulation.state.parts:
        assert len(simulation.state.parts["bodies"].corners) >= 4  # the fluid slides round them


@pytest.mark.slow
def test_states_do_not_depend_on_the_number_of_threads(monkeypatch):
    found = []
    for single in (False, True):
        monkeypatch.setattr(launch, "is_serial", lambda count, cost, single=single: single)
        simulation = tp.Simulation(afloat(), time_step=5e-3)
        for _ in range(8):
            simulation.step()
        p = simulation.particles
        found.append([p.position, p.velocity, p.pressure, simulation.mesh.cells, simulation.state.volume])
    for many, one in zip(*found, strict=True):
        np.testing.assert_array_equal(many, one)


@pytest.mark.slow
def test_ten_channels_full_pass_without_a_refused_step():
    """Through a channel at 23 degrees to the lattice; particles come and go, their number stays."""
    turn, length = np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]]), 0.2
    corners = np.array([(0, 0), (length, 0), (length, 0.1), (0, 0.1)]) @ turn
    tank = tp.tank(shape=tp.shapes.polygon(corners.tolist(), names=["below", "out", "above", "in"]), spacing=0.02)
    tank.fill(SYRUP, velocity=turn[0])
    for name in ("below", "above"):
        tank.wall(name, slip=True)
    openings = [tp.Inlet(wall="in", fluid=SYRUP, velocity=1.0), tp.Outlet(wall="out")]
    simulation = tp.Simulation(tp.Case(tank, [SYRUP], (0, 0), openings=openings), time_step=0.02)
    while simulation.time < 10 * length:
        simulation.step()
        assert np.abs(simulation.particles.velocity - turn[0]).max() < 1e-5
    counts = [row["particles"] for row in simulation.history]
    assert sum(row["refused_steps"] for row in simulation.history) == 0
    assert 0.9 * counts[0] < min(counts) < max(counts) < 1.2 * counts[0]


def test_a_tank_whose_only_opening_is_free_drains():
    """No particle is held at it, and air comes in where water goes out."""
    tank = tp.tank((0.4, 0.4), 0.04).fill(AIR).fill(WATER, box=((0, 0), (0.4, 0.28)))
    openings = [tp.Outlet(wall="bottom", between=((0.12, 0), (0.28, 0)))]
    simulation = tp.Simulation(tp.Case(tank, [WATER, AIR], (0, -9.81), openings=openings), time_step=2e-3)
    for _ in range(2):
        simulation.step()
    assert np.isfinite(simulation.particles.velocity).all()
