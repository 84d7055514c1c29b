"""Free surfaces that are repaired in place: a jet out of an orifice, and a solitary wave."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp

pytestmark = pytest.mark.slow

WATER = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
G = 9.81


def test_a_jet_out_of_an_orifice_contracts():
    """A slot with bevelled lips in the floor, 10 spacings wide, until the jet lands 6 widths below.

    The coefficient of discharge of a slot in a wide floor is pi / (pi + 2) = 0.611 (Kirchhoff 1869).
    """
    slot = 0.08
    half, depth, below, lip = 5 * slot, 5 * slot, 6 * slot, 4.5 * slot
    right = [(half, -below), (half, -lip), (slot / 2, 0), (half, 0), (half, depth + slot)]
    outline = [(-half, -below), *right, *((-x, y) for x, y in right[:0:-1])]
    tank = tp.tank(shape=outline, spacing=slot / 10, jitter=0.01).fill(WATER, box=((-half, 0), (half, depth)))
    sim = tp.Simulation(tp.Case(tank, [WATER], (0, -G), free_surface=True))
    time, volume, ears, landed = [], [], [], None
    while sim.time < 0.25:
        sim.step(0.25)
        mesh, x = sim.mesh, sim.particles.position
        time.append(sim.time)
        volume.append(mesh.measure[x[mesh.cells, 1].mean(axis=1) > 0].sum())
        front, beside = mesh.surface.front & (x[:, 1] > 0.2 * depth), half - np.abs(x[:, 0])
        h = sim.particles.spacing
        ears.append((x[front & (beside < 0.5 * h), 1].max() - x[front & (abs(beside - 3 * h) < 1.3 * h), 1].mean()) / h)
        if landed is None and x[mesh.used, 1].min() < -below + h:
            landed = len(sim.history)
    time, volume = np.array(time), np.array(volume)
    later = time > 0.12
    level = volume[later].mean() / (2 * half)
    coefficient = -np.polyfit(time[later], volume[later], 1)[0] / (slot * np.sqrt(2 * G * level))
    assert 0.59 < coefficient < 0.63
    assert max(ears) < 0.3
    rows = sim.history[:landed]
    released = rows[0]["potential_energy"] - rows[-1]["potential_energy"]
    assert sum(row["numerical_dissipation"] for row in rows) < 0.065 * released


def test_a_solitary_wave_keeps_its_height():
    """Height 0.3 of the depth, 10 spacings a depth, over 20 depths.

    It begins with the third-order solution of R. Grimshaw, The solitary wave in water of variable depth, Part 2,
    Journal of Fluid Mechanics 46, 1971.
    """
    d, e, length = 0.2, 0.3, 8.0
    h, steep = d / 10, np.sqrt(0.75 * e) * (1 - 5 / 8 * e + 71 / 128 * e**2)

    def shape(x):
        s, t = 1 / np.cosh(steep * (x / d - 10)), np.tanh(steep * (x / d - 10))
        return s, t

    def elevation(x):
        s, t = shape(x)
        third = 5 / 8 * s**2 * t**2 - 101 / 80 * s**4 * t**2
        return d * (e * s**2 - 0.75 * e**2 * s**2 * t**2 + e**3 * third)

    def velocity(p):
        (s, t), y = shape(p[:, 0]), p[:, 1] / d
        u = e * s**2 - e**2 * (-(s**2) / 4 + s**4 + y**2 * (1.5 * s**2 - 2.25 * s**4))
        u -= e**3 * (19 / 40 * s**2 + s**4 / 5 - 6 / 5 * s**6)
        u -= e**3 * y**2 * (-1.5 * s**2 - 15 / 4 * s**4 + 7.5 * s**6)
        u -= e**3 * y**4 * (-3 / 8 * s**2 + 45 / 16 * s**4 - 45 / 16 * s**6)
        v = e * s**2 - e**2 * (3 / 8 * s**2 + 2 * s**4 + y**2 * (0.5 * s**2 - 1.5 * s**4))
        v -= e**3 * (49 / 640 * s**2 - 17 / 20 * s**4 - 18 / 5 * s**6)
        v -= e**3 * y**2 * (-13 / 16 * s**2 - 25 / 16 * s**4 + 7.5 * s**6)
        v -= e**3 * y**4 * (-3 / 40 * s**2 + 9 / 8 * s**4 - 27 / 16 * s**6)
        return np.sqrt(G * d) * np.stack([u, np.sqrt(3 * e) * y * t * v], axis=1)

    def crest(sim):
        x = sim.particles.position[sim.mesh.surface.front]
        top = x[np.argmax(x[:, 1]), 0]
        a, b, c = np.polyfit(*x[np.argsort(np.abs(x[:, 0] - top))[:7]].T - [[top], [d]], 2)
        return top - b / (2 * a), c - b**2 / (4 * a)

    line = np.linspace(length, 0, round(length / h) + 1)
    water = tp.shapes.polygon([(0, 0), (length, 0), *zip(line, d + elevation(line), strict=True)])
    tank = tp.tank((length, 2 * d), h).fill(WATER, shape=water, velocity=velocity)
    for side in ("left", "right", "bottom"):
        tank.wall(side, slip=True)
    sim = tp.Simulation(tp.Case(tank, [WATER], (0, -G), free_surface=True))
    place, height = crest(sim)
    speed = np.sqrt(G * d * (1 + e - e**2 / 20 - 3 * e**3 / 70))
    while sim.time < 20 * d / speed - 1e-9:
        sim.step(20 * d / speed)
    end, now = crest(sim)
    assert now > 0.985 * height
    assert end - place == pytest.approx(20 * d, rel=0.005)
