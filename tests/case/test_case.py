"""tipfem/case.py, tipfem/device.py's arguments, and what a Simulation refuses before any work."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp


def test_a_body_force_that_works_in_place_does_not_move_the_particles(water):
    def force(x, time):
        x -= 0.5
        return 0.1 * x

    case = tp.Case(tp.tank((1, 1), 0.1).fill(water), [water], (0, -9.81), body_force=force)
    before = case.particles.position.copy()
    case.acceleration(case.particles.position, 0.0)
    np.testing.assert_array_equal(case.particles.position, before)


def test_particles_too_far_from_the_origin_for_their_spacing_are_refused():
    x = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]]) * 0.1 + [1e9, 0]
    with pytest.raises(ValueError, match=r"1e\+09 m from the origin numbers keep too few digits for a spacing of 0.05"):
        tp.Particles(x, np.zeros(5), [True] * 4 + [False], spacing=0.05)


NAN, INF = float("nan"), float("inf")


@pytest.fixture
def particles(water, air):
    """A unit tank of 0.1 m spacing, water under air."""
    return tp.tank((1, 1), 0.1).fill(air).fill(water, box=((0, 0), (1, 0.5))).sample([water, air])


@pytest.fixture
def case(particles, water, air):
    """Maker of cases of that tank, with changes."""

    def make(**changes) -> tp.Case:
        return tp.Case(**{"particles": particles, "fluids": [water, air], "gravity": (0, -9.81), **changes})

    return make


def refusal(exception, make, *words: str) -> None:
    """`make()` must raise `exception`, in one short message that holds all `words`."""
    with pytest.raises(exception) as caught:
        make()
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert "\n" not in message
    assert len(message) < 300


def fluid_particle(particles: tp.Particles) -> int:
    """The first particle that is not of the wall."""
    return int(np.flatnonzero(~particles.wall)[0])


def test_a_case_keeps_what_it_is_given(case, particles, water, air):
    c = case(title="dam", fluids=(water, air))
    assert c.particles is particles
    assert c.fluids == [water, air]
    assert isinstance(c.gravity, np.ndarray)
    assert c.gravity.tolist() == [0, -9.81]
    assert (c.title, c.interface, c.body_force, c.grounded) == ("dam", "sharp", None, False)
    assert c.numerics == tp.Numerics()


def test_a_tank_is_sampled_with_the_case_s_list_of_fluids(case, water, air):
    tank = tp.tank((1, 1), 0.1).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    one, other = case(particles=tank), case(particles=tank, fluids=[air, water])
    np.testing.assert_array_equal(one.particles.fluid, 1 - other.particles.fluid)
    assert (one.particles.fluid[one.particles.position[:, 1] < 0.5] == 0).all()


def test_a_tank_filled_with_a_fluid_that_is_not_in_the_list_is_refused(case, water, air, glycerin):
    tank = tp.tank((1, 1), 0.1).fill(glycerin)
    refusal(ValueError, lambda: case(particles=tank), "'glycerin'", "['water', 'air']")
    refusal(ValueError, lambda: case(particles=tp.tank((1, 1), 0.1)), "no fluid at [0.0, 0.0]")


def test_fluids_must_be_distinct_fluids(case, water):
    refusal(ValueError, lambda: case(fluids=[]), "fluids is []", "at least one")
    refusal(ValueError, lambda: case(fluids=[water, "air"]), "fluids", "'air'")
    refusal(ValueError, lambda: case(fluids=water), "fluids is Fluid", "list")
    refusal(ValueError, lambda: case(fluids=None), "fluids is None", "list")
    twice = [water, tp.Fluid("water", 1.0, 1.0)]
    refusal(ValueError, lambda: case(fluids=twice), "['water', 'water']", "name of its own")


@pytest.mark.parametrize("index", [-1, 2, 17])
def test_a_fluid_index_out_of_range_is_refused_with_its_particle(case, particles, index):
    labels = particles.fluid.copy()
    labels[[41, 50]] = index
    bad = particles.copy(fluid=labels)
    refusal(ValueError, lambda: case(particles=bad), "particle 41", f"fluid {index};", "2 fluid(s)", "between 0 and 1")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"interface": ["x"]}, ["interface is ['x']", "'interpolated'"]),
        ({"interface": 3}, ["interface is 3"]),
        ({"gravity": ("a", "b")}, ["gravity is ('a', 'b')", "2 finite"]),
        ({"gravity": None}, ["gravity is None"]),
        ({"gravity": (0, (1, 2))}, ["gravity is"]),
        ({"body_force": 9.81}, ["body_force is 9.81", "function"]),
        ({"numerics": {"rho_inf": 0.5}}, ["numerics is", "Numerics"]),
    ],
)
def test_values_of_the_wrong_type_are_refused(case, changes, words):
    refusal(ValueError, lambda: case(**changes), "Case: ", *words)


def test_an_unknown_interface_is_refused_before_the_tank_is_sampled(case):
    class Untouchable(tp.Tank):
        def sample(self, fluids):
            raise AssertionError("sampled")

    tank = Untouchable((1, 1), 0.1)
    refusal(ValueError, lambda: case(interface="vof", particles=tank), "interface is 'vof'", "'interpolated'")
    refusal(ValueError, lambda: case(fluids=[], particles=tank), "fluids")


@pytest.mark.parametrize("gravity", [(0, 0, -9.81), -9.81, (0, NAN), (0, -INF), ()])
def test_gravity_must_fit(case, gravity):
    refusal(ValueError, lambda: case(gravity=gravity), "gravity is", repr(gravity), "2 finite", "m/s^2")


@pytest.mark.parametrize("particles", [None, np.zeros((4, 2)), "tank"])
def test_particles_must_be_particles(case, particles):
    refusal(ValueError, lambda: case(particles=particles), f"particles is a {type(particles).__name__}")


def test_duplicates_are_refused_also_when_the_spacing_is_given(case, particles):
    i = fluid_particle(particles)
    x = particles.position.copy()
    x[i] = x[i + 1]
    refusal(ValueError, lambda: case(particles=particles.copy(position=x)), f"{i} and {i + 1} are duplicates")


@pytest.mark.parametrize("place", [(1.2, 0.5), (0.5, -1e-3), (-3.0, -3.0), (0.45, 1 + 1e-9), (0.45, 1 + 1e-12)])
def test_a_particle_outside_the_walls_is_refused_with_its_place(case, particles, place):
    i = fluid_particle(particles)
    x = particles.position.copy()
    x[i] = place
    bad = particles.copy(position=x)
    refusal(ValueError, lambda: case(particles=bad), f"particle {i} at {list(map(float, place))}", "outside the walls")


@pytest.mark.parametrize("place", [(0.45, 0.0), (0.45, 1e-12), (1.0, 0.45)])
def test_a_particle_on_the_wall_is_refused(case, particles, place):
    i = fluid_particle(particles)
    x = particles.position.copy()
    x[i] = place
    refusal(ValueError, lambda: case(particles=particles.copy(position=x)), f"particle {i}", "walls")


def test_a_particle_close_to_the_wall_and_one_on_a_tilted_wall(case, particles):
    i = fluid_particle(particles)
    x = particles.position.copy()
    x[i] = (0.45, 1e-8)
    assert case(particles=particles.copy(position=x)).particles.position[i, 1] == 1e-8
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    case(particles=particles.copy(position=particles.position @ turn.T))
    x[i, 1] = 0.0
    refusal(ValueError, lambda: case(particles=particles.copy(position=x @ turn.T)), f"particle {i}", "walls")


def test_a_cloud_without_walls_and_one_of_walls_alone_are_refused(case, particles):
    nobody = particles.copy(wall=np.zeros(len(particles), bool))
    refusal(ValueError, lambda: case(particles=nobody), "particle 0", "outside the walls")
    gap = particles.wall.copy()
    corner = int(np.flatnonzero((particles.position == 1).all(axis=1))[0])
    gap[corner] = False
    refusal(ValueError, lambda: case(particles=particles.copy(wall=gap)), f"particle {corner} at [1.0, 1.0]")
    everybody = particles.copy(wall=np.ones(len(particles), bool))
    refusal(ValueError, lambda: case(particles=everybody), "all particles are wall particles")


@pytest.mark.parametrize("count", [2, 5])
def test_particles_on_one_line_are_refused(case, count):
    x = np.stack([np.arange(count), np.zeros(count)], axis=1)
    line = tp.Particles(x, np.zeros(count, int), np.arange(count) % (count - 1) == 0 if count > 2 else [True, False])
    refusal(ValueError, lambda: case(particles=line), "Case: ")


@pytest.mark.parametrize("spacing", [1e3, 1e-9])
def test_a_spacing_that_has_nothing_to_do_with_the_particles_is_refused(case, particles, spacing):
    refusal(ValueError, lambda: case(particles=particles.copy(spacing=spacing)), "spacing", f"{spacing:g}")


def test_moving_walls_are_refused(case, particles):
    v = np.zeros((len(particles), 2))
    v[~particles.wall] = (1.0, 2.0)
    assert case(particles=particles.copy(velocity=v)).particles.velocity.max() == 2.0
    v[7] = (0.0, -0.5)
    assert particles.wall[7]
    refusal(ValueError, lambda: case(particles=particles.copy(velocity=v)), "wall particle 7", "[0.0, -0.5]", "zero")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("rho_inf", -0.1),
        ("rho_inf", 1.1),
        ("rho_inf", NAN),
        ("rho_inf", "a"),
        ("rho_inf", None),
        ("stabilisation", [0.25]),
        ("stabilisation", 0.0),
        ("stabilisation", INF),
        ("volume_correction", -1.0),
        ("newton_tolerance", 0.0),
        ("newton_iterations", 0),
        ("smallest_jacobian", -0.1),
        ("smallest_jacobian", 1.0),
    ],
)
def test_numbers_of_the_method_are_checked(name, value):
    refusal(ValueError, lambda: tp.Numerics(**{name: value}), f"Numerics: {name} is {value!r}", "number from")
    assert getattr(tp.Numerics(), name) != value


def test_numbers_of_the_method_of_another_kind_are_refused():
    refusal(ValueError, lambda: tp.Numerics(newton_iterations=2.5), "newton_iterations is 2.5", "whole number")
    refusal(ValueError, lambda: tp.Numerics(relocation=0.6), "relocation is 0.6", "RelocationRule")
    refusal(ValueError, lambda: tp.Numerics(momentum_transfer="no"), "momentum_transfer is 'no'", "True or False")
    refusal(ValueError, lambda: tp.Numerics(fitting=0.6), "fitting is 0.6", "FittedRule")
    refusal(ValueError, lambda: tp.FittedRule(too_close=2), "too_close is 2", "from 0.1 to 0.95")


def test_acceleration_is_gravity_plus_the_body_force(case):
    x = np.random.default_rng(1).uniform(size=(7, 2))
    np.testing.assert_array_equal(case().acceleration(x, 0.0), np.tile([0, -9.81], (7, 1)))
    c = case(body_force=lambda x, t: np.stack([t * x[:, 1], -2 * x[:, 0]], axis=1))
    np.testing.assert_allclose(c.acceleration(x, 3.0), np.stack([3 * x[:, 1], -9.81 - 2 * x[:, 0]], axis=1))
    assert c.gravity.tolist() == [0, -9.81]


@pytest.mark.parametrize(
    ("force", "what"),
    [(lambda x, t: x[:, 0], "(5, 2)"), (lambda x, t: (0.0, t), "(5, 2)"), (lambda x, t: x * NAN, "[nan, nan] at [1.0")],
)
def test_a_body_force_of_the_wrong_shape_or_not_finite_is_refused(case, force, what):
    c = case(body_force=force)
    refusal(ValueError, lambda: c.acceleration(np.ones((5, 2)), 0.25), "body_force at t = 0.25 s", what)


@pytest.mark.parametrize(
    ("gravity", "place"), [((0, -9.81), (None, 1)), ((0, 3.0), (None, 0)), ((2, 0), (0, None)), ((-1, -1), (1, 1))]
)
def test_the_pressure_is_zero_at_the_highest_wall_particle(case, particles, gravity, place):
    i = case(gravity=gravity).pressure_reference()
    assert particles.wall[i]
    for coordinate, expected in zip(particles.position[i], place, strict=True):
        assert expected is None or coordinate == expected


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"arch": "tpu"}, ["arch is 'tpu'", "['cpu', 'cuda', 'vulkan']"]),
        ({"arch": ""}, ["arch is ''"]),
        ({"precision": "f16"}, ["precision is 'f16'", "['f32', 'f64']"]),
        ({"precision": 64}, ["precision is 64"]),
        ({"threads": 0}, ["threads is 0", ">= 1"]),
        ({"threads": -3}, ["threads is -3"]),
        ({"threads": "2"}, ["threads is '2'", "whole number"]),
        ({"threads": 2.0}, ["threads is 2.0", "whole number"]),
        ({"threads": True}, ["threads is True", "whole number"]),
        ({"threads": 100_000}, ["threads is 100000", "core(s)"]),
    ],
)
def test_init_refuses_what_it_does_not_know(arguments, words):
    refusal(ValueError, lambda: tp.init(**arguments), "init: ", *words)


def test_init_refuses_another_runtime_and_takes_the_same_one_again():
    tp.init(arch="cpu", precision="f64")
    refusal(RuntimeError, lambda: tp.init(precision="f32"), "already runs", "'f32'", "one runtime")
    refusal(RuntimeError, lambda: tp.init(threads=1), "already runs")


@pytest.mark.parametrize("value", [0.0, -1e-3, NAN])
def test_a_simulation_refuses_impossible_times(case, value):
    refusal(ValueError, lambda: tp.Simulation(case(), time_step=value), "time step is", f"{value:g}", "> 0")
    refusal(ValueError, lambda: tp.Simulation(case(), output_interval=value), "output_interval is", repr(value))
    simulation = tp.Simulation(case())
    until, words = (value, "must be a number") if value != value else (min(value, 0.0), "later than")
    refusal(ValueError, lambda: simulation.run(until), "until is", words)
    refusal(ValueError, lambda: simulation.step(until), "until is", words)
    assert simulation.step_number == 0
    assert simulation.history == []


def test_a_simulation_leaves_the_case_s_particles_alone(case, particles):
    before = particles.copy()
    simulation = tp.Simulation(case())
    for name in ("position", "fluid", "wall", "velocity", "acceleration", "pressure"):
        assert not np.shares_memory(getattr(simulation.particles, name), getattr(particles, name))
        np.testing.assert_array_equal(getattr(particles, name), getattr(before, name))


def test_a_fluid_is_found_by_name_and_an_unknown_one_refused(case):
    simulation = tp.Simulation(case(interface="interpolated"))
    assert simulation.case.fluid_index("air") == 1
    assert simulation.volume("water") == pytest.approx(0.5, rel=1e-12)
    refusal(ValueError, lambda: simulation.volume("oil"), "'oil'", "['water', 'air']")


def test_an_unwritable_folder_is_refused_with_its_path(case, tmp_path):
    (tmp_path / "file").write_text("here")
    for out in (tmp_path / "file", tmp_path / "file" / "below" / "it"):
        refusal(ValueError, lambda out=out: tp.Simulation(case(), out=out), f"out is {str(out)!r}", "cannot be written")
    assert (tmp_path / "file").read_text() == "here"


def test_a_refused_simulation_leaves_earlier_results_alone(case, tmp_path):
    (tmp_path / "history.csv").write_text("an earlier run")
    refusal(ValueError, lambda: tp.Simulation(case(), out=tmp_path, time_step=-1.0), "time step")
    sunk = case()
    sunk.particles.position[~sunk.particles.wall] = 0.5  # behind the case's back: there is no mesh of these
    refusal(ValueError, lambda: tp.Simulation(sunk, out=tmp_path), "cannot be meshed")
    assert (tmp_path / "history.csv").read_text() == "an earlier run"


def test_a_free_surface_chooses_the_interface_it_needs(water, air):
    """Sharp when nothing is said, in 3-D the only one; a tank may then be filled in part."""
    tank = tp.tank((1, 1), 0.1).fill(water, box=((0, 0), (1, 0.5)))
    c = tp.Case(tank, [water], (0, -9.81), free_surface=True)
    assert (c.interface, c.grounded) == ("sharp", True)
    deep = tp.tank((1, 1, 1), 0.25, jitter=0.1).fill(water, box=((0, 0, 0), (1, 1, 0.5)))
    assert tp.Case(deep, [water], (0, 0, -9.81), free_surface=True).interface == "sharp"
    refusal(
        ValueError,
        lambda: tp.Case(deep, [water], (0, 0, -9.81), free_surface=True, interface="interpolated"),
        "it must be 'sharp'",
    )
    assert c.filled is not None
    assert c.filled(np.array([[0.5, 0.2], [0.5, 0.7]])).tolist() == [True, False]
    refusal(ValueError, lambda: tp.Case(tank, [water], (0, -9.81)), "no fluid at", "free surface")
    refusal(ValueError, lambda: tp.Case(tank, [water], (0, -9.81), free_surface="yes"), "'yes'", "True or False")
    refusal(ValueError, lambda: tp.Numerics(surface=1.2), "surface is 1.2", "SurfaceRule")


def test_only_walls_may_have_no_fluid_and_only_with_a_free_surface(case, particles):
    """Fluid -1 is a dry wall."""
    dry = particles.copy()
    dry.fluid[np.flatnonzero(particles.wall)[-1]] = -1
    refusal(ValueError, lambda: case(particles=dry), "has fluid -1")
    assert case(particles=dry, free_surface=True).particles is dry
    loose = particles.copy()
    loose.fluid[fluid_particle(particles)] = -1
    refusal(ValueError, lambda: case(particles=loose, free_surface=True), "has fluid -1")


def with_inner_wall(water, inside) -> tp.Particles:
    """A unit tank of water in which the particles at places ``inside(x)`` are wall particles."""
    p = tp.tank((1, 1), 0.1).fill(water).sample([water])
    return p.copy(wall=p.wall | inside(p.position))


def test_walls_inside_a_closed_case_are_refused(water):
    p = with_inner_wall(water, lambda x: np.abs(x - 0.5).max(axis=1) < 0.06)
    inner = np.flatnonzero(np.abs(p.position - 0.5).max(axis=1) < 0.06)
    words = f"wall particle {inner[0]} at ", "5 spacings inside", "closed case"
    refusal(ValueError, lambda: tp.Case(p, [water], (0, -9.81)), *words)
    assert tp.Case(p, [water], (0, -9.81), free_surface=True).grounded


def test_a_tank_cannot_be_changed_after_its_case(water, air):
    tank = tp.tank((1, 1), 0.1).fill(water)
    tp.Case(tank, [water], (0, -9.81))
    refusal(ValueError, lambda: tank.fill(air, box=((0, 0), (1, 0.5))), "fill", "a Case has been made of this tank")
    refusal(ValueError, lambda: tank.wall("top", slip=True), "wall 'top'", "a Case has been made of this tank")


def test_a_tank_whose_case_was_refused_can_be_mended(water, air):
    tank = tp.tank((1, 1), 0.1).fill(water, box=((0, 0), (1, 0.5)))
    refusal(ValueError, lambda: tp.Case(tank, [water, air], (0, -9.81)), "no fluid")
    tp.Case(tank.fill(air, box=((0, 0.5), (1, 1))), [water, air], (0, -9.81))
