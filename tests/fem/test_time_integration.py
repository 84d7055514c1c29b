"""Generalized-alpha and the length of the step, without the flow."""

from __future__ import annotations

import math

import numpy as np
import numpy_twin as twin
import pytest

import tipfem as tp
from tipfem.case.case import SHORTER
from tipfem.fem.time_integration import (
    BackwardEuler,
    GeneralizedAlpha,
    StepControl,
    lasting,
    local_error,
    smallest_jacobian,
)
from tipfem.mesh.delaunay import triangulate

SPECTRAL_RADII = pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])


@pytest.mark.parametrize("rho_inf", [0.0, 0.2, 0.5, 0.8, 1.0])
def test_generalized_alpha_coefficients(rho_inf):
    """Chung & Hulbert's conditions, and the derivatives of the intermediate values by differences."""
    dt = 0.03
    scheme = GeneralizedAlpha(rho_inf, dt)
    assert scheme.alpha_m == pytest.approx((2 * rho_inf - 1) / (rho_inf + 1), rel=1e-15)
    assert scheme.alpha_f == pytest.approx(rho_inf / (rho_inf + 1), rel=1e-15)
    assert scheme.gamma == pytest.approx(0.5 - scheme.alpha_m + scheme.alpha_f, rel=1e-15)  # order 2
    assert scheme.beta == pytest.approx(0.25 * (0.5 + scheme.gamma) ** 2, rel=1e-15)  # largest damping
    assert scheme.alpha_m <= scheme.alpha_f <= 0.5  # stability
    rng = np.random.default_rng(1)
    v, a, u = rng.standard_normal((3, 7, 2))
    particles = tp.Particles(rng.uniform(size=(7, 2)), np.zeros(7), np.zeros(7), v, a, spacing=0.1)
    v0, a0 = scheme.history(particles.velocity, particles.acceleration)
    v_alpha, a_alpha = twin.Alpha(rho_inf, dt).intermediate(u, v, a)
    np.testing.assert_allclose(scheme.cv * u + v0, v_alpha, atol=1e-11)
    np.testing.assert_allclose(scheme.cm * u + a0, a_alpha, atol=1e-9)
    assert scheme.cf == pytest.approx(1 / (1 + rho_inf))
    # a constant acceleration is what the prediction keeps
    predicted = scheme.predict(particles.velocity, particles.acceleration)
    velocity, acceleration = scheme.rates(predicted, particles.velocity, particles.acceleration)[:2]
    np.testing.assert_allclose(acceleration, a, atol=1e-9)
    np.testing.assert_allclose(velocity, v + dt * a, atol=1e-13)


def oscillate(rho_inf, dt, steps, *, stiffness, damping, position=1.0, velocity=0.0):
    """x'' + c x' + k x = 0 by `steps` steps; Particles at the end."""
    scheme = GeneralizedAlpha(rho_inf, dt)
    start = np.array([[position, 0.5 * position]])
    speed = np.array([[velocity, 0.5 * velocity]])
    particles = tp.Particles(start, np.zeros(1), np.zeros(1), speed, -stiffness * start - damping * speed, spacing=1.0)
    for _ in range(steps):
        v0, a0 = scheme.history(particles.velocity, particles.acceleration)
        slope = scheme.cm + damping * scheme.cv + stiffness * scheme.cf
        u = -(a0 + damping * v0 + stiffness * particles.position) / slope
        particles = scheme.advance(particles, u, particles.pressure)
    return particles


@SPECTRAL_RADII
def test_generalized_alpha_is_of_second_order(rho_inf):
    """Positions and velocities of a damped oscillator at t = 2 against the exact solution."""
    k, c, end = 9.0, 0.4, 2.0
    omega = math.sqrt(k - c * c / 4)
    decay = math.exp(-c * end / 2)
    x = decay * (math.cos(omega * end) + c / (2 * omega) * math.sin(omega * end))
    v = -decay * k / omega * math.sin(omega * end)
    errors = []
    for steps in (400, 800, 1600):
        result = oscillate(rho_inf, end / steps, steps, stiffness=k, damping=c)
        errors.append([abs(result.position[0, 0] - x), abs(result.velocity[0, 0] - v)])
        np.testing.assert_allclose(result.position[0, 1], 0.5 * result.position[0, 0], rtol=1e-12)
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert abs(order - 2).max() < 0.1
    assert np.max(errors[-1]) < 1e-3


@pytest.mark.parametrize("rho_inf", [0.0, 0.3, 0.7, 1.0])
def test_generalized_alpha_damps_high_frequencies_as_it_promises(rho_inf):
    """Spectral radius of one step's map of (x, dt v, dt^2 a) at omega dt = 1e5; at most 1 at any frequency."""
    dt = 0.1

    def radius(omega_dt):
        stiffness = (omega_dt / dt) ** 2
        scheme = GeneralizedAlpha(rho_inf, dt)
        columns = []
        for x, v, a in np.eye(3):
            state = tp.Particles([[x, 0.0]], np.zeros(1), np.zeros(1), [[v / dt, 0.0]], [[a / dt**2, 0.0]], spacing=1.0)
            _, a0 = scheme.history(state.velocity, state.acceleration)
            u = -(a0 + stiffness * state.position) / (scheme.cm + stiffness * scheme.cf)
            after = scheme.advance(state, u, state.pressure)
            columns.append([after.position[0, 0], dt * after.velocity[0, 0], dt**2 * after.acceleration[0, 0]])
        return abs(np.linalg.eigvals(np.array(columns).T)).max()

    assert radius(1e5) == pytest.approx(rho_inf, abs=5e-4)
    for omega_dt in (0.01, 0.3, 1.0, 3.0, 10.0, 100.0):
        assert radius(omega_dt) <= 1 + 1e-8


def test_generalized_alpha_keeps_energy_at_most_and_walls_at_rest():
    undamped = oscillate(1.0, 0.05, 400, stiffness=9.0, damping=0.0)
    energy = undamped.velocity[0, 0] ** 2 / 2 + 9.0 * undamped.position[0, 0] ** 2 / 2
    assert energy == pytest.approx(4.5, rel=1e-2)
    wall = np.array([True, False])
    particles = tp.Particles(np.eye(2), np.zeros(2), wall, acceleration=np.ones((2, 2)), spacing=1.0)
    after = GeneralizedAlpha(0.5, 0.1).advance(particles, np.array([[0.0, 0.0], [0.1, 0.2]]), np.array([3.0, 4.0]))
    assert (after.velocity[0] == 0).all()
    assert (after.acceleration[0] == 0).all()
    assert (after.velocity[1] != 0).all()
    np.testing.assert_array_equal(after.position, [[1.0, 0.0], [0.1, 1.2]])
    np.testing.assert_array_equal(after.pressure, [3.0, 4.0])
    assert (particles.acceleration == 1).all()


@SPECTRAL_RADII
def test_histories_are_the_intermediate_values_of_a_particle_that_stays(rho_inf):
    scheme, rng = GeneralizedAlpha(rho_inf, 0.03), np.random.default_rng(2)
    v, a = rng.standard_normal((2, 7, 2))
    v_next, a_next = scheme.rates(np.zeros((7, 2)), v, a)
    velocity, acceleration = scheme.history(v, a)
    np.testing.assert_allclose(velocity, (1 - scheme.alpha_f) * v_next + scheme.alpha_f * v, atol=1e-13)
    np.testing.assert_allclose(acceleration, (1 - scheme.alpha_m) * a_next + scheme.alpha_m * a, atol=1e-10)


def stopped(schemes, speed=2.0, mass=3.0):
    """Velocities after, and forces in, steps of a free mass; in the first step a wall stops it where it is."""
    state = tp.Particles(np.zeros((1, 2)), np.zeros(1), np.zeros(1), [[-speed, 0.0]], spacing=1.0)
    velocities, forces = [], []
    for scheme in schemes:
        forces.append(
            mass * scheme.history(state.velocity, state.acceleration)[1][0, 0]
        )  # a_alpha of a mass that does not move
        state = scheme.advance(state, np.zeros((1, 2)), state.pressure)
        velocities.append(state.velocity[0, 0])
    return velocities, forces


def test_backward_euler_stops_a_mass_by_its_impulse_once_and_generalized_alpha_by_twice_and_minus_once():
    dt, impulse = 0.01, 6.0
    velocities, forces = stopped([BackwardEuler(dt), *[GeneralizedAlpha(0.0, dt)] * 2])
    np.testing.assert_allclose(velocities, 0.0, atol=1e-14)
    np.testing.assert_allclose(np.multiply(forces, dt), [impulse, 0, 0], atol=1e-12)
    velocities, forces = stopped([GeneralizedAlpha(0.0, dt)] * 3)
    np.testing.assert_allclose(velocities, [1.0, 0, 0], atol=1e-12)  # of -2: half of it back
    np.testing.assert_allclose(np.multiply(forces, dt), [2 * impulse, -impulse, 0], atol=1e-12)


def test_backward_euler_loses_the_energy_of_the_jump_and_keeps_the_acceleration_that_lasts():
    rng, dt = np.random.default_rng(3), 0.02
    v, a, u = rng.standard_normal((3, 7, 2))
    particles = tp.Particles(rng.uniform(size=(7, 2)), np.zeros(7), np.zeros(7), v, a, spacing=0.1)
    scheme, renewing = BackwardEuler(dt), BackwardEuler(dt, renews=True)
    v0, a0 = scheme.history(particles.velocity, particles.acceleration)
    after = scheme.advance(particles, u, particles.pressure)
    force = scheme.cm * u + a0
    np.testing.assert_allclose(scheme.cv * u + v0, u / dt, atol=1e-13)
    np.testing.assert_allclose(after.velocity, u / dt + 0.5 * dt * a, atol=1e-13)
    np.testing.assert_allclose(after.velocity - v, dt * force, atol=1e-12)
    loss = 0.5 * dt**2 * (force * (force - a)).sum()
    np.testing.assert_allclose((force * u).sum(), 0.5 * ((after.velocity**2).sum() - (v**2).sum()) + loss)
    np.testing.assert_array_equal(after.acceleration, a)
    np.testing.assert_allclose(renewing.advance(particles, u, particles.pressure).acceleration, force, atol=1e-9)
    assert scheme.cf == 0.5
    for each in (scheme, renewing):
        assert each.mean_load(3.0, 1.0) == 3.0
    assert (scheme.next_rate(3.0, 1.0), renewing.next_rate(3.0, 1.0)) == (1.0, 3.0)


def test_backward_euler_is_exact_where_the_acceleration_lasts_and_stops_what_is_stopped():
    """A free fall for a step has its velocity and displacement; a fall that ends in it has neither speed nor bounce."""
    dt, g = 0.02, -9.81
    for lasts, u in ((g, 1.5 * dt + 0.5 * g * dt**2), (0.0, 0.0)):
        v, a = BackwardEuler(dt).rates(np.array([[u]]), np.array([[1.5]]), np.array([[lasts]]))
        np.testing.assert_allclose(v, 1.5 + g * dt if lasts else 0.0, rtol=1e-13)
        assert a[0, 0] == lasts


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_accelerations_that_last_are_parts_of_both_and_take_energy(dimension):
    rate, load = np.random.default_rng(5).standard_normal((2, 200, dimension))
    rate[0] = 0.0
    kept = lasting(rate, load)
    assert ((load * (load - kept)).sum(axis=1) >= -1e-14).all()  # see `BackwardEuler`
    np.testing.assert_allclose(lasting(rate, rate), rate)
    np.testing.assert_allclose(lasting(rate, 3 * rate), rate)
    np.testing.assert_allclose(lasting(rate, 0.25 * rate), 0.25 * rate)
    np.testing.assert_array_equal(lasting(rate, -2 * rate), 0 * rate)
    turn = np.linalg.qr(np.random.default_rng(6).standard_normal((dimension, dimension)))[0]
    np.testing.assert_allclose(lasting(rate @ turn, load @ turn), kept @ turn, atol=1e-13)


@pytest.mark.parametrize("rho_inf", [0.0, 0.5])
@pytest.mark.parametrize("relaxation", [0.5, 1.5])
def test_another_relaxation_has_the_same_equations_and_momentum_and_is_of_second_order(rho_inf, relaxation):
    rng, dt = np.random.default_rng(4), 0.02
    v, a, u = rng.standard_normal((3, 7, 2))
    particles = tp.Particles(rng.uniform(size=(7, 2)), np.zeros(7), np.zeros(7), v, a, spacing=0.1)
    usual, other = GeneralizedAlpha(rho_inf, dt), GeneralizedAlpha(rho_inf, dt, relaxation=relaxation)
    force, same = (
        scheme.cm * u + scheme.history(particles.velocity, particles.acceleration)[1] for scheme in (usual, other)
    )
    np.testing.assert_allclose(same, force, rtol=1e-12)
    (v1, a1), (v2, a2) = (scheme.rates(u, v, a) for scheme in (usual, other))
    shift = (0.5 - usual.alpha_f) * dt
    np.testing.assert_allclose(v2 + shift * a2, v1 + shift * a1, atol=1e-10)
    np.testing.assert_allclose(a2 - a, relaxation * (a1 - a), atol=1e-8)
    np.testing.assert_allclose(other.mean_load(force, a), (v2 - v) / dt, atol=1e-8)
    errors = []
    for steps in (200, 400):
        state = tp.Particles([[1.0, 0.0]], np.zeros(1), np.zeros(1), [[0.0, 0.0]], [[-9.0, 0.0]], spacing=1.0)
        scheme = GeneralizedAlpha(rho_inf, 2.0 / steps, relaxation=relaxation)
        for _ in range(steps):
            step = -(scheme.history(state.velocity, state.acceleration)[1] + 9.0 * state.position) / (
                scheme.cm + 9.0 * scheme.cf
            )
            state = scheme.advance(state, step, state.pressure)
        errors.append(abs(state.position[0, 0] - math.cos(6.0)) + abs(state.velocity[0, 0] + 3 * math.sin(6.0)))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.15)


def test_step_control_halves_and_grows_back():
    control = StepControl(0.1, growth=1.5)
    assert control.length(0.0, math.inf) == 0.1
    assert control.refuse(0.1)
    assert control.length(0.0, math.inf) == 0.05
    assert control.refuse(0.05)
    dt = control.length(0.0, math.inf)
    lengths = []
    for _ in range(5):
        dt = control.length(0.0, math.inf)
        lengths.append(dt)
        control.accept(dt)
    np.testing.assert_allclose(lengths, [0.025, 0.0375, 0.05625, 0.084375, 0.1], rtol=1e-14)


def test_step_control_is_not_shortened_for_good_by_a_short_remainder():
    control = StepControl(0.1)
    dt = control.length(0.0, 0.003)
    assert dt == 0.003
    control.accept(dt)
    assert control.length(0.0, math.inf) == 0.1


def test_step_control_aims_at_a_displacement():
    control = StepControl(0.1, target=0.35)
    assert control.length(2.0 / 0.01, math.inf) == pytest.approx(0.35 * 0.01 / 2.0, rel=1e-14)
    assert control.length(0.01 / 0.01, math.inf) == 0.1  # too slow to matter
    assert control.length(1e9 / 0.01, math.inf) >= control.smallest  # too fast for any step


def test_step_control_takes_long_moves_only_where_nothing_is_crushed():
    """In a flow whose J is 1 - (rate dt)^2: up to the target, shortened by J, but no shorter than half a spacing."""
    control, speed = StepControl(1.0, target=0.8), 2.0
    for rate, expected in ((0.1, 0.8 / speed), (2.0, 0.99 * math.sqrt(0.6) / 2.0), (20.0, 0.5 / speed)):
        dt = control.length(speed, math.inf, lambda dt, rate=rate: 1 - (rate * dt) ** 2)
        assert dt == pytest.approx(expected, rel=1e-12)
    asked = []
    assert StepControl(1.0, target=0.4).length(speed, math.inf, asked.append) == pytest.approx(0.2)
    assert control.refuse(0.2)
    assert control.length(speed, math.inf, asked.append) == pytest.approx(0.1)
    assert asked == []  # short steps need no look at the elements


@pytest.mark.parametrize("rho_inf", [0.0, 0.4, 0.8, 1.0])
def test_the_local_error_is_that_of_an_acceleration_linear_in_time(rho_inf):
    """b = jerk t, with the accelerations that the method has after many steps."""
    dt, jerk, start, speed = 0.3, 2.0, 1.7, 0.4
    scheme = GeneralizedAlpha(rho_inf, dt)
    a = jerk * (start - (scheme.alpha_f - scheme.alpha_m) * dt)
    load = jerk * (start + (1 - scheme.alpha_f) * dt)
    u = dt * speed + dt**2 * ((0.5 - scheme.beta) * a + scheme.beta * scheme.next_rate(load, a))
    exact = dt * speed + dt**2 * jerk * (start / 2 + dt / 6)
    assert local_error(scheme, load - a) == pytest.approx(u - exact, rel=1e-12)
    assert u - exact > 0.004


def test_step_control_follows_the_error():
    """An error of 0.02 dt^3: steps grow or shrink to 0.7 of the tolerance, and stay there."""
    for first in (1.0, 0.01):
        control, lengths = StepControl(2.0, tolerance=1e-4, current=first), []
        for _ in range(30):
            lengths.append(control.length(0.0, math.inf))
            control.accept(lengths[-1], 0.02 * lengths[-1] ** 3)
        assert lengths[-1] == pytest.approx((0.7 * 1e-4 / 0.02) ** (1 / 3), rel=1e-12)
        assert control.limit == "error"
        assert min(np.divide(lengths[1:], lengths[:-1])) >= 0.5
        assert max(np.divide(lengths[1:], lengths[:-1])) <= 1.25 + 1e-12


def test_step_control_is_not_held_back_by_a_short_step_or_an_impact():
    control = StepControl(1.0, tolerance=1e-4)
    control.accept(0.2, 1e-4)
    length = control.length(0.0, math.inf)
    assert length < 0.2
    control.accept(1e-3, 1e-12)  # for an output
    assert control.length(0.0, math.inf) >= length
    control.accept(length, math.nan)  # an impact
    assert control.length(0.0, math.inf) >= length
    control.accept(length, 0.0)
    assert control.length(0.0, math.inf) > length


def test_step_control_leaves_short_moves_alone():
    control = StepControl(1.0, target=2.0, tolerance=1e-4, free=0.5)
    control.accept(0.2, 1.0)
    assert control.length(0.0, math.inf) == control.accurate == 0.1
    assert control.length(2.0, math.inf) == 0.25
    assert control.length(100.0, math.inf) == 0.02


def test_step_control_gives_up_on_what_is_always_crushed():
    """An element that is flat already does not make steps shorter than half a spacing."""
    control = StepControl(1.0, target=0.8)
    for shrunk in (-1e9, 0.399, -math.inf):
        assert control.length(2.0, math.inf, lambda _dt, j=shrunk: j) == pytest.approx(0.25)


@pytest.mark.parametrize("dimension", [2, 3])
def test_smallest_jacobian_is_that_of_numpy(dimension, water):
    tp.init()
    particles = tp.tank((1.0,) * dimension, 0.2, jitter=0.2).fill(water).sample([water])
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    particles.velocity = np.random.default_rng(0).standard_normal(particles.position.shape)
    for dt in (1e-3, 0.05):
        moved = mesh.moved(particles.position + dt * particles.velocity).measure
        assert smallest_jacobian(mesh, particles, dt) == pytest.approx((moved / mesh.measure).min(), rel=1e-10)


@pytest.mark.parametrize("remaining", [0.25, 0.1, 0.1 + 1e-13, 1.0, 0.101, 0.0999, 7.77])
def test_step_control_divides_the_remaining_time_evenly(remaining):
    control = StepControl(0.1)
    time, lengths = 0.0, []
    while remaining - time > 1e-12:
        lengths.append(control.length(0.0, remaining - time))
        control.accept(lengths[-1])
        time += lengths[-1]
    assert len(lengths) == math.ceil(remaining / 0.1 - 1e-9)
    np.testing.assert_allclose(lengths, remaining / len(lengths), rtol=1e-9)


@pytest.mark.parametrize("remaining", [math.inf, 0.77])
@pytest.mark.parametrize("speed", [0.0, 1e6])
def test_step_control_gives_up(remaining, speed):
    """Steps that are all refused end, whatever the speed and whether or not there is an end time."""
    control = StepControl(0.1, smallest=1e-4)
    lengths = []
    while True:
        lengths.append(control.length(speed / 0.01, remaining))
        if not control.refuse(lengths[-1]):
            break
        assert len(lengths) < 50, f"never gives up: {lengths[-3:]}"
    assert lengths[-1] < 1e-3
    assert (np.diff(lengths) < 0).all()


@pytest.mark.parametrize("largest_step", [0.0, -1.0, math.nan, math.inf])
def test_step_control_rejects_a_senseless_length(largest_step):
    with pytest.raises(ValueError, match="time step"):
        StepControl(largest_step)


def test_the_control_says_what_limits_the_step():
    control = StepControl(0.1, target=0.8)

    def limit(speed=0.0, remaining=math.inf, jacobian=lambda _dt: 1.0):
        control.length(speed, remaining, jacobian)
        return control.limit

    assert limit() == "maximum"
    assert limit(remaining=0.2) == "maximum"  # it divides the time that remains
    assert limit(remaining=0.03) == "output"
    assert limit(speed=10.0) == "motion"
    assert limit(speed=10.0, jacobian=lambda dt: 1 - (12 * dt) ** 2) == "smallest J"
    assert limit(speed=1e9) == "minimum"
    control.refuse(0.1)
    assert limit() == "refusals"
    while control.current < 0.1:
        control.accept(control.current)
    assert limit() == "maximum"


def test_steps_are_shortened_further_where_cells_would_be_nearly_flat():
    """Beyond half a spacing until J is 0.4; where that is asked for, to a quarter until J is 0.1, and no further."""

    def moves(strain, **options):
        control = StepControl(1.0, target=2.0, **options)
        return control.length(1.0, math.inf, lambda dt: 1 - strain * dt**2)

    gentle = {"shorter": SHORTER}
    assert moves(1.0) == moves(1.0, **gentle) == pytest.approx(math.sqrt(0.6), rel=0.05)
    assert moves(3.0) == moves(3.0, **gentle) == 0.5
    assert moves(5.0) == moves(50.0) == 0.5
    assert moves(5.0, **gentle) == pytest.approx(math.sqrt(0.9 / 5), rel=0.05)
    assert moves(50.0, **gentle) == 0.25


@pytest.mark.parametrize("options", [{}, {"shorter": SHORTER}])
def test_the_deformation_of_a_step_is_looked_at_once_where_it_is_small(options):
    asked = []
    StepControl(1.0, target=2.0, **options).length(1.0, math.inf, lambda dt: asked.append(dt) or 0.9)
    assert asked == [1.0]
