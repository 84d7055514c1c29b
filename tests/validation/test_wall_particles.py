"""Wall particles and relocated ones in runs: their fluids, tight walls, any number of fluids, edges at interfaces."""

from __future__ import annotations

import numpy as np
import pytest
from demo_runs import load
from interface_edges import watched
from triangulations import component_labels

import tipfem as tp


def collapsing(water, air, interface="interpolated", spacing=0.02):
    """A column of water that falls over in a tank of air: all that an interface can do to walls."""
    filled = tp.tank((0.4, 0.4), spacing).fill(air).fill(water, box=((0, 0), (0.12, 0.24)))
    for side in ("left", "right", "bottom", "top") if interface == "interpolated" else ():
        filled.wall(side, law="no-slip")  # whose particles stay where they are
    return tp.Simulation(tp.Case(filled, [water, air], (0, -9.81), interface=interface), time_step=2e-3)


def carries_its_closest_neighbours_fluid(mesh, fluid, wall):
    """(N,) of each wall particle that an edge joins to particles off the walls, (N,) whether it has the fluid of the
    closest of them, or of one that is as close."""
    one, other = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T
    across = wall[one] & ~wall[other]
    one, other = one[across], other[across]
    length = np.linalg.norm(mesh.position[one] - mesh.position[other], axis=1)
    least = np.full(len(wall), np.inf)
    np.minimum.at(least, one, length)
    joined, right = np.isfinite(least), np.zeros(len(wall), dtype=bool)
    right[one[(length <= least[one] * (1 + 1e-12)) & (fluid[one] == fluid[other])]] = True
    return joined, right


@pytest.mark.slow
def test_wall_particles_carry_the_fluid_of_their_closest_neighbour(water, air):
    """At every step of a dam break, up to and past the impact; dozens of them change their fluid meanwhile."""
    simulation = collapsing(water, air)
    wall, changed = simulation.particles.wall, 0
    before = simulation.particles.fluid.copy()
    while simulation.time < 0.4:
        simulation.step(0.4)
        fluid = simulation.particles.fluid
        joined, right = carries_its_closest_neighbours_fluid(simulation.mesh, fluid, wall)
        assert joined.sum() >= wall.sum() - 8  # all but those of the corners
        assert right[joined].all()
        changed += int((fluid != before)[wall].sum())
        before = fluid.copy()
    assert changed > 30


@pytest.mark.slow
def test_relocated_particles_stay_with_their_fluid(water, air):
    """No particle off the walls ever changes its fluid, and one that is relocated is joined to others of it."""
    simulation = collapsing(water, air)
    off = ~simulation.particles.wall
    fluid, relocated = simulation.particles.fluid.copy(), 0
    while simulation.time < 0.4:
        simulation.step(0.4)
        now = simulation.particles.fluid
        np.testing.assert_array_equal(now[off], fluid[off])
        i, j = simulation.mesh.edges.T
        same = now[i] == now[j]
        has_own = np.zeros(len(now), dtype=bool)
        has_own[i[same]] = has_own[j[same]] = True
        assert has_own[simulation.state.relocated].all()
        relocated += simulation.state.relocations
    assert relocated > 100
    assert np.bincount(simulation.particles.fluid[off]).tolist() == np.bincount(fluid[off]).tolist()


def assert_tight(simulation, start, volume):
    """The walls stand where they stood, all particles are between them, and the mesh fills the tank."""
    p, size = simulation.particles, 0.4
    place = p.position[p.wall]
    assert ((place == 0) | (place == size)).any(axis=1).all()
    if simulation.case.interface == "interpolated":  # a sharp interface slides its ends along walls
        np.testing.assert_array_equal(place, start[p.wall])
    inside = p.position[~p.wall]
    assert (inside > 0).all()
    assert (inside < size).all()
    assert simulation.mesh.measure.sum() == pytest.approx(size**2, rel=1e-12)
    assert (simulation.mesh.measure > 0).all()
    assert sum(volume) == pytest.approx(size**2, rel=1e-12)


@pytest.mark.slow(but=("100-sharp",))
@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
@pytest.mark.parametrize("steps", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_nothing_leaks_through_the_walls(steps, interface, water, air):
    """Water sloshes from wall to wall: walls stand still, no particle is beyond them, and the tank stays full."""
    simulation = collapsing(water, air, interface)
    start, count = simulation.particles.position.copy(), len(simulation.particles)
    for _ in range(steps):
        simulation.step()
        assert len(simulation.particles) == count
        assert_tight(simulation, start, [simulation.volume("water"), simulation.volume("air")])
    water_changed = abs(simulation.volume("water") / (0.12 * 0.24) - 1)
    assert water_changed < (1e-10 if interface == "sharp" else 0.06)
    assert simulation.particles.max_speed < 6


@pytest.mark.slow(only=("3-interpolated", "3-sharp"))
@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_any_number_of_fluids(count, interface, water, air, glycerin):
    """One, two or three layers under a block that falls: volumes, labels and densities are those of so many fluids."""
    fluids = [glycerin, water, air][-count:]
    filled = tp.tank((0.2, 0.2), 0.01, jitter=0.1).fill(fluids[-1])
    for number, fluid in enumerate(fluids[:-1]):
        filled.fill(fluid, box=((0, 0.05 * number), (0.2, 0.05 * (number + 1))))
    if count > 1:
        filled.fill(fluids[0], box=((0.08, 0.13), (0.12, 0.17)))
    simulation = tp.Simulation(tp.Case(filled, fluids, (0, -9.81), interface=interface), time_step=2e-3)
    begun = {fluid.name: simulation.volume(fluid.name) for fluid in fluids}
    for _ in range(60):
        simulation.step()
    assert sum(begun.values()) == pytest.approx(0.04, rel=1e-12)
    for name, volume in begun.items():
        assert simulation.volume(name) == pytest.approx(volume, rel=1e-10 if interface == "sharp" else 0.1)
    assert set(simulation.particles.fluid) == set(range(count))
    density = simulation.state.material.density
    assert density.min() >= fluids[-1].density - 1e-9
    assert density.max() <= fluids[0].density + 1e-9
    if interface == "sharp":
        assert len(np.unique(component_labels(simulation.mesh.neighbours, simulation.mesh.fluid))) >= count
    assert simulation.particles.max_speed < 6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "interface", "spacing", "end", "longest", "steps"),
    [
        ("dam_break", "interpolated", 0.02, 0.4, 2.5, 3),
        ("dam_break", "sharp", 0.02, 0.4, 3.0, 30),
        ("layer_inversion", "interpolated", 0.01, 4.0, 2.5, 3),
        pytest.param("layer_inversion", "sharp", 0.01, 4.0, 6.0, 120, marks=pytest.mark.slow),
    ],
)
def test_no_gap_opens_at_the_interface(name, interface, spacing, end, longest, steps):
    """Edges across the interface are refilled: none stays longer than two spacings for more than three steps.

    Those along a sharp one are short in the dam break, and not always in the inversion, see test_interface_slivers.py:
    over four orders of the first triangles, the longest was 1.9 to 2.5 there, and 2.7 to 5.2 in the inversion.
    """
    demo = load(name, spacing=spacing, interface=interface)
    simulation = tp.Simulation(demo.case, time_step=2 * demo.options.time_step)
    edges = watched(simulation, end)
    assert edges.longest < longest
    assert edges.stay_steps <= steps
