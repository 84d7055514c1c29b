"""Impulses and filtered values of the probes of walls."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import tipfem as tp
from tipfem import probes as tpp
from tipfem.fem.time_integration import BackwardEuler, GeneralizedAlpha
from tipfem.physics.side_pressures.carried import PressureJump
from tipfem.probes.impulses import TimeMeans

G = 9.81


def fed(times, loads, rho_inf=0.0, time_constant=None):
    """The means of a load that was taken in at each of the times."""
    means = TimeMeans(time_constant, 1)
    for time, load in zip(times, loads, strict=True):
        means.add(time, [load], GeneralizedAlpha(rho_inf, 1.0))
    return means


@pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])
def test_a_steady_load_adds_up_and_passes_the_filter(rho_inf):
    times = np.cumsum([0.1, 0.02, 0.3, 0.3, 0.01])
    means = fed(times, np.full(5, 7.0), rho_inf, 0.2)
    assert means.impulse[0] == pytest.approx(7.0 * times[-1], rel=1e-12)
    assert means.filtered[0] == pytest.approx(7.0, rel=1e-12)


def impact(steps, impulse):
    """Loads (K,) of steps with which generalized-alpha with rho_inf = 0 stops a mass that meets a wall in the sixth."""
    loads, speed, acceleration = np.zeros(len(steps)), impulse, 0.0
    for k in range(5, len(steps)):
        # u = 0 = dt v + dt^2 (a' - a / 2): the mass stays where it is.
        following = 0.5 * acceleration - speed / steps[k]
        loads[k] = -(2 * following - acceleration)
        speed += steps[k] * (1.5 * following - 0.5 * acceleration)
        acceleration = following
    return loads


@pytest.mark.parametrize("change", [0.5, 1.0, 1.25])
@pytest.mark.parametrize("dt", [4e-3, 1e-3, 1e-4])
def test_a_sudden_stop_has_one_impulse_and_one_filtered_peak_for_any_steps(dt, change):
    """Where the loads of single steps grow as 1 / dt."""
    steps = np.full(12, dt)
    steps[6:] *= change
    times, loads = np.cumsum(steps), impact(steps, 3.0)
    assert loads.max() == pytest.approx(2 * 3.0 / dt, rel=1e-12)
    assert fed(times, loads).impulse[0] == pytest.approx(3.0, rel=1e-12)
    peak = max(fed(times[:k], loads[:k], time_constant=0.2).filtered[0] for k in range(1, 13))
    assert peak == pytest.approx(3.0 / 0.2, rel=0.02)
    if change != 1.0:
        assert abs((steps * loads).sum() / 3.0 - 1) > 0.1  # what a sum of loads times steps would give


@pytest.mark.parametrize("dt", [4e-3, 1e-4])
def test_an_impact_by_backward_euler_is_its_impulse_once_and_leaves_the_steady_load(dt):
    """A mass under a steady load of 7, stopped within the sixth step by an impulse of 3 more."""
    means, times = TimeMeans(0.2, 1), dt * np.arange(1, 13)
    for k, time in enumerate(times):
        impact = k == 5
        means.add(time, [7.0 + impact * 3.0 / dt], BackwardEuler(dt) if impact else GeneralizedAlpha(0.0, dt))
        assert means.impulse[0] == pytest.approx(7.0 * time + (k >= 5) * 3.0, rel=1e-12)
        assert means.rate[0] == pytest.approx(7.0, rel=1e-12)


def test_the_filter_lags_by_its_time_constant_and_damps_as_it_should():
    tau, times = 0.05, np.cumsum(np.tile([1e-4, 3e-4], 5000))
    assert fed(times, 2.0 * times, time_constant=tau).filtered[0] == pytest.approx(2.0 * (times[-1] - tau), rel=1e-3)
    means, kept = TimeMeans(tau, 1), []
    for time in times:
        means.add(time, [math.sin(time / tau)], GeneralizedAlpha(0.0, 1.0))  # at 1 / (2 pi tau)
        kept.append(means.filtered[0])
    assert max(kept[5000:]) == pytest.approx(math.sqrt(0.5), rel=0.01)


def test_the_impulse_on_walls_is_the_fluid_momentum_through_jerks_and_uneven_steps(water):
    """A full tank is accelerated until 0.03 s, then moves on at 6 mm/s; steps of three lengths."""
    tank = tp.tank((0.2, 0.1), 0.02).fill(water)
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, slip=True)
    motion = tp.Motion(translation=lambda t: (0.1 * t**2 if t < 0.03 else 9e-5 + 6e-3 * (t - 0.03), 0.0))
    case = tp.Case(tank, [water], (0, -G), tank_motion=motion)
    probes = [tp.WallForce(name=side, wall=side, impulse=True) for side in ("left", "right")]
    simulation = tp.Simulation(case, time_step=4e-3, probes=probes)
    random = np.random.default_rng(1)
    while simulation.time < 0.05:
        simulation.control.current = 4e-3 * random.choice([0.25, 0.5, 1.0])
        simulation.step()
    forces = [simulation.probes[side] for side in ("left", "right")]
    impulse = -sum(table["pressure_force_x_impulse"][-1] for table in forces)
    steps = np.diff(forces[0]["time"], prepend=0.0)
    sum_of_loads = -sum((steps * table["pressure_force_x"]).sum() for table in forces)
    momentum = simulation.history[-1]["momentum_x"]
    assert momentum == pytest.approx(6e-3 * water.density * 0.02, rel=1e-3)
    # The walls' own particles have the prescribed acceleration at the ends of steps, which jumps in one of them.
    assert impulse == pytest.approx(momentum, rel=8e-3)
    assert abs(sum_of_loads / momentum - 1) > 3e-3  # what a sum of loads times steps would give


@pytest.fixture
def broken_dam(water, air):
    """A column of water that begins to fall, with a probe that is written at intervals and one at every step."""
    tank = tp.tank((0.2, 0.2), 0.02).fill(air).fill(water, box=((0, 0), (0.1, 0.1)))
    both = {"wall": "left", "at": (0.0, 0.03), "impulse": True, "time_constant": 5e-3}
    probes = [tp.WallPressure(name="every", **both), tp.WallPressure(name="some", interval=7e-3, **both)]
    return tp.Simulation(tp.Case(tank, [water, air], (0, -G)), time_step=2e-3, probes=probes)


def test_an_interval_thins_out_rows_but_not_impulses(broken_dam):
    while broken_dam.time < 0.03:
        broken_dam.step()
    every, some = broken_dam.probes["every"], broken_dam.probes["some"]
    assert list(every) == ["time", "pressure", "pressure_impulse", "pressure_filtered"]
    assert 3 <= len(some["time"]) <= 5
    at = np.searchsorted(every["time"], some["time"])
    for name in every:
        assert every[name][at].tolist() == some[name].tolist()
    units = dict(broken_dam.probes.columns["every"])
    assert (units["pressure_impulse"], units["pressure_filtered"]) == ("Pa s", "Pa")


def test_at_a_particle_of_the_interface_each_cell_has_the_pressure_of_its_own_fluid(broken_dam):
    """Water at a particle adds nothing to the pressure of the air beside it, in cells or on walls."""
    broken_dam.step()
    state, mesh = broken_dam.state, broken_dam.mesh
    shared = np.intersect1d(mesh.cells[mesh.fluid == 0], mesh.cells[mesh.fluid == 1])
    on_floor = shared[state.particles.position[shared, 1] < 1e-9]
    assert len(on_floor) == 1
    air = [tpp.WallForce(name="f", wall="bottom", fluid="air")]
    centres = state.particles.position[mesh.cells[mesh.fluid == 1]].mean(axis=1)
    air += [tpp.PointProbe(name=str(k), at=tuple(place)) for k, place in enumerate(centres[::5])]
    foot = tuple(state.particles.position[on_floor[0]] + [1e-4, 0.0])  # just beside, on the air's face
    air += [tpp.WallPressure(name="w", wall="bottom", at=foot)]
    water = tpp.WallForce(name="f", wall="bottom", fluid="water")
    of_air, of_water = [probe.sample(broken_dam) for probe in air], water.sample(broken_dam)

    pressure, jump = state.particles.pressure.copy(), broken_dam.pressure_jump.copy()
    pressure[shared] += 1000.0  # of the water, the heaviest; the air's own pressure there stays what it was
    jump[1, shared] -= 1000.0
    particles = state.particles.shallow_copy(pressure=pressure)
    broken_dam.state = dataclasses.replace(state, particles=particles, parts={"side_pressures": PressureJump(jump)})
    # The same in the solve, whose walls then hold more.
    solved = broken_dam.solved
    floor = wet_floor(solved.before)
    floor = floor[np.argsort(solved.before.particles.position[floor, 0])][-2:]  # the last but one, and that particle
    face = np.diff((solved.before.particles.position + solved.displacement)[floor, 0])[0]
    pressure, jump = solved.particles.pressure.copy(), solved.part(PressureJump).values.copy()
    pressure[floor[-1]] += 1000.0
    jump[1, floor[-1]] -= 1000.0
    reactions, walls = solved.reactions.copy(), np.flatnonzero(solved.before.particles.wall)
    reactions[np.searchsorted(walls, floor), 1] += 1000.0 * face * np.array([1 / 6, 1 / 3])
    particles = solved.particles.shallow_copy(pressure=pressure)
    parts = {"side_pressures": PressureJump(jump)}
    broken_dam.solved = dataclasses.replace(solved, particles=particles, parts=parts, reactions=reactions)
    for probe, before in zip(air, of_air, strict=True):
        assert probe.sample(broken_dam) == pytest.approx(before, rel=1e-9, abs=1e-9)
    # The water's face beside that particle, a spacing long, bears half of it.
    assert water.sample(broken_dam)[1] - of_water[1] == pytest.approx(-1000.0 * face / 2, rel=1e-9)


def wet_floor(state):
    """The particles of the floor that are corners of the water's cells."""
    wet = np.unique(state.mesh.cells[state.mesh.fluid == 0])
    return wet[state.particles.position[wet, 1] < 1e-9]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"impulse": 1}, "impulse is 1; it must be True or False"),
        ({"time_constant": 0}, "time_constant is 0 s; it must be a number > 0 in s"),
        ({"time_constant": -1.0}, "time_constant is -1.0 s"),
        ({"time_constant": math.inf}, "time_constant is inf s"),
        ({"time_constant": "1"}, "time_constant is '1', a text"),
        ({"time_constant": True}, "time_constant is True;"),
    ],
)
def test_what_is_no_impulse_or_time_constant_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        tp.WallForce(name="f", wall="left", **wrong)
