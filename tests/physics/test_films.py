"""The fluid in closed gaps that open and close: its law against closed form, and bodies that land and lift off."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import tipfem as tp
from tipfem.physics.contact.film import POINTS, Film

L, RHO, MU = 0.4, 1000.0, 0.5
WATER = tp.Fluid("water", density=RHO, viscosity=1e-3)


def film(width, viscosity=0.0):
    """Below a body of length L, whose reference point is above the middle."""
    s = np.linspace(-0.5 * L, 0.5 * L, POINTS)
    rows = np.stack([np.zeros(POINTS), np.ones(POINTS), s], axis=1)
    return Film(np.broadcast_to(width, POINTS), L / (POINTS - 1), rows, RHO, viscosity, 1e-6)


@pytest.mark.parametrize(("speed", "c"), [(0.3, 0.5), (-0.3, 2.0)])
def test_straight_film(speed, c):
    """Its force by the mass that it adds, by Bernoulli's pressure and by friction; none that turns or pushes along."""
    g, acceleration, still = 0.01, 2.0, np.zeros(3)
    v, a = np.array([0, speed, 0]), np.array([0, acceleration, 0])
    added = -RHO * L**3 / 12 * (acceleration / g - c * speed**2 / g**2)
    for viscosity in (0.0, MU):
        force, _ = film(g, viscosity).law(still, v, a, still, still)
        assert force[1] == pytest.approx(added - viscosity * L**3 * speed / g**3, rel=1e-2)
        assert np.abs(force[[0, 2]]).max() < 1e-9 * abs(force[1])


def test_film_moves_implicitly():
    """Minus the derivative of its force by increments, squares of speeds left out; symmetric and positive."""
    wedge, still = film(np.linspace(0.005, 0.02, POINTS), MU), np.zeros(3)
    cv, cm = np.full(3, 1e-3), np.full(3, 1e-1)
    _, stiff = wedge.law(still, still, still, cv, cm)
    assert stiff == pytest.approx(stiff.T, abs=1e-9 * np.abs(stiff).max())
    assert np.linalg.eigvalsh(stiff).min() > -1e-9 * np.abs(stiff).max()
    for k in range(3):
        q = np.zeros(3)
        q[k] = 1e-9
        assert wedge.law(still, cv * q, cm * q, cv, cm)[0] == pytest.approx(-stiff @ q, rel=1e-5, abs=1e-12)


def under_water(low, density, **options):
    """A box 0.4 m wide and 0.2 m high in water 0.6 m deep."""
    tank = tp.tank((1.2, 0.9), 0.05).fill(WATER, box=((0, 0), (1.2, 0.6)))
    shape = tp.shapes.rectangle((0.4, low), (0.8, low + 0.2))
    tank.add(tp.Body(shape, name="box", density=density, gap="seep", friction=0.3, **options))
    return tp.Case(tank, [WATER], (0, -9.81), free_surface=True)


@pytest.mark.slow
def test_box_lifts_off_a_film():
    """Its first acceleration is that of the film below it, of 2 133 kg/m."""
    simulation = tp.Simulation(under_water(0.0, 500.0))
    while simulation.time < 0.05:
        simulation.step()
    row = simulation.history[-1]
    film_mass = RHO * L**3 / 12 / 0.0025
    assert row["box_velocity_y"] / row["time"] == pytest.approx(0.04 * RHO * 9.81 / film_mass, rel=0.2)
    assert abs(row["energy_residual"]) < 1e-9
    assert row["box_touches"] == 0


@pytest.mark.slow
def test_film_hands_over_its_flow():
    """When its gap opens the body goes on, with most of its speed; the energy of the flow comes from the gap."""
    simulation = tp.Simulation(under_water(0.0, 500.0, free=("y",)))
    while not simulation.history or simulation.history[-1]["box_y"] < 0.1 + 1.3 * 0.05:
        simulation.step()
        assert simulation.time < 1.0
    opened = [k for k, row in enumerate(simulation.history) if row["gap_energy"] > 0]
    assert len(opened) == 1
    before, after = (simulation.history[opened[0] + k] for k in (0, 2))
    gap = before["box_y"] - 0.1
    assert gap == pytest.approx(0.9 * 0.05, abs=0.006)
    # Of a flow u = g' s / g between its mouths; of particles there a part of the mass is outside.
    assert before["gap_energy"] == pytest.approx(RHO * L**3 * before["box_velocity_y"] ** 2 / (24 * gap), rel=0.5)
    assert after["box_velocity_y"] > 0.6 * before["box_velocity_y"]
    assert max(abs(row["energy_residual"]) for row in simulation.history) < 1e-8


@pytest.mark.slow
def test_film_goes_on_from_a_checkpoint(tmp_path):
    """To the bit, from the middle of a lift-off."""
    whole = tp.Simulation(under_water(0.0, 500.0), tmp_path / "run")
    whole.run(0.06, progress=False)
    shutil.copytree(tmp_path / "run", tmp_path / "part")
    whole.run(0.12, progress=False)
    resumed = tp.Simulation.resume(tmp_path / "part", under_water(0.0, 500.0))
    resumed.run(0.12, progress=False)
    np.testing.assert_array_equal(resumed.particles.position, whole.particles.position)
    assert resumed.history[-1]["box_gap_force_y"] == whole.history[-1]["box_gap_force_y"]
