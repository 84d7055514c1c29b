"""Linear systems in which viscosity moves momentum far in a step: their preconditioner, tolerance and steps."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend import launch as launches
from tipfem.backend.arrays import download
from tipfem.step import block_preconditioner, momentum_polynomial, problem, solve
from tipfem.step.linear_system import LinearSystem

SPACINGS = 10


def channel(number, viscosity=1.0, across=SPACINGS, **options):
    """A channel, one metre across, periodic in x, with steps of nu dt / h^2 = ``number``, driven from rest."""
    fluid = tp.Fluid("oil", 1.0, viscosity)
    tank = tp.tank((1, 1), 1 / across, jitter=0.2, periodic="x").fill(fluid)
    for side in ("bottom", "top"):
        tank.wall(side, law="no-slip")
    case = tp.Case(tank, [fluid], (0.8 * viscosity, 0), **options)
    return tp.Simulation(case, time_step=number / across**2 / viscosity)


def systems_of(simulation, monkeypatch):
    """The linear systems of the next step."""
    found = []

    gather_before = LinearSystem.gather
    with monkeypatch.context() as inner:
        inner.setattr(LinearSystem, "gather", lambda system, **o: (found.append(system), gather_before(system, **o))[1])
        simulation.step()
    return found


@pytest.mark.parametrize("light", [0.0, 0.3])
def test_the_viscous_part_is_the_viscosity_over_the_volume_of_a_particle(light, monkeypatch):
    """Harmonic means of two fluids; nothing where one of them has no viscosity."""
    one, other = tp.Fluid("syrup", 1000.0, 50.0), tp.Fluid("oil", 900.0, light)
    monkeypatch.setattr(block_preconditioner, "ROUGH_OF_SEVERAL", 0.0)
    tank = tp.tank((1, 1), 0.1, jitter=0.2).fill(other).fill(one, box=((0, 0), (1, 0.5)))
    simulation = tp.Simulation(tp.Case(tank, [one, other], (0, -9.81), numerics=tp.Numerics(pressure="continuous")))
    system = systems_of(simulation, monkeypatch)[0]
    e = system._equations
    mu, area, cells = e.properties.viscosity, e.mesh.measure, e.nodes.cells
    assert system._viscous_nodes == len(e.owner)
    with np.errstate(divide="ignore"):
        fluidity = np.bincount(cells.ravel(), np.repeat(area / 3 / mu, 3), len(e.owner))
    found = download(system._viscous, len(e.owner))
    np.testing.assert_allclose(found, e.scheme.cv / fluidity, rtol=1e-12)
    assert (found == 0).any() == (light == 0)


def test_flows_of_little_viscosity_leave_it_out(monkeypatch):
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((1, 1), 0.1, jitter=0.2).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    system = systems_of(tp.Simulation(tp.Case(tank, [water, air], (0, -9.81))), monkeypatch)[0]
    assert system.reducible
    assert system._viscous_nodes == 0


@pytest.mark.parametrize(
    ("fluids", "part"),
    [(1, block_preconditioner.ROUGH), (2, block_preconditioner.ROUGH_OF_SEVERAL)],
    ids=["one", "two"],
)
@pytest.mark.parametrize("size", [(1, 0.8), (0.5, 0.4, 0.5)], ids=["2-D", "3-D"])
def test_rough_pressures_are_scaled_by_the_diagonal_of_their_own_equations(size, fluids, part, monkeypatch):
    """Beside the cycle, a part over the diagonal of C + D G, known up to the cells' deformation in the step."""
    water, air, d = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5), len(size)
    tank = tp.tank(size, 0.1, jitter=0.2)
    tank = (tank if fluids == 1 else tank.fill(air)).fill(water, box=((0,) * d, (*size[:-1], 0.3)))
    gravity = (*[0.0] * (d - 1), -9.81)
    simulation = tp.Simulation(tp.Case(tank, [water, air][:fluids], gravity, free_surface=fluids == 1))
    if fluids == 2:  # the first step is solved to round-off
        simulation.step()
    system = systems_of(simulation, monkeypatch)[0]
    count = system._viscous_nodes
    assert count == len(system._equations.owner)
    matrix = system.matrix()
    moves, presses = (np.flatnonzero((np.arange(matrix.shape[0]) % (d + 1) == d) == k) for k in (False, True))
    schur = matrix[presses][:, presses] - matrix[presses][:, moves] @ matrix[moves][:, presses]
    scale = download(system._equations.scale, system._equations.size)[presses]
    free = scale > 0
    found = download(system._viscous, count)
    wanted = part / (schur.diagonal()[free] / scale[free])
    np.testing.assert_allclose(found[free], wanted, rtol=0.25)
    np.testing.assert_allclose(np.median(found[free] / wanted), 1.0, rtol=0.1)


@pytest.mark.parametrize("jacobian", ["rows", "matrix-free"])
@pytest.mark.parametrize(("number", "across"), [(2, 10), (20, 10), (200, 10), (200, 16), (200, 20)])
def test_viscous_channels_take_few_iterations_and_no_refused_steps(number, across, jacobian):
    simulation = channel(number, across=across, numerics=tp.Numerics(jacobian=jacobian))
    for _ in range(8):
        simulation.step()
    assert sum(row["refused_steps"] for row in simulation.history) == 0
    assert np.mean([row["krylov_iterations"] for row in simulation.history[1:]]) < (8 if number == 2 else 20)


def test_a_body_in_honey_takes_few_iterations():
    """Its rows of the matrix have no pressure, and couple all particles around it."""
    box = np.array([(0.35, 0.45), (0.65, 0.45), (0.65, 0.75), (0.35, 0.75)])
    honey, air = tp.Fluid("honey", 1400.0, 1e4), tp.Fluid("air", 100.0, 0.1)
    tank = tp.tank((1, 1), 1 / 12, jitter=0.1).fill(air).fill(honey, box=((0, 0), (1, 0.6)))
    tank.add(tp.Body(box, density=10.0, law="no-slip"))
    simulation = tp.Simulation(tp.Case(tank, [honey, air], (0, -9.81)), time_step=0.01)
    for _ in range(5):
        simulation.step()
    assert sum(row["refused_steps"] for row in simulation.history) == 0
    assert np.mean([row["krylov_iterations"] for row in simulation.history[1:]]) < 30


@pytest.mark.parametrize("stored", [True, False])
def test_the_preconditioner_is_a_polynomial_of_momentum_by_displacement(stored, monkeypatch):
    """Against NumPy: z_p of the cycle, and z_u = p(W A) W (r_u + G z_p) with Chebyshev's polynomial in sums of T_k."""
    numerics = tp.Numerics(jacobian="rows" if stored else "matrix-free")
    system = systems_of(channel(20, numerics=numerics), monkeypatch)[-1]
    nodes, size = system._nodes, 3 * system._nodes
    put, get = system._equations.buffers.upload, system._equations.buffers.get
    columns, out = [], get("test.column", size)
    for unit in np.eye(size):
        system.product(put("test.unit", unit), out)
        columns.append(download(out, size))
    k = np.stack(columns, axis=1)
    r = np.random.default_rng(1).standard_normal(size) * (download(system._equations.scale, size) > 0)
    system.precondition(put("test.right", r), out)
    z = download(out, size).reshape(nodes, 3)
    u = np.arange(size).reshape(nodes, 3)[:, :2].ravel()
    weights = np.full(len(u), momentum_polynomial.LIKELY)
    if stored:
        total = np.abs(k[np.ix_(u, u)]).sum(axis=1)
        weights = np.divide(1.0, total, out=np.zeros(len(u)), where=total > 0)
    pressures = np.zeros((nodes, 3))
    pressures[:, 2] = z[:, 2]
    b = weights * (r - k @ pressures.ravel())[u]
    values, vectors = np.linalg.eig(weights[:, None] * k[np.ix_(u, u)])
    assert abs(values).max() <= 1.0
    degree, lowest = system.polynomial
    chebyshev = np.polynomial.Chebyshev.basis(degree)
    left = chebyshev((1 + lowest - 2 * values) / (1 - lowest)) / chebyshev((1 + lowest) / (1 - lowest))
    inverse = np.divide(1 - left, values, out=np.zeros_like(values), where=abs(values) > 1e-12)
    expected = (vectors @ (inverse * np.linalg.solve(vectors, b.astype(complex)))).real
    np.testing.assert_allclose(z[:, :2].ravel(), expected, atol=1e-7 * abs(expected).max())
    assert degree == 12
    assert abs(z[:, 2]).max() > 0


def test_the_degree_grows_with_the_viscous_number():
    degrees = [momentum_polynomial.polynomial(number).degree for number in (0.0, 0.4, 0.6, 2.0, 20.0, 2000.0)]
    assert degrees == [0, 0, 4, 7, 12, 12]
    for given in map(momentum_polynomial.polynomial, (0.6, 20.0)):
        assert len(list(momentum_polynomial.factors(given))) == given.degree - 1


@pytest.mark.slow
def test_threads_give_the_same_bits(monkeypatch):
    found = []
    for single in (True, False):
        monkeypatch.setattr(launches, "is_serial", lambda count, cost, single=single: single)
        simulation = channel(200)
        for _ in range(4):
            simulation.step()
        found.append([simulation.particles.velocity, simulation.particles.pressure])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_every_way_to_iterate_takes_the_viscous_part_in(monkeypatch):
    """In one launch, and by separate kernels: the same iterations up to round-off."""
    counts, first = [], None
    for way in ("fused", "separate"):
        with monkeypatch.context() as inner:
            if way != "fused":
                inner.setattr(LinearSystem, "iterations", None)
            simulation = channel(20)
            for _ in range(3):
                simulation.step()
        counts.append([row["krylov_iterations"] for row in simulation.history])
        velocity = simulation.particles.velocity
        first = velocity if first is None else first
        np.testing.assert_allclose(velocity, first, atol=1e-6 * abs(first).max())
    np.testing.assert_allclose(counts[1], counts[0], atol=2)


def test_a_correction_that_reaches_its_limit_serves_if_it_leaves_little(monkeypatch):
    """Newton's method goes on from there; one that leaves much is refused."""
    monkeypatch.setattr(problem, "MAX_KRYLOV_ITERATIONS", 40)
    simulation = channel(20)
    simulation.step()
    assert simulation.history[0]["refused_steps"] == 0
    assert simulation.history[0]["newton_iterations"] > 2
    monkeypatch.setattr(problem, "MAX_KRYLOV_ITERATIONS", 1)
    with pytest.raises(tp.SimulationError, match="the linear system was not solved in 1 iterations"):
        channel(200).step()


def test_the_tolerance_knows_how_far_viscosity_reaches(monkeypatch):
    """A residual of long waves is worth 10 + nu dt / h^2 times as much, where that is above 1."""
    found = []

    def newton(flow, x, *, tolerance, **options):
        found.append((tolerance, flow.equations.viscous_number))
        return solver(flow, x, tolerance=tolerance, **options)

    solver = solve.newton
    monkeypatch.setattr(solve, "newton", newton)
    simulation = channel(20, numerics=tp.Numerics(acceleration_tolerance=1.0))
    for _ in range(2):
        simulation.step()
    (_, (tolerance, number)) = found[-2:]
    assert number == pytest.approx(20, rel=0.5)
    assert tolerance == pytest.approx(2.5e-5 / (10 + number))
