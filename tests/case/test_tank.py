"""tipfem/case/tank.py: tanks sampled by particles; volumes, walls, jitter, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_twins import fluid_volumes

import tipfem as tp
from tipfem.mesh.delaunay import triangulate, wall_fluid
from tipfem.mesh.interface import InterpolatedInterface

NAN = float("nan")


def volumes(particles: tp.Particles, count: int) -> np.ndarray:
    """Volume of each fluid on the mesh of the particles, walls labelled by their neighbours."""
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    fluid = wall_fluid(mesh, particles.fluid, particles.wall)
    return fluid_volumes(mesh, InterpolatedInterface().fluid_fraction(mesh, fluid, count))


def on_the_boundary(position: np.ndarray, size) -> np.ndarray:
    """(N,) whether a coordinate is exactly that of a wall."""
    return ((position == 0.0) | (position == np.asarray(size, float))).any(axis=1)


def nearest(position: np.ndarray) -> np.ndarray:
    """(N,) distance to the nearest other point, by brute force."""
    distance = np.linalg.norm(position[:, None] - position[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return distance.min(axis=1)


@pytest.mark.parametrize("size", [(1.0, 1.0), (0.584, 0.438), (0.3, 0.1 + 0.2), (2.0, 0.37)])
def test_walls_stand_exactly_on_the_boundary_and_surround_the_tank(size, water):
    p = tp.tank(size, 0.05).fill(water).sample([water])
    np.testing.assert_array_equal(p.wall, on_the_boundary(p.position, size))
    assert (p.position.min(axis=0) == 0).all()
    assert (p.position.max(axis=0) == size).all()
    counts = [len(np.unique(p.position[:, k])) for k in range(2)]
    assert len(p) == np.prod(counts)
    assert p.wall.sum() == 2 * sum(counts) - 4
    assert p.spacing == 0.05
    assert (p.fluid == 0).all()
    step = np.concatenate([np.diff(np.unique(p.position[:, k])) for k in range(2)])
    assert step.min() > 0.75 * 0.05
    assert step.max() < 1.34 * 0.05
    assert volumes(p, 1)[0] == pytest.approx(np.prod(size), rel=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("spacing", [0.1, 0.05, 0.037])
def test_half_a_tank_has_half_its_volume(axis, spacing, water, air):
    upper = [1.0, 1.0]
    upper[axis] = 0.5
    p = tp.tank((1, 1), spacing).fill(air).fill(water, box=((0, 0), upper)).sample([water, air])
    np.testing.assert_allclose(volumes(p, 2), [0.5, 0.5], rtol=1e-12)


@pytest.mark.parametrize("height", [0.3, 0.23, 0.71, 0.9])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_layer_has_the_volume_of_its_box(axis, height, water, air):
    upper = [0.8, 1.0]
    upper[axis] *= height
    p = tp.tank((0.8, 1.0), 0.05).fill(air).fill(water, box=((0, 0), upper)).sample([water, air])
    exact = np.prod(upper)
    np.testing.assert_allclose(volumes(p, 2), [exact, 0.8 - exact], rtol=1e-12)


def test_a_layer_between_two_others_has_the_volume_of_its_box(water, air, glycerin):
    tank = tp.tank((1.0, 1.0), 0.05).fill(air).fill(water, box=((0, 0), (1, 0.62)))
    p = tank.fill(glycerin, box=((0, 0), (1, 0.27))).sample([water, air, glycerin])
    np.testing.assert_allclose(volumes(p, 3), [0.35, 0.38, 0.27], rtol=1e-12)


@pytest.mark.parametrize(
    ("box", "corners"),
    [
        (((0, 0), (0.146, 0.292)), 1),
        (((0, 0), (0.3, 0.2)), 1),
        (((0.1, 0.1), (0.3, 0.25)), 4),
    ],
)
def test_a_box_has_its_volume_but_for_the_diagonals_at_its_corners(box, corners, water, air):
    # At a corner of the box the diagonal of one lattice cell decides on an eighth of that cell.
    h, size = 0.01, (0.584, 0.438)
    p = tp.tank(size, h).fill(air).fill(water, box=box).sample([water, air])
    cell = max(np.diff(np.unique(p.position[:, 0]))) * max(np.diff(np.unique(p.position[:, 1])))
    measured = volumes(p, 2)
    assert measured.sum() == pytest.approx(np.prod(size), rel=1e-12)
    assert measured[0] == pytest.approx(np.prod(np.subtract(box[1], box[0])), abs=corners * cell / 8 * 1.001)


def test_the_interface_runs_midway_between_two_lattice_lines(water, air):
    p = tp.tank((1, 1), 0.05).fill(air).fill(water, box=((0, 0), (1, 0.31))).sample([water, air])
    inside = p.position[~p.wall]
    below, above = inside[p.fluid[~p.wall] == 0, 1].max(), inside[p.fluid[~p.wall] == 1, 1].min()
    assert 0.5 * (below + above) == pytest.approx(0.31, abs=1e-14)


def test_round_off_in_a_box_does_not_stretch_the_lattice(water, air):
    # 0.1 + 0.2 is larger than 0.3 by one bit: the box's face and the wall are the same place.
    for length, face in ((0.1 + 0.2, 0.3), (0.3, 0.1 + 0.2)):
        p = tp.tank((length, 0.3), 0.03).fill(air).fill(water, box=((0, 0), (face, 0.15))).sample([water, air])
        step = np.diff(np.unique(p.position[:, 0]))
        np.testing.assert_allclose(step, step[0], rtol=1e-9)


@pytest.mark.parametrize("place", ["inside", "on the floor"])
@pytest.mark.parametrize("thickness", [0.61, 0.8, 0.91, 1.0, 1.1, 1.3, 1.49, 1.51, 1.6, 1.99, 2.0, 2.6])
def test_a_thin_layer_is_not_crowded_from_the_start(thickness, place, water, air):
    h = 0.05
    floor = 0.0 if place == "on the floor" else 0.52
    tank = tp.tank((1, 1), h).fill(air).fill(water, box=((0, floor), (1, floor + thickness * h)))
    if place == "on the floor" and thickness < 0.9:
        with pytest.raises(ValueError, match=r"thinner than 0\.9 spacings \(0\.045 m\)"):
            tank.sample([water, air])
        return
    p = tank.sample([water, air])
    assert np.diff(np.unique(p.position[:, 1])).min() > tp.RelocationRule().too_close * h
    assert np.diff(np.unique(p.position[:, 1])).max() < 1.6 * h
    np.testing.assert_allclose(volumes(p, 2), [thickness * h, 1 - thickness * h], rtol=1e-12)


def test_a_layer_of_one_line_may_lie_beside_another(water, air, glycerin):
    h = 0.05
    for thick, allowed in (((1.0, 1.0), True), ((1.2, 1.2), True), ((1.45, 0.62), False), ((0.8, 1.3), False)):
        faces = 0.4 + np.cumsum([0, *thick]) * h
        tank = tp.tank((1, 1), h).fill(air).fill(water, box=((0, faces[0]), (1, faces[1])))
        tank.fill(glycerin, box=((0, faces[1]), (1, faces[2])))
        if allowed:
            exact = np.multiply(thick, h)
            measured = volumes(tank.sample([air, water, glycerin]), 3)
            np.testing.assert_allclose(measured, [1 - exact.sum(), *exact], rtol=1e-12)
        else:
            with pytest.raises(ValueError, match=r"axis 1, .* thinner than its neighbours allow \(0\.6 spacings"):
                tank.sample([air, water, glycerin])


def test_layers_of_any_thickness_have_their_volume_or_are_refused(water, air, glycerin):
    rng = np.random.default_rng(0)
    h, refused = 0.05, 0
    for _ in range(60):
        low = rng.uniform(0.05, 0.6)
        high = low + h * rng.uniform(0.5, 4)
        tank = tp.tank((0.2, 1), h).fill(air).fill(water, box=((0, 0), (0.2, high)))
        tank.fill(glycerin, box=((0, 0), (0.2, low)))
        try:
            p = tank.sample([air, water, glycerin])
        except ValueError as refusal:
            assert "thinner than" in str(refusal)  # noqa: PT017  (refusing is one right answer of two)
            refused += 1
            continue
        step = np.diff(np.unique(p.position[:, 1]))
        assert step.min() > 0.6 * h * (1 - 1e-9)
        np.testing.assert_allclose(volumes(p, 3), np.multiply(0.2, [1 - high, high - low, low]), rtol=1e-12)
    assert refused < 10


def test_discs_have_their_area_within_a_few_per_cent_and_converge(water, air):
    errors = []
    for h in (0.02, 0.01):
        tank = tp.tank((1, 1), h).fill(water)
        for k, radius in enumerate((0.25, 0.2, 0.15)):
            tank.fill(air, disc=((0.26 + 0.24 * k, 0.27 + 0.23 * k), radius))
        single = tp.tank((1, 1), h).fill(water).fill(air, disc=((0.47, 0.52), 0.25)).sample([water, air])
        errors.append(abs(volumes(single, 2)[1] / (np.pi * 0.25**2) - 1))
        several = volumes(tank.sample([water, air]), 2)
        x = (np.arange(1000) + 0.5) / 1000
        x, y = np.meshgrid(x, x)
        union = np.zeros(x.shape, bool)
        for k, radius in enumerate((0.25, 0.2, 0.15)):
            union |= (x - 0.26 - 0.24 * k) ** 2 + (y - 0.27 - 0.23 * k) ** 2 < radius**2
        assert several[1] == pytest.approx(union.mean(), rel=0.03)
    assert max(errors) < 0.02
    assert errors[1] < 0.01


def test_later_fills_replace_earlier_ones_and_a_function_can_choose(water, air, glycerin):
    fluids = [water, air, glycerin]
    tank = tp.tank((1, 1), 0.1).fill(air).fill(water, where=lambda x: x[:, 1] < 0.55)
    assert tank.fill(glycerin, where=lambda x: x[:, 0] + x[:, 1] < 0.55) is tank
    p = tank.sample(fluids)
    x, y = p.position.T
    np.testing.assert_array_equal(p.fluid, np.where(x + y < 0.55, 2, np.where(y < 0.55, 0, 1)))
    np.testing.assert_array_equal(tank.sample(fluids[::-1]).fluid, 2 - p.fluid)


@pytest.mark.parametrize("dimension", [2, 3])
def test_jitter_leaves_walls_and_labels_and_is_bounded_and_repeatable(dimension, water, air):
    size, h = (1.0,) * dimension, 0.125

    def sample(jitter, seed=0):
        tank = tp.tank(size, h, jitter=jitter, seed=seed).fill(air)
        return tank.fill(water, box=((0,) * dimension, (0.5,) * dimension)).sample([water, air])

    # A 3-D tank must have some jitter; so little cannot be told from none.
    plain, shaken = sample(0.0 if dimension == 2 else 1e-12), sample(0.3, seed=5)
    wall = plain.wall
    np.testing.assert_array_equal(shaken.wall, wall)
    np.testing.assert_array_equal(shaken.fluid, plain.fluid)
    np.testing.assert_array_equal(shaken.position[wall], plain.position[wall])
    shift = (shaken.position - plain.position)[~wall] / h
    assert np.abs(shift).max() <= 0.3 + 1e-11
    assert np.abs(shift).max() > 0.25
    assert (shift != 0).all()
    assert abs(shift.mean()) < 0.05
    np.testing.assert_array_equal(sample(0.3, seed=5).position, shaken.position)
    assert (sample(0.3, seed=6).position[~wall] != shaken.position[~wall]).any()
    assert (shaken.position[~wall] > 0).all()
    assert (shaken.position[~wall] < 1).all()


def test_a_tank_in_three_dimensions(water, air):
    size = (1.0, 0.5, 0.75)
    tank = tp.tank(size, 0.125, jitter=0.1, seed=2).fill(air).fill(water, box=((0, 0, 0), (1, 0.5, 0.375)))
    p = tank.sample([water, air])
    assert p.dimension == 3
    np.testing.assert_array_equal(p.wall, on_the_boundary(p.position, size))
    assert (p.position.max(axis=0) == size).all()
    assert nearest(p.position).min() > 0.5 * 0.125
    measured = volumes(p, 2)
    assert measured.sum() == pytest.approx(0.375, rel=1e-9)
    assert measured[0] == pytest.approx(0.1875, rel=0.05)
    ball = tp.tank((1, 1, 1), 0.0625, jitter=0.1).fill(air).fill(water, disc=((0.5, 0.5, 0.5), 0.3))
    assert volumes(ball.sample([water, air]), 2)[0] == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.04)


def test_a_regular_lattice_in_three_dimensions_is_refused(water):
    tank = tp.tank((1, 1, 1), 0.25).fill(water)
    with pytest.raises(ValueError, match=r"jitter is 0; .* 3-D cannot be meshed.*set jitter, to 0\.1"):
        tank.sample([water])
    tank.jitter = 0.1
    assert volumes(tank.sample([water]), 1)[0] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((1.0, -1.0), 0.1), ["size", "-1.0", "> 0"]),
        (((1.0, NAN), 0.1), ["size", "nan"]),
        (((1.0,), 0.1), ["size", "(1.0,)", "2 or 3"]),
        ((1.0, 0.1), ["size", "1.0", "2 or 3"]),
        (((1.0, "a"), 0.1), ["size", "'a'"]),
        (((1, 1), "a"), ["spacing", "'a'", "> 0"]),
        (((1, 1), None), ["spacing", "None"]),
        (((1, 1, 1, 1), 0.1), ["size", "2 or 3"]),
        (((1, 1), 0.0), ["spacing", "0.0", "> 0"]),
        (((1, 1), NAN), ["spacing", "nan"]),
        (((1, 1), -0.1), ["spacing", "-0.1"]),
        (((2.0, 0.5), 3.0), ["spacing", "3 m", "too large", "[2.0, 0.5]", "0.25 m"]),
        (((2.0, 0.5), 0.26), ["spacing", "0.26 m", "too large", "0.25 m"]),
    ],
)
def test_impossible_tanks_are_refused(arguments, words):
    with pytest.raises(ValueError, match=r"^tank: ") as refusal:
        tp.tank(*arguments)
    assert all(word in str(refusal.value) for word in words), refusal.value


@pytest.mark.parametrize("jitter", [-0.1, 0.41, NAN, "much", None])
def test_impossible_jitter_is_refused(jitter):
    with pytest.raises(ValueError, match=f"jitter is {jitter!r}.*from 0 to 0.4"):
        tp.tank((1, 1), 0.1, jitter=jitter)


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"box": ((0, 0), (1, 0))}, ["box", "((0, 0), (1, 0))", "lower < upper"]),
        ({"box": ((0, 0), (1, NAN))}, ["box", "nan"]),
        ({"box": ((0, 0, 0), (1, 1, 1))}, ["box", "2 coordinates"]),
        ({"box": ((1.2, 0), (1.4, 1))}, ["box", "1.2", "outside the tank", "[1.0, 1.0]"]),
        ({"box": ((-2, 0), (-1, 1))}, ["box", "-2", "outside the tank"]),
        ({"box": ((1.0, 0), (1.5, 1))}, ["box", "outside the tank"]),
        ({"disc": ((0.5, 0.5, 0.5), 0.1)}, ["disc", "2 coordinates"]),
        ({"disc": ((0.5, 0.5), 0.0)}, ["disc", "radius > 0"]),
        ({"disc": ((0.5, 0.5), NAN)}, ["disc", "nan", "radius > 0"]),
        ({"disc": 0.1}, ["disc", "0.1", "(centre, radius)"]),
        ({"disc": ((0.5, "a"), 0.1)}, ["disc", "'a'"]),
        ({"disc": ((0.5, 0.5), "a")}, ["disc", "radius > 0"]),
        ({"box": ((0, 0), (1,))}, ["box", "(1,)"]),
        ({"box": "all"}, ["box", "'all'"]),
        ({"where": True}, ["where", "True", "function"]),
    ],
)
def test_impossible_parts_are_refused_with_the_fluid_s_name(part, words, water):
    with pytest.raises(ValueError, match=r"^fill 'water'") as refusal:
        tp.tank((1, 1), 0.1).fill(water, **part)
    assert all(word in str(refusal.value) for word in words), refusal.value


def test_only_a_fluid_can_be_filled_in():
    with pytest.raises(
        ValueError, match=r"fill: fluid is 'water'; a tank knows no names of fluids; it must be a Fluid"
    ):
        tp.tank((1, 1), 0.1).fill("water")


def test_several_parts_at_once_are_refused(water):
    with pytest.raises(ValueError, match="one of box, disc, where and shape"):
        tp.tank((1, 1), 0.1).fill(water, box=((0, 0), (1, 1)), disc=((0.5, 0.5), 0.2))


def test_a_box_is_cut_at_the_walls(water, air):
    whole = tp.tank((1, 1), 0.1).fill(air).fill(water, box=((-5, -5), (0.5, 5))).sample([water, air])
    cut = tp.tank((1, 1), 0.1).fill(air).fill(water, box=((0, 0), (0.5, 1))).sample([water, air])
    np.testing.assert_array_equal(whole.position, cut.position)
    np.testing.assert_array_equal(whole.fluid, cut.fluid)


@pytest.mark.parametrize(
    "part",
    [
        {"disc": ((5.0, 5.0), 0.1)},
        {"disc": ((0.53, 0.53), 1e-4)},
        {"disc": ((0.5, NAN), 0.1)},
        {"where": lambda x: x[:, 0] > 2},
        {"disc": ((0.0, 0.0), 0.09)},
    ],
    ids=["outside", "tiny", "nan", "where", "wall particles alone"],
)
def test_a_part_that_holds_no_particle_is_refused(part, water, air):
    with pytest.raises(ValueError, match="air"):
        tp.tank((1, 1), 0.1).fill(water).fill(air, **part).sample([water, air])


@pytest.mark.parametrize(
    "where",
    [lambda x: x[0] < 0.5, lambda x: True, lambda x: x < 0.5],
    ids=["first point", "scalar", "each coordinate"],
)
def test_a_function_of_the_wrong_shape_is_refused(where, water, air):
    with pytest.raises(ValueError, match="where"):
        tp.tank((1, 1), 0.1).fill(water).fill(air, where=where).sample([water, air])


def test_a_part_that_later_fills_cover_is_no_error(water, air):
    tank = tp.tank((1, 1), 0.1).fill(air).fill(water, disc=((0.5, 0.5), 0.2)).fill(air, box=((0.2, 0.2), (0.8, 0.8)))
    assert (tank.sample([water, air]).fluid == 1).all()


def test_a_function_that_works_in_place_does_not_move_the_particles(water, air):
    def disc(x):
        x -= 0.5
        return (x**2).sum(axis=1) < 0.09

    p = tp.tank((1, 1), 0.1).fill(water).fill(air, where=disc).sample([water, air])
    assert p.position.min() == 0


def test_an_unfilled_part_is_refused_with_its_place(water):
    with pytest.raises(ValueError, match=r"no fluid at \[0\.0, 0\.\d+\]; fill the whole tank first"):
        tp.tank((1, 1), 0.1).fill(water, box=((0, 0), (1, 0.5))).sample([water])
    with pytest.raises(ValueError, match="no fluid at"):
        tp.tank((1, 1), 0.1).sample([water])


def test_a_fluid_that_is_not_in_the_list_is_refused_by_name(water, air):
    with pytest.raises(ValueError, match=r"'air', which is not among the case's fluids \['water'\]"):
        tp.tank((1, 1), 0.1).fill(air).sample([water])


@pytest.mark.parametrize(
    ("box", "limit"),
    [
        (((0, 0), (1, 0.03)), "0.9 spacings (0.09 m)"),
        (((0, 0.97), (1, 1)), "0.9 spacings (0.09 m)"),
        (((0, 0.5), (1, 0.53)), "0.6 spacings (0.06 m)"),
        (((0, 0.03), (1, 1)), "0.9 spacings (0.09 m)"),
    ],
)
def test_a_box_thinner_than_a_line_needs_is_refused_with_its_place_and_the_limit(box, limit, water, air):
    with pytest.raises(ValueError, match=r"along axis 1, the part between .* thinner than") as refusal:
        tp.tank((1, 1), 0.1).fill(air).fill(water, box=box).sample([water, air])
    assert limit in str(refusal.value)


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (lambda x: x[:, 2] > 0, "raised IndexError"),
        (lambda x: 1 / 0, "raised ZeroDivisionError for positions of shape"),
        (lambda x: x[:, 1], r"gave float64 of shape \(\d+,\); it must be a mask"),
        (lambda x: None, r"gave object of shape \(\); it must be a mask"),
        (lambda x: np.ones((len(x), 2), dtype=bool), "gave bool of shape .* it must be a mask, bool of shape"),
    ],
)
@pytest.mark.parametrize("free_surface", [False, True])
def test_a_function_that_fails_gives_one_error_with_its_region(where, words, free_surface, water, air):
    tank = tp.tank((1, 1), 0.1).fill(air).fill(water, where=where)
    with pytest.raises(ValueError, match=rf"^fill 'water': where=<lambda> {words}"):
        tp.Case(tank, [water, air], (0, -9.81), free_surface=free_surface)


def test_a_named_function_is_named_in_the_error(water):
    def column(x):
        return x[:, 0] < 0.5, 1

    with pytest.raises(ValueError, match=r"^fill .water.: where=column "):
        tp.tank((1, 1), 0.1).fill(water, where=column).sample([water])


def rotation(x):
    """Solid-body rotation about the middle of the unit square at 2 rad/s."""
    return 2 * np.stack([0.5 - x[:, 1], x[:, 0] - 0.5], axis=1)


def test_fluids_start_with_the_velocities_that_they_are_given(water, air):
    """A function, a vector or nothing; later fills replace earlier ones, and walls hold what is on them."""
    tank = tp.tank((1, 1), 0.1).fill(air).fill(water, box=((0, 0), (1, 0.4)), velocity=rotation)
    tank.fill(air, box=((0, 0.7), (1, 1)), velocity=(0.1, 0.2))
    p = tank.sample([water, air], fitted=True)
    y = p.position[:, 1]
    water_, fast = ~p.wall & (y < 0.39), ~p.wall & (y > 0.71)
    np.testing.assert_allclose(p.velocity[water_], rotation(p.position[water_]), atol=1e-15)
    np.testing.assert_array_equal(p.velocity[fast], np.broadcast_to([0.1, 0.2], (fast.sum(), 2)))
    assert fast.sum() > 10
    assert not p.velocity[p.wall | ((y > 0.41) & (y < 0.69))].any()


def test_walls_that_slip_let_fluids_start_along_them(water):
    tank = tp.tank((1, 1), 0.1).fill(water, velocity=lambda x: x * [1, -1]).wall("bottom", slip=True)
    for side in ("left", "right", "top"):
        tank.wall(side, law="no-slip")
    simulation = tp.Simulation(tp.Case(tank, [water], (0, 0)), time_step=1e-3)
    p = simulation.particles
    bottom = p.wall & (p.position[:, 1] == 0) & (p.position[:, 0] > 0) & (p.position[:, 0] < 1)
    np.testing.assert_allclose(p.velocity[bottom, 0], p.position[bottom, 0], rtol=1e-12)
    assert not p.velocity[bottom, 1].any()
    assert not p.velocity[p.wall & ~bottom].any()


def test_a_taylor_green_vortex_decays_as_it_should():
    """Between walls that slip: u = (sin(pi x) cos(pi y), -cos(pi x) sin(pi y)), with an energy ~ exp(-4 nu pi^2 t)."""
    fluid = tp.Fluid("fluid", density=1.0, viscosity=0.02)
    pi = np.pi

    def velocity(x):
        (sx, sy), (cx, cy) = np.sin(pi * x).T, np.cos(pi * x).T
        return 0.1 * np.stack([sx * cy, -cx * sy], axis=1)

    tank = tp.tank((1, 1), 1 / 24, jitter=0.1).fill(fluid, velocity=velocity)
    for wall in ("left", "right", "bottom", "top"):
        tank.wall(wall, slip=True)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=0.02)
    assert simulation.energy().kinetic == pytest.approx(0.5 * 0.1**2 / 2, rel=0.01)
    start = simulation.energy().kinetic
    simulation.run(0.4)
    assert simulation.energy().kinetic == pytest.approx(start * np.exp(-4 * 0.02 * pi**2 * 0.4), rel=0.02)


@pytest.mark.parametrize(
    ("velocity", "message"),
    [
        ((1.0,), r"velocity is \(1.0,\); it must be 2 finite components"),
        ((1.0, np.nan), "it must be 2 finite components"),
        ("fast", "it must be 2 finite components"),
        (lambda x: x[:, 0], r"velocity=<lambda> gave shape \(\d+,\); it must be velocities of shape"),
        (lambda x: x / 0.0, r"gave \[.*\] at \[.*\]; it must be finite"),
        (lambda x: x.nothing, "velocity=<lambda> raised AttributeError"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_bad_velocities_are_named(water, velocity, message):
    with pytest.raises(ValueError, match=f"fill 'water': .*{message}"):
        tp.tank((1, 1), 0.25).fill(water, velocity=velocity).sample([water])


@pytest.mark.parametrize("free_surface", [False, True])
def test_particles_on_the_face_of_a_disc_move_with_it(free_surface):
    """Although the face itself, by round-off, is inside or outside."""
    water, air = tp.Fluid("water", density=1000.0, viscosity=1e-3), tp.Fluid("air", density=1.0, viscosity=1e-5)
    for tank in (tp.tank((1, 1), 0.05), tp.tank(shape=[(0, 0), (1, 0), (1, 1), (0, 1)], spacing=0.05)):
        if not free_surface:
            tank.fill(air, velocity=(-2.0, 0.0))
        tank.fill(water, disc=((0.5, 0.5), 0.2), velocity=lambda x: 3.0 + x)
        particles = tank.sample([water, air], fitted=not free_surface, empty=free_surface)
        mine = (particles.fluid == 0) & ~particles.wall
        on_face = mine & (np.abs(np.linalg.norm(particles.position - 0.5, axis=1) - 0.2) < 1e-9)
        assert on_face.sum() > 10
        np.testing.assert_allclose(particles.velocity[mine], 3.0 + particles.position[mine])
        if not free_surface:
            assert (particles.velocity[(particles.fluid == 1) & ~particles.wall] == [-2.0, 0.0]).all()


@pytest.mark.parametrize(
    ("walls", "gravity", "told"),
    [
        (
            ["bottom"],
            (0, 0, -9.81),
            "'bottom' is the side at the lower end of y; gravity acts along z, so the floor is 'back'",
        ),
        (
            ["top"],
            (9.81, 0, 0),
            "'top' is the side at the upper end of y; gravity acts along x, so the floor is 'right'",
        ),
        (["bottom", "back"], (0, 0, -9.81), None),
        (["bottom"], (0, -9.81, 0), None),
        (["left"], (0, 0, -9.81), None),
        (["bottom"], (0, 0, 0), None),
    ],
)
def test_a_floor_by_a_name_of_another_side_is_told(water, walls, gravity, told):
    tank = tp.tank((1, 1, 1), 0.25, jitter=0.1).fill(water, box=((0, 0, 0), (1, 1, 0.5)))
    for wall in walls:
        tank.wall(wall, slip=True)
    doubts = tp.Case(tank, [water], gravity, free_surface=True).doubts()
    assert [told in line for line in doubts] == ([True] if told else [])
