"""Extreme distortion: a vortex in a closed box, kept up by a body force, turns the fluid over again and again.

The flow of manufactured.py: at the core it turns by 2 pi radians a second, so a turn-over takes 1 s. Print the
figures by `pytest tests/test_stirring.py -m slow -s`.
"""

from __future__ import annotations

import numpy as np
import pytest
from manufactured import Vortex

import tipfem as tp

KINETIC_ENERGY = 3 / 16  # of the exact flow, density 1 [J/m]: the integral of |u|^2 / 2 over the unit square
SHORT, LONG = 1.0, 12.0  # turn-overs


def smallest_angles(mesh) -> np.ndarray:
    """(M,) smallest angle of each triangle [degrees]."""
    x = mesh.position[mesh.cells]
    angles = []
    for i in range(3):
        one, other = x[:, (i + 1) % 3] - x[:, i], x[:, (i + 2) % 3] - x[:, i]
        cosine = (one * other).sum(axis=1) / np.linalg.norm(one, axis=1) / np.linalg.norm(other, axis=1)
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return np.min(angles, axis=0)


def stirred(interface: str, cells: int, *densities: float) -> tp.Simulation:
    """The vortex in full swing, ``cells`` spacings a side; of several fluids the first fills the lower half."""
    vortex = Vortex(viscosity=0.05)
    fluids = [tp.Fluid(f"fluid {k}", density=rho, viscosity=0.05 * rho) for k, rho in enumerate(densities)]
    tank = tp.tank((1, 1), 1 / cells, jitter=0.1).fill(fluids[-1])
    if len(fluids) > 1:
        tank.fill(fluids[0], box=((0, 0), (1, 0.5)))
    case = tp.Case(tank, fluids, (0, 0), body_force=vortex.body_force, interface=interface)
    particles = case.particles
    off_wall = ~particles.wall[:, None]
    particles.velocity = off_wall * vortex.velocity(particles.position, 0.0)
    particles.acceleration = off_wall * vortex.acceleration(particles.position, 0.0)
    return tp.Simulation(case, time_step=0.4 / cells)


def stir(simulation: tp.Simulation, until: float) -> dict[str, float]:
    """Figures over all steps to a time [s]: kinetic energies, angles, largest speed, change of volumes."""
    names = [fluid.name for fluid in simulation.case.fluids]
    begun = np.array([simulation.volume(name) for name in names])
    energy, angle, flat, speed, change = [], [], [], [], [0.0]
    while simulation.time < until:
        simulation.step(until)
        angles = smallest_angles(simulation.mesh)
        energy.append(simulation.energy().kinetic)
        angle.append(angles.min())
        flat.append((angles < 10).mean())
        speed.append(simulation.particles.max_speed)
        change.append(np.abs([simulation.volume(name) for name in names] / begun - 1).max())
    return {
        "least_energy": min(energy),
        "most_energy": max(energy),
        "smallest_angle": float(min(angle)),
        "median_smallest_angle": float(np.median(angle)),
        "below_10_degrees": float(np.mean(flat)),
        "largest_speed": float(max(speed)),
        "volume_change": float(max(change)),
        "relocated": sum(row["relocated"] for row in simulation.history),
    }


@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
@pytest.mark.parametrize(("cells", "turns"), [(16, SHORT), pytest.param(20, LONG, marks=pytest.mark.slow)])
def test_a_vortex_keeps_its_energy_and_its_mesh(cells, turns, interface):
    """Kinetic energy within 3 % of the exact flow's at every step, no angle below 10 degrees."""
    figures = stir(stirred(interface, cells, 1.0), turns)
    print(f"\nvortex, {interface}, {cells} spacings, {turns:g} turn-overs: {figures}")
    assert figures["least_energy"] > 0.97 * KINETIC_ENERGY
    assert figures["most_energy"] < 1.03 * KINETIC_ENERGY
    assert figures["smallest_angle"] > 10
    assert figures["relocated"] > 50 * turns
    assert figures["largest_speed"] < 1.05


@pytest.mark.slow(but=("1.0-interpolated",))
@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
@pytest.mark.parametrize("turns", [SHORT, pytest.param(LONG, marks=pytest.mark.slow)])
def test_two_fluids_can_be_stirred(turns, interface):
    """They are torn into filaments and drops, and nothing grows: neither speed, energy nor - much - a fluid."""
    figures = stir(stirred(interface, 20, 1.26, 1.0), turns)
    print(f"\ntwo fluids, {interface}, 20 spacings, {turns:g} turn-overs: {figures}")
    assert figures["largest_speed"] < 1.2
    assert 0.9 * KINETIC_ENERGY < figures["least_energy"]
    assert figures["most_energy"] < 1.26 * 1.05 * KINETIC_ENERGY
    assert figures["volume_change"] < (1e-9 if interface == "sharp" else 0.06)
    assert figures["smallest_angle"] > 0.5
