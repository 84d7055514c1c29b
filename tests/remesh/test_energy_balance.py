"""tipfem/remesh/energy_balance.py: remeshing adds no energy, and nothing else changes."""

import dataclasses
import itertools

import numpy as np
import pytest
from triangulations import cloud, delaunay

import tipfem as tp
from tipfem.mesh.mesh import Mesh
from tipfem.physics.state import EnergyMemory
from tipfem.remesh.energy_balance import LEAST_GAIN, LENT, Change, EnergyBalance, Exchange, changed_cells

DENSITY, GRAVITY = np.array([1000.0, 1.0]), np.array([0.0, -9.81])
BALANCE, NONE = EnergyBalance(DENSITY, GRAVITY, "consistent"), EnergyMemory()


def energy(x, v, mesh) -> float:
    """Of the velocity that is linear in each triangle, by its values at the middles of the edges, and potential [J]."""
    mass = DENSITY[mesh.fluid] * mesh.measure
    middle = 0.5 * (v[mesh.cells] + v[mesh.cells[:, (1, 2, 0)]])
    return float((mass * ((middle**2).sum(axis=2).sum(axis=1) / 6 - x[mesh.cells].mean(axis=1) @ GRAVITY)).sum())


def scale_of(x, v, mass, kinetic) -> float:
    """Kinetic energy in the frame of the centre of mass, and that of heights above and below it [J]."""
    centre, mean = mass @ x / mass.sum(), mass @ v / mass.sum()
    return float(kinetic - 0.5 * mass.sum() * mean @ mean + mass @ np.abs((x - centre) @ GRAVITY))


def flow(seed=0):
    """Particles in two fluids with a rough velocity, their mesh and lumped masses."""
    rng, x = np.random.default_rng(seed), cloud("walls", seed)
    cells = delaunay(x)
    mesh = Mesh(x, cells, (x[cells, 0].mean(axis=1) > np.median(x[:, 0])).astype(np.int32))
    wall = (x == x.min(axis=0)).any(axis=1) | (x == x.max(axis=0)).any(axis=1)
    particles = tp.Particles(
        position=x, fluid=np.zeros(len(x), dtype=np.int32), wall=wall, spacing=0.1, velocity=rng.normal(size=x.shape)
    )
    mass = np.zeros(len(x))
    np.add.at(mass, cells, (DENSITY[mesh.fluid] * mesh.measure / 3)[:, None])
    return particles, mesh, mass


def changed(particles, where, factor):
    """The particles with a part of their velocities multiplied by a factor, and the change of that."""
    velocity = particles.velocity.copy()
    velocity[where] *= factor
    nothing = np.zeros(len(velocity), dtype=bool)
    return particles.shallow_copy(velocity=velocity), lambda mesh: Change(particles, mesh, None, nothing)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_gained_is_taken_back_where_it_was_gained(seed):
    """The energy is that before; momentum, angular momentum, walls, and what is far from the change are kept."""
    particles, mesh, mass = flow(seed)
    where = ~particles.wall & (np.linalg.norm(mesh.position - mesh.position.mean(axis=0), axis=1) < 0.3)
    after, change = changed(particles, where, 1.03)
    before, other = energy(mesh.position, particles.velocity, mesh), energy(mesh.position, after.velocity, mesh)
    assert other > before
    result, memory = BALANCE.keep(change(mesh), after, mesh, mass, NONE)
    assert memory.owed == pytest.approx(0.0, abs=1e-12 * before)
    assert energy(mesh.position, result.velocity, mesh) == pytest.approx(before, rel=1e-12)
    momentum = mass[:, None] * (result.velocity - after.velocity)
    np.testing.assert_allclose(momentum.sum(axis=0), 0.0, atol=1e-12 * np.abs(momentum).sum())
    turned = mesh.position[:, 0] * momentum[:, 1] - mesh.position[:, 1] * momentum[:, 0]
    assert turned.sum() == pytest.approx(0.0, abs=1e-12 * np.abs(turned).sum())
    np.testing.assert_array_equal(result.velocity[particles.wall], after.velocity[particles.wall])
    near = where.copy()
    near[mesh.cells[where[mesh.cells].any(axis=1)]] = True
    np.testing.assert_array_equal(result.velocity[~near], after.velocity[~near])
    assert (result.velocity[where] != after.velocity[where]).any()


@pytest.mark.parametrize("mass", ["lumped", "interfaces"])
def test_neither_the_energy_of_the_field_nor_that_of_the_mass_matrix_rises(mass):
    """A particle's velocity is reversed: the one or the other energy sets how far relative velocities go."""
    balance, limits = EnergyBalance(DENSITY, GRAVITY, mass), set()
    particles, mesh, masses = flow()
    lumping = np.ones(len(mesh.cells))
    if mass == "interfaces":
        at = [np.isin(np.arange(len(masses)), mesh.cells[mesh.fluid == f]) for f in (0, 1)]
        lumping[~(at[0] & at[1])[mesh.cells].any(axis=1)] = 1.0
        lumping[(at[0] & at[1])[mesh.cells].any(axis=1)] = 0.25

    def of_matrix(velocity):
        v, m = velocity[mesh.cells], DENSITY[mesh.fluid] * mesh.measure
        apart = ((v - v.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
        return float((m * ((v**2).sum(axis=(1, 2)) - (1 - lumping) * apart)).sum() / 6)

    for k, factor in itertools.product(np.flatnonzero(~particles.wall), (-0.7, -1.1)):
        velocity = particles.velocity.copy()
        velocity[k] *= factor
        after = particles.shallow_copy(velocity=velocity)
        change = Change(particles, mesh, None, np.zeros(len(velocity), dtype=bool))
        result, memory = balance.keep(change, after, mesh, masses, NONE)
        x, was = mesh.position, particles.velocity
        before = np.array([energy(x, was, mesh), of_matrix(was)])
        rise = np.array([energy(x, result.velocity, mesh), of_matrix(result.velocity)]) - before
        scale = scale_of(x, was, masses, before[0])
        if memory.owed <= LEAST_GAIN * scale:
            assert (rise <= 1.01 * LEAST_GAIN * scale).all()
            limits.add(tuple(np.abs(rise) < 1e-12 * before))
    assert {(True, False), (False, True)} <= limits


def test_changed_cells_are_found_in_any_order():
    """Cells that stand in other rows, or begin with another corner, have not changed."""
    particles, mesh, _ = flow()
    order = np.random.default_rng(1).permutation(len(mesh.cells))
    cells, fluid = mesh.cells[order][:, (1, 2, 0)].copy(), mesh.fluid[order].copy()
    nothing = np.zeros(len(particles), dtype=bool)
    change = Change(particles, Mesh(mesh.position, cells, fluid), None, nothing)
    assert not changed_cells(change, particles, mesh).any()
    fluid[3] = 1 - fluid[3]
    change = Change(particles, Mesh(mesh.position, cells[1:], fluid[1:]), None, nothing)
    assert set(np.flatnonzero(changed_cells(change, particles, mesh))) == {order[0], order[3]}
    moved, change = changed(particles, 7, 2.0)
    np.testing.assert_array_equal(changed_cells(change(mesh), moved, mesh), (mesh.cells == 7).any(axis=1))


@pytest.mark.parametrize("rough", [False, True])
def test_exchange_is_that_of_its_definition(rough):
    """Cell by cell and edge by edge, in some cells and in those around them."""
    particles, mesh, mass = flow()
    v, x, cells = particles.velocity, mesh.position, mesh.cells
    ends, away = ((f[cells[:, 1:]] - f[cells[:, :1]]).transpose(0, 2, 1) for f in (x, v))
    gradient, taken = away @ np.linalg.inv(ends), np.arange(len(cells)) % 7 == 0
    cell_mass, wanted = DENSITY[mesh.fluid] * mesh.measure, np.zeros_like(v)
    near = np.isin(cells, cells[taken]).any(axis=1)
    for t in np.flatnonzero(near):
        beside = [t, *(o for o in mesh.neighbours[t] if o >= 0 and mesh.fluid[o] == mesh.fluid[t])]
        apart = gradient[t] - gradient[beside].mean(axis=0) if rough else gradient[t]
        for one, other in zip(cells[t], np.roll(cells[t], -1), strict=True):
            if not particles.wall[[one, other]].any():
                edge = x[other] - x[one]
                momentum = cell_mass[t] / 6 * (edge @ apart @ edge) / (edge @ edge) * edge
                wanted[one] += momentum / mass[one]
                wanted[other] -= momentum / mass[other]
    exchange = Exchange(particles.wall, mesh, DENSITY, mass, taken)
    exchange.widen()
    rate = exchange.rates(v, rough=rough)
    np.testing.assert_allclose(rate, wanted, atol=1e-12 * np.abs(wanted).max())
    np.testing.assert_array_equal(exchange._lists.active[: exchange._lists.counts[0]], np.flatnonzero(near))


def test_what_has_not_changed_stays():
    particles, mesh, mass = flow()
    _, change = changed(particles, ~particles.wall, 0.9)
    result, memory = BALANCE.keep(change(mesh), particles, mesh, mass, NONE)
    assert result is particles
    assert memory.owed == 0.0


def test_little_by_what_viscosity_takes_changes_no_velocity_and_is_owed():
    """A hundredth of what it takes while a particle moves by a spacing; a thousandth of each step's is remitted."""
    particles, mesh, mass = flow()
    after, change = changed(particles, ~particles.wall, 1.001)
    gain = energy(mesh.position, after.velocity, mesh) - energy(mesh.position, particles.velocity, mesh)
    velocity = particles.velocity
    dt = 0.1 * particles.spacing / np.linalg.norm(velocity - velocity.mean(axis=0), axis=1).max()
    for dissipated in (9.0 * gain, 11.0 * gain):
        viscous = dataclasses.replace(change(mesh), dissipated=dissipated, dt=dt)
        result, memory = BALANCE.keep(viscous, after, mesh, mass, NONE)
        assert (result is after) == (dissipated > 10 * gain)
        assert memory.owed == pytest.approx(min(gain, 0.1 * dissipated) - 1e-3 * dissipated, rel=1e-6)
    assert BALANCE.keep(viscous, after, mesh, mass, EnergyMemory(-1.005 * gain))[1].owed == 0.0


def test_what_is_lost_is_lost():
    """No velocity changes where remeshing took energy, and nothing is owed to the field."""
    particles, mesh, mass = flow()
    after, change = changed(particles, ~particles.wall, 0.9)
    result, memory = BALANCE.keep(change(mesh), after, mesh, mass, NONE)
    assert result is after
    assert memory.owed == 0.0


def test_what_cannot_be_paid_is_owed_and_paid_later():
    """A fluid in rigid motion has nothing to pay with; what is owed is paid out of later losses, and no more."""
    particles, mesh, mass = flow()
    x = mesh.position
    rigid = particles.shallow_copy(velocity=np.stack([2 - 3 * x[:, 1], 1 + 3 * x[:, 0]], axis=1))
    everywhere = Exchange(rigid.wall, mesh, DENSITY, mass, np.ones(len(mesh.cells), dtype=bool))
    np.testing.assert_allclose(everywhere.rates(rigid.velocity, rough=True), 0.0, atol=1e-13)
    owes, change = changed(rigid, slice(None), 1.01)
    result, memory = BALANCE.keep(change(mesh), owes, mesh, mass, NONE)
    gain = energy(x, owes.velocity, mesh) - energy(x, rigid.velocity, mesh)
    assert memory.owed == pytest.approx(gain, rel=1e-9)
    np.testing.assert_allclose(result.velocity, owes.velocity, rtol=1e-12)
    less, change = changed(rigid, slice(None), 0.999)
    lost = energy(x, rigid.velocity, mesh) - energy(x, less.velocity, mesh)
    _, still = BALANCE.keep(change(mesh), less, mesh, mass, memory)
    assert still.owed == pytest.approx(memory.owed - lost, rel=1e-9)
    assert BALANCE.keep(change(mesh), less, mesh, mass, EnergyMemory(0.5 * lost))[1].owed <= 0.0


@pytest.mark.slow
def test_remeshing_adds_no_energy_to_an_inviscid_flow():
    """A dam break without viscosity between walls that slip: no step's remeshing adds to either energy, by default."""
    fluids = [tp.Fluid("water", density=1000.0, viscosity=0.0), tp.Fluid("air", density=1.0, viscosity=0.0)]
    largest = {}
    for balance in (False, True):
        tank = tp.tank((0.584, 0.584), 0.0292).fill(fluids[1]).fill(fluids[0], box=((0, 0), (0.146, 0.292)))
        for side in ("left", "right", "bottom", "top"):
            tank.wall(side, slip=True)
        numerics = tp.Numerics(largest_move=0.8) if balance else tp.Numerics(largest_move=0.8, energy_balance=False)
        simulation = tp.Simulation(tp.Case(tank, fluids, (0, -9.81), numerics=numerics), time_step=2e-3)
        remesh, rises = simulation.remesher.remesh, []

        def watched(solved, remesh=remesh, rises=rises):
            state = remesh(solved)
            was = energy(solved.particles.position, solved.particles.velocity, solved.before.mesh)
            rises.append(energy(state.mesh.position, state.particles.velocity, state.mesh) - was)
            now, then = state.memory, solved.before.memory
            rises[-1] -= now.owed + now.lent - then.owed - then.lent
            return state

        simulation.remesher.remesh = watched
        simulation.run(0.2, progress=False)
        history = simulation.history
        of_matrix = max(-row["remeshing_dissipation"] for row in history)
        largest[balance] = np.array([max(rises), of_matrix]) / history[0]["potential_energy"]
    assert (largest[False] > 1e-6).all()
    assert (largest[True] < [2 * LEAST_GAIN, 1e-5]).all()


def steps_of(balance, swings, kinetic=1.0, dt=0.05):
    """What is due [J] of rises of potential energy, step by step, and the memories."""
    due, memories = [], [NONE]
    for rise in swings:
        memory, taken = balance._lending(memories[-1], rise, kinetic, dt)
        memories.append(memory)
        due.append(taken)
    return np.array(due), memories[1:]


def test_what_comes_and_goes_within_the_memory_is_hardly_taken_and_a_lasting_gain_is():
    """A swing of potential energy is not friction; a steady rise is due within the memory, and no more than lent."""
    balance = EnergyBalance(DENSITY, GRAVITY, "consistent", extent=1.0)
    time = 0.05 * np.arange(2000)
    swing = np.diff(0.03 * np.sin(2 * np.pi * time / 0.5))
    due, memories = steps_of(balance, swing)
    assert due[due > 0].sum() < 0.1 * swing[swing > 0].sum()
    assert memories[-1].lent + due.sum() == pytest.approx(swing.sum(), abs=1e-12)
    rise = np.full(400, 1e-4)
    due, memories = steps_of(balance, rise)
    assert due[-1] == pytest.approx(1e-4, rel=1e-3)
    assert rise.sum() - due.sum() == pytest.approx(1e-4 * balance.period / 0.05, rel=0.05)
    due, memories = steps_of(balance, np.full(400, 0.02))
    assert max(memory.lent for memory in memories) == pytest.approx(LENT)
    np.testing.assert_allclose(due[50:], 0.02, rtol=1e-9)
    due, memories = steps_of(balance, [-0.05] + [0.0] * 1000 + [0.05])  # a loss that is forgotten buys no gain
    assert memories[-1].lent == pytest.approx(0.05, rel=0.1)
    assert due[:-1].sum() == pytest.approx(-0.05, rel=1e-6)


def test_nothing_is_lent_at_rest_or_without_gravity():
    for balance, kinetic in (
        (EnergyBalance(DENSITY, GRAVITY, "consistent", extent=1.0), 0.0),
        (EnergyBalance(DENSITY, np.zeros(2), "consistent", extent=1.0), 1.0),
    ):
        due, _ = steps_of(balance, [1e-3, -2e-3, 3e-3], kinetic)
        np.testing.assert_array_equal(due, [1e-3, -2e-3, 3e-3])


def test_where_the_flow_is_and_how_fast_it_all_moves_do_not_matter():
    """The same is taken back 1 km away and at 20 m/s, to round-off."""
    particles, mesh, mass = flow()
    nothing = np.zeros(len(mass), dtype=bool)
    results = []
    for place, speed in ((0.0, 0.0), (1000.0, 20.0)):
        x, was = mesh.position + place, particles.velocity + speed
        there = Mesh(x, mesh.cells, mesh.fluid)
        before = particles.shallow_copy(position=x, velocity=was)
        faster = particles.velocity - mass @ particles.velocity / mass.sum()
        after = before.shallow_copy(velocity=was + 0.03 * faster)
        balance = EnergyBalance(DENSITY, GRAVITY, "consistent", extent=1.0)
        change = Change(before, there, None, nothing, dissipated=1.0, dt=1e-3)
        result, memory = balance.keep(change, after, there, mass, NONE)
        results.append((result.velocity - speed, memory.owed, memory.kinetic, change.unnoticed))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
