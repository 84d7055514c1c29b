"""The rules of interfaces, measures of meshes and the volume source, on meshes made by hand and by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_twins import energy, fluid_volumes, nodal_mass

import tipfem as tp
from tipfem.mesh import measures
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.interface import InterpolatedInterface
from tipfem.mesh.mesh import Mesh
from tipfem.physics.volume_source import CALM, VolumeControl, volume_source

RULE = InterpolatedInterface()


def volumes_of(mesh, fluid, count):
    """Volume of each fluid by the mid-edge rule."""
    return fluid_volumes(mesh, RULE.fluid_fraction(mesh, fluid, count))


def random_mesh(dimension: int, seed: int, fluids: int = 2) -> tuple[tp.Particles, Mesh]:
    """A jittered unit tank with random labels, and its mesh."""
    water = tp.Fluid("water", 1000.0, 1e-3)
    n = 8 if dimension == 2 else 4
    p = tp.tank((1.0,) * dimension, 1 / n, jitter=0.3, seed=seed).fill(water).sample([water])
    p.fluid = np.random.default_rng(seed).integers(0, fluids, len(p)).astype(np.int32)
    return p, triangulate(p.position, p.wall, p.spacing)


def two_triangles() -> Mesh:
    """The unit square cut along the diagonal from (0, 0) to (1, 1)."""
    return Mesh(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def nearest_corner_share(corner: np.ndarray, label: np.ndarray, points: int = 40000) -> np.ndarray:
    """Part of a simplex on each side of the surface through the mid-edges, by random points (two fluids).

    The surface is where the linear interpolation of the label crosses 1/2.
    """
    weight = np.random.default_rng(8).dirichlet(np.ones(len(corner)), points)
    one = (weight @ label > 0.5).mean()
    return np.array([1 - one, one])


def one_cell(corners):
    """A mesh of one simplex, wherever."""
    return Mesh(np.zeros((corners, corners - 1)), np.arange(corners, dtype=np.int32)[None])


@pytest.mark.parametrize(
    ("label", "share"),
    [
        ([0, 0, 0], [1, 0]),
        ([1, 0, 0], [0.75, 0.25]),
        ([0, 1, 0], [0.75, 0.25]),
        ([1, 1, 0], [0.25, 0.75]),
        ([1, 1, 1], [0, 1]),
        ([0, 0, 0, 0], [1, 0]),
        ([0, 0, 1, 0], [0.875, 0.125]),
        ([0, 1, 1, 0], [0.5, 0.5]),
        ([1, 1, 0, 1], [0.125, 0.875]),
    ],
)
def test_shares_of_two_fluids_are_those_of_the_cut_through_the_mid_edges(label, share):
    mesh, label = one_cell(len(label)), np.array(label)
    np.testing.assert_array_equal(RULE.fluid_fraction(mesh, label, 2), [share])
    corner = np.random.default_rng(1).normal(size=(len(label), len(label) - 1))
    np.testing.assert_allclose(nearest_corner_share(corner, label), share, atol=0.01)


@pytest.mark.parametrize(
    ("label", "share"),
    [
        ([0, 1, 2], [1 / 3, 1 / 3, 1 / 3, 0]),
        ([2, 3, 0], [1 / 3, 0, 1 / 3, 1 / 3]),
        ([2, 2, 1], [0, 0.25, 0.75, 0]),
        ([0, 1, 2, 2], [0.25, 0.25, 0.5, 0]),
        ([0, 1, 2, 3], [0.25] * 4),
    ],
)
def test_three_fluids_share_an_element_evenly_among_its_corners(label, share):
    np.testing.assert_allclose(RULE.fluid_fraction(one_cell(len(label)), np.array(label), 4), [share], rtol=1e-15)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("fluids", [1, 2, 3])
def test_shares_sum_to_one_and_volumes_to_the_tank(dimension, fluids):
    p, mesh = random_mesh(dimension, 3, fluids)
    fraction = RULE.fluid_fraction(mesh, p.fluid, fluids)
    assert fraction.shape == (len(mesh.cells), fluids)
    np.testing.assert_allclose(fraction.sum(axis=1), 1.0, rtol=1e-15)
    volumes = volumes_of(mesh, p.fluid, fluids)
    assert volumes.sum() == pytest.approx(1.0, rel=1e-12)
    expected = [sum(m * f for m, f in zip(mesh.measure, fraction[:, k], strict=True)) for k in range(fluids)]
    np.testing.assert_allclose(volumes, expected, rtol=1e-12)


def test_volumes_of_a_square_by_hand():
    mesh = two_triangles()
    assert volumes_of(mesh, np.array([1, 0, 0, 0]), 2).tolist() == [0.75, 0.25]
    assert volumes_of(mesh, np.array([0, 1, 0, 0]), 2).tolist() == [0.875, 0.125]
    assert volumes_of(mesh, np.array([0, 1, 1, 0]), 3).tolist() == [0.5, 0.5, 0.0]


def test_an_element_takes_the_mean_of_its_particles(water, air, glycerin):
    fluids = [water, air, glycerin]
    p, mesh = random_mesh(2, 5, 3)
    density, viscosity = RULE.element_properties(mesh, p.fluid, fluids)
    for m, cell in enumerate(mesh.cells):
        assert density[m] == pytest.approx(np.mean([fluids[k].density for k in p.fluid[cell]]), rel=1e-14)
        assert viscosity[m] == pytest.approx(np.mean([fluids[k].viscosity for k in p.fluid[cell]]), rel=1e-14)


def test_masses_by_hand_and_in_sum():
    mesh = two_triangles()
    np.testing.assert_allclose(nodal_mass(mesh, np.array([6.0, 12.0])), [3.0, 1.0, 3.0, 2.0])
    _, mesh = random_mesh(3, 6)
    density = np.random.default_rng(0).uniform(1, 1000, len(mesh.cells))
    assert nodal_mass(mesh, density).sum() == pytest.approx(density @ mesh.measure, rel=1e-12)
    more = Mesh(np.append(two_triangles().position, [[5.0, 5.0]], axis=0), two_triangles().cells)
    assert nodal_mass(more, np.array([6.0, 12.0]))[4] == 0


@pytest.mark.parametrize("dimension", [2, 3])
def test_energy_of_uniform_motion_is_half_m_v_squared(dimension):
    p, mesh = random_mesh(dimension, 7)
    velocity = np.array([3.0, -4.0, 12.0][:dimension])
    p.velocity[:] = velocity
    gravity = np.array([0.5, -9.81, 2.0][:dimension])
    density = np.full(len(mesh.cells), 870.0)
    found = energy(mesh, p, density, gravity)
    assert found.kinetic == pytest.approx(0.5 * 870 * velocity @ velocity, rel=1e-12)
    # Lumped masses integrate a linear function exactly: the centre of the unit tank.
    assert found.potential == pytest.approx(-870 * gravity.sum() * 0.5, rel=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_extent_reaches_to_the_middle_of_the_mixed_edges(axis, seed):
    p, mesh = random_mesh(2, seed, 3)
    p.fluid[p.position[:, axis] > 0.6] = 2
    for index in range(3):
        own = p.fluid == index
        expected = p.position[own, axis].max()
        for cell in mesh.cells:
            for i in cell[own[cell]]:
                for j in cell[~own[cell]]:
                    expected = max(expected, 0.5 * (p.position[i, axis] + p.position[j, axis]))
        assert measures.extent(mesh, p.fluid, index, axis) == pytest.approx(expected, rel=1e-15)
    assert np.isnan(measures.extent(mesh, p.fluid, 3, axis))


def test_extent_by_hand(water, air):
    mesh = two_triangles()
    assert measures.extent(mesh, np.array([0, 1, 1, 0]), 0, 0) == 0.5
    assert measures.extent(mesh, np.array([0, 1, 1, 0]), 1, 0) == 1.0
    assert measures.extent(mesh, np.array([0, 0, 0, 1]), 1, 0) == 0.5
    tank = tp.tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (0.5, 0.5)))
    p = tank.sample([water, air])
    mesh = triangulate(p.position, p.wall, p.spacing)
    assert measures.extent(mesh, p.fluid, 0, 0) == pytest.approx(0.5, rel=1e-12)
    assert measures.extent(mesh, p.fluid, 0, 1) == pytest.approx(0.5, rel=1e-12)


def sampled_depth(mesh: Mesh, fluid: np.ndarray, index: int, place: float, points: int = 20000) -> float:
    """Depth by fine sampling: where along the line does the interpolated label of the fluid exceed one half?"""
    y = (np.arange(points) + 0.5) / points * (mesh.position[:, 1].max() - mesh.position[:, 1].min())
    y += mesh.position[:, 1].min()
    inside, total = np.zeros(points, bool), 0
    for cell in mesh.cells:
        corner = mesh.position[cell]
        if corner[:, 0].min() > place or corner[:, 0].max() < place:
            continue
        matrix = np.concatenate([corner.T, np.ones((1, 3))])
        weight = np.linalg.solve(matrix, np.stack([np.full(points, place), y, np.ones(points)]))
        here = (weight >= 0).all(axis=0) & ~inside
        inside |= here
        total += int((here & (weight.T @ (fluid[cell] == index) > 0.5)).sum())
    return total * (mesh.position[:, 1].max() - mesh.position[:, 1].min()) / points


@pytest.mark.parametrize("place", [0.11, 0.37, 0.5, 0.8125, 0.99])
@pytest.mark.parametrize("seed", [0, 1])
def test_depth_is_that_of_the_cut_through_the_mid_edges(place, seed):
    p, mesh = random_mesh(2, seed)
    for index in (0, 1):
        depth = measures.depth(mesh, p.fluid, index, place)
        assert depth == pytest.approx(sampled_depth(mesh, p.fluid, index, place), abs=5e-4)


@pytest.mark.parametrize("fluids", [2, 3])
def test_depths_of_all_fluids_sum_to_the_height_of_the_tank(fluids):
    p, mesh = random_mesh(2, 4, fluids)
    # The lines through particles, mid-edges and walls are among them.
    places = np.concatenate([np.linspace(0.01, 1.0, 50), p.position[p.position[:, 0] > 0, 0], [0.125, 0.0625]])
    for place in places:
        total = sum(measures.depth(mesh, p.fluid, index, place) for index in range(fluids))
        assert total == pytest.approx(1.0, rel=1e-12)


@pytest.mark.slow
def test_depth_integrates_to_the_volume():
    p, mesh = random_mesh(2, 9)
    places = (np.arange(4000) + 0.5) / 4000
    area = np.mean([measures.depth(mesh, p.fluid, 1, place) for place in places])
    assert area == pytest.approx(volumes_of(mesh, p.fluid, 2)[1], rel=1e-4)


@pytest.mark.parametrize("place", [1e-9, 0.1, 0.25, 0.3, 0.75, 1.0])
def test_depth_of_layers_is_their_thickness(place, water, air):
    p = tp.tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (1, 0.5))).sample([water, air])
    mesh = triangulate(p.position, p.wall, p.spacing)
    assert measures.depth(mesh, p.fluid, 0, place) == pytest.approx(0.5, rel=1e-12)
    assert measures.depth(mesh, p.fluid, 1, place) == pytest.approx(0.5, rel=1e-12)
    assert measures.depth(mesh, p.fluid, 2, place) == 0


def test_depth_by_hand():
    mesh, fluid = two_triangles(), np.array([0, 1, 0, 0])
    # Fluid 1 is the triangle (1, 0), (0.5, 0), (1, 0.5), of height x - 0.5.
    for place in (0.25, 0.5, 0.6, 0.75, 1.0):
        assert measures.depth(mesh, fluid, 1, place) == pytest.approx(max(place - 0.5, 0.0), abs=1e-15)
        assert measures.depth(mesh, fluid, 0, place) == pytest.approx(1 - max(place - 0.5, 0.0), abs=1e-15)
    # A line along an edge inside counts it once.
    halves = Mesh(
        np.array([[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1]], float),
        np.array([[0, 1, 4], [0, 4, 5], [1, 2, 3], [1, 3, 4]], np.int32),
    )
    assert measures.depth(halves, np.array([0, 0, 1, 1, 0, 0]), 0, 1.0) == 1.0
    assert measures.depth(halves, np.array([0, 0, 1, 1, 1, 0]), 0, 1.0) == 0.5


def test_depth_along_the_left_wall_is_that_just_beside_it():
    p, mesh = random_mesh(2, 4)
    assert measures.depth(mesh, p.fluid, 1, 0.0) == pytest.approx(measures.depth(mesh, p.fluid, 1, 1e-12), abs=1e-9)


def test_depth_along_the_right_wall_is_that_just_beside_it():
    p, mesh = random_mesh(2, 4)
    assert measures.depth(mesh, p.fluid, 1, 1.0) == pytest.approx(measures.depth(mesh, p.fluid, 1, 1 - 1e-12), abs=1e-9)


@pytest.mark.parametrize("place", [-0.1, 1.1, float("nan")])
def test_depth_beside_the_mesh_is_refused(place):
    with pytest.raises(ValueError, match=rf"depth: the line x = {place:g} m does not cross"):
        measures.depth(two_triangles(), np.zeros(4, int), 0, place)


def test_hydrostatic_pressure_of_layers(water, air, glycerin):
    layers = [(glycerin, 0.3), (water, 0.5), (air, 0.2)]
    top = [0.2 * air.density, 0.2 * air.density + 0.5 * water.density]
    floor = top[1] + 0.3 * glycerin.density
    height = np.array([2.0, 1.0, 0.9, 0.8, 0.55, 0.3, 0.0])
    expected = [0, 0, top[0] / 2, top[0], (top[0] + top[1]) / 2, top[1], floor]
    np.testing.assert_allclose(measures.hydrostatic_pressure(height, layers), 9.81 * np.array(expected), rtol=1e-12)
    np.testing.assert_allclose(measures.hydrostatic_pressure(height, layers, 1.6), 1.6 * np.array(expected), rtol=1e-12)


def fractions(seed: int, fluids: int) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """A random mesh, its fractions and its volumes."""
    p, mesh = random_mesh(2, seed, fluids)
    fraction = RULE.fluid_fraction(mesh, p.fluid, fluids)
    return mesh, fraction, mesh.measure @ fraction


@pytest.mark.parametrize("fluids", [2, 3])
def test_the_volume_source_grows_what_was_lost_and_nothing_in_all(fluids):
    mesh, fraction, volume = fractions(2, fluids)
    lost = np.array([0.02, -0.02, 0.0][:fluids])
    growth = volume_source(mesh, fraction, volume + lost, 0.1)
    np.testing.assert_allclose(growth, 0.1 * fraction @ (lost / volume), rtol=1e-10, atol=1e-16)
    assert abs(growth @ mesh.measure) < 1e-15
    pure = fraction == 1
    assert (growth[pure[:, 0]] > 0).all()
    assert (growth[pure[:, 1]] < 0).all()


def test_the_volume_source_brings_the_volume_back_in_pure_elements():
    mesh = Mesh(two_triangles().position, two_triangles().cells)
    fraction = np.eye(2)
    growth = volume_source(mesh, fraction, np.array([0.6, 0.4]), 0.25)
    np.testing.assert_allclose(growth, [0.25 * 0.2, -0.25 * 0.2], rtol=1e-12)
    np.testing.assert_allclose(mesh.measure * (1 + growth), [0.525, 0.475], rtol=1e-12)
    assert not volume_source(mesh, fraction, np.array([0.5, 0.5]), 0.25).any()
    assert not volume_source(mesh, fraction, np.array([0.6, 0.4]), 0.0).any()


def test_small_errors_of_volume_come_back_calmly_and_large_ones_at_once():
    """Steps much longer than the rate's: a tenth of little that is missing, half of much; a slow rate as it is."""
    control = VolumeControl(np.array([0.6, 0.4, 0.0]), 60.0)
    assert control.part(0.01) == pytest.approx(0.1)
    control.missing[:] = (0.4 * CALM / 2, -0.4 * CALM / 2, 0.0)
    assert control.part(0.01) == pytest.approx(0.3)
    for error in (CALM, 10 * CALM):
        control.missing[:] = (0.4 * error, -0.4 * error, 0.0)
        assert control.part(0.01) == pytest.approx(0.5)
        assert control.part(1e-4) == pytest.approx(6e-3)


@pytest.mark.parametrize("lost", [0.2 * CALM, 4 * CALM])
def test_lost_volume_comes_back_without_swinging(lost):
    """Long steps; also where flips make the volumes jump to and fro, to which the source hardly answers."""
    for flips in (0.0, 0.05 * CALM):
        control, volume, given = VolumeControl(np.ones(2), 60.0), np.array([1 - lost, 1 + lost]), []
        for step in range(60):
            control.observe(volume + (-1) ** step * flips * np.array([1, -1]), 0.01)
            given.append(control.part(0.01) * control.missing)
            volume = volume + given[-1]
        assert np.abs(volume - 1).max() < 0.05 * lost
        assert volume[0] < 1 + 0.02 * lost + flips
        assert np.abs(np.diff(given[-10:], axis=0)).max() <= 0.04 * flips + 1e-3 * lost


def test_a_vanished_fluid_leaves_the_source_finite_and_balanced():
    mesh, fraction, volume = fractions(3, 2)
    fraction = np.pad(fraction, ((0, 0), (0, 1)))
    growth = volume_source(mesh, fraction, np.array([*(volume - 0.01), 0.02]), 0.5)
    assert np.isfinite(growth).all()
    assert abs(growth @ mesh.measure) < 1e-15
    # Both hold too much by the same volume; that is more of the smaller one, and it has to give.
    assert (growth[fraction[:, np.argmin(volume)] == 1] < 0).all()
