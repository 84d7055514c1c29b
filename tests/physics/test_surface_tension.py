"""Surface tension: its forces and their derivative, drops at rest and in motion, and what a case may say of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drop_particles import RADIUS, drop_case
from flow_problems import flow_problem

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.case.fluid import ranks
from tipfem.errors import Invalid
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.geometry.period import Period
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import Relabelled
from tipfem.physics.carried import Remap
from tipfem.physics.surface_tension.edges import TensionEdges, find_edges
from tipfem.physics.surface_tension.physics import SurfaceTension
from tipfem.physics.term import ElementProperties
from tipfem.remesh.triangles.fitted import with_fluids
from tipfem.step.linear_system import Workspace

FLUIDS = [tp.Fluid(name, rho, 0.1) for name, rho in (("water", 1000.0), ("oil", 800.0), ("air", 1.2))]
SPACING, SCHEME = 0.05, GeneralizedAlpha(0.3, 2e-3)
TABLE = np.zeros((4, 4))
TABLE[[0, 1, 0, 2, 1, 2], [1, 0, 2, 0, 2, 1]] = 30.0, 30.0, 70.0, 70.0, 20.0, 20.0


class Setting:
    """Water, oil with a drop of water in it, and air beside both, with tension at all three interfaces."""

    def __init__(self, jacobian="rows", periodic=None, holds=False):
        tank = tp.tank((1.0, 1.0), SPACING, jitter=0.2, seed=4, periodic=periodic).fill(FLUIDS[0])
        tank = tank.fill(FLUIDS[1], box=((0, 0.5), (1, 1))).fill(FLUIDS[2], box=((0.6, 0.2), (1, 0.8)))
        case = tp.Case(tank.fill(FLUIDS[0], disc=((0.3, 0.75), 0.12)), FLUIDS, (0, 0))
        self.particles, n = case.particles, len(case.particles)
        rng = np.random.default_rng(7)
        self.moves = ~self.particles.wall[:, None]
        mesh = triangulate(self.particles.position, self.particles.wall, SPACING, period=case.period)
        self.mesh = with_fluids(mesh, self.particles, ranks(FLUIDS))
        self.edges = find_edges(self.mesh, self.particles, TABLE)
        self.holding = None
        if holds:  # of any particles, in any direction
            self.edges = replace(self.edges, strain=0.1 * SPACING * rng.uniform(-0.9, 0.9, (n, 2)))
            self.holding = 20.0 * rng.standard_normal((n, 2))
        density = np.array([f.density for f in FLUIDS])[self.mesh.fluid]
        self.problem, self.without = (
            flow_problem(
                self.mesh,
                self.particles,
                ElementProperties(density, 0 * density + 0.1, 0 * density),
                SCHEME,
                np.zeros((n, 2)),
                0.3,
                Workspace(),
                jacobian=jacobian,
                pressure_jump=np.zeros((3, n)),
                tension=tension,
                holding=self.holding,
            )
            for tension in (self.edges, None)
        )
        self.u = rng.uniform(-0.1, 0.1, (n, 2)) * self.moves * SPACING

    def added(self, u):
        """What tension adds to the rows of the particles (N, 2), without their scale, 0 where that is."""
        return self.rows(self.problem, u) - self.rows(self.without, u)

    def rows(self, problem, u):
        problem.residual(problem.vector(u, np.zeros(len(u))))
        return self.unscaled(problem, problem._r)

    def unscaled(self, problem, values):
        rows, scale = (
            download(a, problem.size).reshape(-1, 3)[: len(self.u), :2] for a in (values, problem.equations.scale)
        )
        return np.divide(rows, scale, out=np.zeros_like(rows), where=scale > 0)


def wanted_edges(mesh):
    """{particles: tension} of the edges between two fluids, cell by cell."""
    beside = {}
    for cell, fluid in zip(mesh.cells.tolist(), mesh.fluid.tolist(), strict=True):
        for k in range(3):
            beside.setdefault(frozenset((cell[k], cell[k - 1])), []).append(fluid)
    return {edge: TABLE[tuple(f)] for edge, f in beside.items() if len(f) == 2 and f[0] != f[1]}


def test_edges_are_those_between_fluids_with_the_tension_of_the_two():
    setting = Setting()
    found = {
        frozenset(pair): s for *pair, s in zip(setting.edges.one, setting.edges.other, setting.edges.sigma, strict=True)
    }
    assert found == wanted_edges(setting.mesh)
    assert set(found.values()) == {20.0, 30.0, 70.0}


@pytest.mark.parametrize("periodic", [None, "x"])
def test_forces_are_the_derivative_of_the_energy_at_the_intermediate_positions(periodic):
    setting, rng = Setting(periodic=periodic), np.random.default_rng(3)
    x, v = setting.mesh.position + SCHEME.cf * setting.u, rng.standard_normal(setting.u.shape)
    step = 1e-6 * SPACING
    slope = (setting.edges.energy(x + step * v) - setting.edges.energy(x - step * v)) / (2 * step)
    assert slope == pytest.approx((setting.edges.gradient(x) * v).sum(), rel=1e-8)
    np.testing.assert_allclose(setting.added(setting.u), setting.moves * setting.edges.gradient(x), atol=1e-9)
    forces = setting.edges.gradient(x)
    assert abs(forces).max() > 20.0
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-12)
    if periodic is None:
        assert abs(forces[:, 1] @ x[:, 0] - forces[:, 0] @ x[:, 1]) < 1e-12


def test_what_holds_particles_is_a_spring_that_yields():
    setting = Setting(holds=True)
    largest = np.linalg.norm(setting.holding, axis=1)
    along, stretch = setting.holding / largest[:, None], 0.1 * SPACING
    ends = np.unique(np.concatenate([setting.edges.one, setting.edges.other]))
    drawn = ((setting.edges.strain + setting.u) * along).sum(axis=1) / stretch
    there = np.isin(np.arange(len(drawn)), ends)
    assert (np.abs(drawn[there]) > 1).any()
    assert (np.abs(drawn[there]) < 1).any()
    force = (there * largest * np.clip(drawn, -1, 1))[:, None] * along
    wanted = setting.moves * (setting.edges.gradient(setting.mesh.position + SCHEME.cf * setting.u) + force)
    np.testing.assert_allclose(setting.added(setting.u), wanted, atol=1e-9)


@pytest.mark.parametrize(("jacobian", "holds"), [("rows", False), ("matrix-free", False), ("rows", True)])
def test_products_are_the_derivative_of_the_rows(jacobian, holds):
    setting, rng = Setting(jacobian, holds=holds), np.random.default_rng(2)
    du = rng.standard_normal(setting.u.shape) * setting.moves * SPACING
    step = 1e-5
    expected = (setting.added(setting.u + step * du) - setting.added(setting.u - step * du)) / (2 * step)
    found = []
    for problem in (setting.problem, setting.without):
        setting.rows(problem, setting.u)
        problem.linearise()
        out = problem.buffers.get("test.out", problem.size)
        problem.product(problem.vector(du, np.zeros(len(du))), out)
        found.append(setting.unscaled(problem, out))
    assert abs(expected).max() > 10.0
    np.testing.assert_allclose(found[0] - found[1], expected, atol=1e-6 * abs(found[1]).max())


def test_what_cells_release_that_change_their_fluid_is_the_difference_of_the_energies():
    setting = Setting()
    before = setting.mesh.fluid.copy()
    mesh = Mesh(setting.mesh.position, setting.mesh.cells, np.where(setting.mesh.fluid == 2, 1, setting.mesh.fluid))
    others = find_edges(mesh, setting.particles, TABLE)
    wanted = setting.edges.energy(mesh.position) - others.energy(mesh.position)
    none = np.zeros(len(mesh.position), dtype=bool)
    remap = Remap(setting.mesh, mesh, None, none, np.zeros((1, 2)), Relabelled.of(mesh, before))
    after, _ = SurfaceTension(TABLE).remeshed(setting.edges, setting.particles, remap)
    assert after.lost == pytest.approx(wanted, rel=1e-12)
    assert after.energy(mesh.position) == others.energy(mesh.position)
    assert wanted > 0


@pytest.mark.parametrize("ratio", [1e-3, 1.0, 1e3])
def test_a_drop_at_rest_stays_at_rest(ratio):
    """La 12 000; the jump of pressure is that of the regular polygon, and the drop keeps its area."""
    viscosity = np.sqrt(2 * RADIUS / 12000)
    fluids = [tp.Fluid("outside", ratio, viscosity * ratio), tp.Fluid("drop", 1.0, viscosity)]
    case = drop_case(fluids, surface_tension={("drop", "outside"): 1.0})
    simulation = tp.Simulation(case)
    assert simulation.control.largest == case.surface_tension.capillary_time(case.particles.spacing)
    area, iterations = simulation.volume("drop"), []
    for _ in range(40):
        simulation.step()
        iterations.append(simulation.history[-1]["krylov_iterations"])
    assert viscosity * simulation.particles.max_speed < 1e-12
    assert simulation.volume("drop") == pytest.approx(area, rel=1e-13)
    assert np.mean(iterations[10:]) < 6
    ring = np.unique(simulation.state.part(TensionEdges).one)
    half = np.pi / len(ring)
    jump = np.abs(simulation.pressure_jump[:, ring]).max(axis=0)
    np.testing.assert_allclose(jump * RADIUS, 1 / np.cos(half), rtol=1e-10)


def test_a_drop_with_a_free_surface_stays_at_rest():
    case = drop_case([tp.Fluid("outside", 1.0, 0.0), tp.Fluid("drop", 1.0, 0.01)], box=4)
    keep = (case.particles.fluid == 1) | case.particles.wall
    p, water = case.particles, tp.Fluid("water", 1.0, 0.01)
    particles = tp.Particles(p.position[keep], np.zeros(keep.sum(), int), p.wall[keep], spacing=p.spacing)
    simulation = tp.Simulation(tp.Case(particles, [water], (0, 0), free_surface=True, surface_tension={"water": 1.0}))
    edges = simulation.state.part(TensionEdges)
    assert len(edges.one) == round(2 * np.pi * 4)
    for _ in range(20):
        simulation.step()
    assert 0.01 * simulation.particles.max_speed < 1e-12
    inside = ~simulation.particles.wall & ~simulation.mesh.surface.front
    pressure = simulation.particles.pressure[inside] * RADIUS
    np.testing.assert_allclose(pressure, 1 / np.cos(np.pi / len(edges.one)), rtol=1e-8)


@pytest.mark.slow
def test_the_budget_of_an_oscillating_drop_closes():
    fluids = [tp.Fluid("outside", 0.1, 1e-4), tp.Fluid("drop", 1.0, 1e-3)]
    tight = tp.Numerics(newton_tolerance=1e-10)
    case = drop_case(fluids, excess=0.3, surface_tension={("outside", "drop"): 1.0}, numerics=tight)
    simulation = tp.Simulation(case)
    start = simulation.state.stored(simulation.particles.position)
    for _ in range(60):
        simulation.step()
        row = simulation.history[-1]
        assert abs(row["energy_residual"]) < 1e-9 * start
    columns = {name: np.array([row[name] for row in simulation.history]) for name in simulation.history[0]}
    assert columns["relocated"].sum() > 0
    assert columns["surface_energy"].min() < 0.98 * start
    assert columns["kinetic_energy"].max() > 0.01 * start
    assert 0 < columns["tension_dissipation"].sum() < 0.02 * start
    assert not columns["breakup_energy"].any()
    kinetic = columns["kinetic_energy"] + columns["surface_energy"]
    lost = columns["viscous_dissipation"] + columns["numerical_dissipation"]
    np.testing.assert_allclose(kinetic[-1], start - lost.sum(), rtol=1e-8)


@pytest.mark.parametrize("periodic", [False, True])
def test_the_curvature_is_that_of_the_circle_and_0_where_interfaces_end_or_meet(periodic):
    n, radius, width = 24, 0.3, 1.0
    phi = 2 * np.pi * np.arange(n) / n
    x = radius * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    if periodic:
        x %= width
    edges = replace(Setting().edges, one=np.arange(n), other=(np.arange(n) + 1) % n, sigma=np.ones(n))
    edges = replace(edges, period=Period(np.full(2, width if periodic else 0.0)))
    np.testing.assert_allclose(edges.curvature(x), (np.pi / n) / np.sin(np.pi / n) / radius, rtol=1e-9)
    cut = replace(edges, one=np.append(np.arange(4), 0), other=np.append(np.arange(1, 5), 8), sigma=np.ones(5))
    branch = replace(cut, one=np.append(cut.one, 2), other=np.append(cut.other, 12), sigma=np.ones(6))
    assert np.flatnonzero(cut.curvature(x)).tolist() == [0, 1, 2, 3]
    assert np.flatnonzero(branch.curvature(x)).tolist() == [0, 1, 3]


@pytest.mark.slow
def test_edges_are_split_where_an_interface_with_tension_turns_and_nowhere_else():
    """A drop whose ends have a radius of one spacing, and one of four spacings."""
    fluids = [tp.Fluid("air", 0.1, 1e-3), tp.Fluid("water", 1.0, 1e-2)]
    flat = tp.Case(drop_case(fluids, 8).particles, fluids, (0, 0), surface_tension={("water", "air"): 1.0})
    simulation, spacing = tp.Simulation(flat), RADIUS / 8
    simulation.step()
    assert simulation.state.part(TensionEdges).targets(simulation.particles.position, spacing) is None
    assert (simulation.particles.target == spacing).all()
    longest = []
    for tension in ({}, {("water", "air"): 1e-3}):
        tank = tp.tank((3.0, 1.0), spacing, jitter=0.1).fill(fluids[0])
        tank.fill(fluids[1], where=lambda x: ((x[:, 0] - 1.5) / 0.6) ** 2 + ((x[:, 1] - 0.5) / 0.17) ** 2 < 1)
        simulation = tp.Simulation(tp.Case(tank, fluids, (0, 0), surface_tension=tension))
        # It is drawn out to twice its length, so that edges become long everywhere.
        away = simulation.particles.position - [1.5, 0.5]
        simulation.particles.velocity[:] = np.where(simulation.particles.wall[:, None], 0, [1.0, -1.0] * away)
        simulation.run(until=0.5, progress=False)
        edges = find_edges(simulation.mesh, simulation.particles, np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0.0]]))
        x = simulation.particles.position
        length, curvature = np.hypot(*(x[edges.one] - x[edges.other]).T) / spacing, edges.curvature(x) * spacing
        turns = np.maximum(curvature[edges.one], curvature[edges.other]) > 0.7
        longest.append(length[turns].max())
    assert longest[1] < 1.26 < longest[0]


def test_two_drops_that_merge_release_energy_that_stays_lost():
    water, air = tp.Fluid("water", 1000.0, 1e-2), tp.Fluid("air", 1.2, 1e-4)
    tank = (
        tp.tank((1.0, 0.6), 0.04).fill(air).fill(water, disc=((0.3, 0.3), 0.12)).fill(water, disc=((0.64, 0.3), 0.12))
    )
    tight = tp.Numerics(newton_tolerance=1e-10)
    case = tp.Case(tank, [water, air], (0, 0), surface_tension={("water", "air"): 0.07}, numerics=tight)
    simulation = tp.Simulation(case)
    drops = [len(simulation.mesh.components)]
    left, water_there = simulation.particles.position[:, 0] < 0.47, simulation.particles.fluid == 0
    simulation.particles.velocity[water_there] = np.where(left[water_there, None], [0.2, 0.0], [-0.2, 0.0])
    for _ in range(150):
        simulation.step()
        drops.append(len(simulation.mesh.components))
        row = simulation.history[-1]
        assert abs(row["energy_residual"]) < 1e-8 * row["surface_energy"]
        if row["breakup_energy"]:
            break
    assert drops[0] == 3
    assert drops[-1] == 2
    assert row["broken_films"] == 1
    assert 0 < row["broken_film_volume"] < 0.04**2
    assert not any(before["broken_films"] for before in simulation.history[:-1])
    assert 0 < row["breakup_energy"] < 0.2 * row["surface_energy"]
    assert row["remeshing_surface_energy"] < -0.5 * row["breakup_energy"]


def test_frequencies_and_steps_follow_the_capillary_time():
    fluids = [tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1e-5)]
    tank = tp.tank((1.0, 1.0), 0.1).fill(fluids[1]).fill(fluids[0], box=((0, 0), (1, 0.5)))
    case = tp.Case(tank, fluids, (0, 0), surface_tension={("water", "air"): 0.07})
    time = np.sqrt(1001.2 * 0.1**3 / (4 * np.pi * 0.07))
    assert case.surface_tension.capillary_time(0.1) == pytest.approx(time)
    assert case.natural_frequency() == pytest.approx(0.05 / time)
    assert case.gravity_frequency() == 0
    assert case.surface_tension.acceleration(0.1) == pytest.approx(2 * 0.07 / (1001.2 * 0.01))


WRONG = {
    "between water and oil": ({("water", "oil"): 0.07}, "there is no fluid 'oil'"),
    "negative": ({("water", "air"): -0.07}, "it is -0.07 N/m; it must be a number >= 0"),
    "no free surface": ({"water": 0.07}, "there is no free surface"),
    "twice": ({("water", "air"): 0.07, ("air", "water"): 0.08}, "it is given twice"),
    "with itself": ({("water", "water"): 0.07}, "the same fluid twice"),
    "no dict": (0.07, "it must be a dict"),
    "three": ({("water", "air", "air"): 0.07}, "two names of fluids"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_tensions_are_refused(name, water, air):
    given, text = WRONG[name]
    tank = tp.tank((1.0, 1.0), 0.1).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    with pytest.raises(Invalid, match=text) as error:
        tp.Case(tank, [water, air], (0, 0), surface_tension=given)
    assert error.value.path[0] == "surface_tension"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"interface": "interpolated"}, "needs interface = 'sharp'"),
        ({"numerics": tp.Numerics(pressure="continuous")}, "say 'auto'"),
    ],
)
def test_what_tension_cannot_be_combined_with_is_refused(options, text, water, air):
    tank = tp.tank((1.0, 1.0), 0.1).fill(air).fill(water, box=((0, 0), (1, 0.5)))
    with pytest.raises(Invalid, match=text):
        tp.Case(tank, [water, air], (0, 0), surface_tension={("water", "air"): 0.07}, **options)


def test_the_first_step_of_a_drop_in_a_gas_starts_from_the_pressures_on_both_sides(water, air):
    """With the drop's pressure in the gas beside it, 70 iterations, and 130 on an uneven mesh."""
    tank = tp.tank((0.006, 0.006), 0.0003, jitter=0.15).fill(air).fill(water, disc=((0.003, 0.003), 0.0015))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, 0), surface_tension={("water", "air"): 0.0728}))
    simulation.step()
    assert simulation.history[-1]["krylov_iterations"] < 30
    assert simulation.history[-1]["newton_iterations"] < 4


def test_a_fluid_that_would_spread_without_end_is_refused(water, air):
    """A film of it would need less energy than the surface it covers, and its breaks would make energy."""
    oil = tp.Fluid("oil", 900.0, 0.01)
    tank = tp.tank((1.0, 1.0), 0.1).fill(water, box=((0, 0), (1, 0.5))).fill(oil, disc=((0.5, 0.5), 0.25))
    given = {"oil": 0.02, ("water", "oil"): 0.04}
    text = r"of water and empty space is 0.0728 N/m, more than of both with oil.* give 0.06"
    with pytest.raises(Invalid, match=text):
        tp.Case(tank, [water, oil], (0, 0), free_surface=True, surface_tension={"water": 0.0728, **given})
    case = tp.Case(tank, [water, oil], (0, 0), free_surface=True, surface_tension={"water": 0.06, **given})
    with pytest.raises(ValueError, match=r"surface_tension: that of water and empty space is 0.07 N/m"):
        tp.Simulation(case).steer(tp.SurfaceTension(("water",), 0.07))


def test_steering_changes_the_tension(water, air):
    tank = tp.tank((1.0, 1.0), 0.1).fill(air).fill(water, disc=((0.5, 0.5), 0.25))
    case = tp.Case(tank, [water, air], (0, 0), surface_tension={("water", "air"): 0.07})
    simulation = tp.Simulation(case)
    simulation.step()
    before = simulation.state.stored(simulation.particles.position)
    simulation.steer(tp.SurfaceTension(("air", "water"), 0.035))
    assert simulation.state.stored(simulation.particles.position) == pytest.approx(0.5 * before)
    simulation.step()
    assert (simulation.state.part(TensionEdges).sigma == 0.035).all()
    with pytest.raises(ValueError, match="the interfaces that have a tension are"):
        simulation.steer(tp.SurfaceTension(("air", "oil"), 0.035))
    with pytest.raises(ValueError, match="it must be a number >= 0"):
        tp.SurfaceTension(("air", "oil"), -1.0)


def standing_wave(**numerics):
    """Periods of a capillary wave between equal liquids without viscosity, over Lamb's, from a zero of its height."""
    h, wave = 1 / 16, 2 * np.pi
    x, y = np.linspace(0, 0.5, 9), np.linspace(-0.5, 0.5, 17)
    position = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    wall = (abs(position[:, 0] - 0.25) == 0.25) | (abs(position[:, 1]) == 0.5)
    on = position[:, 1] == 0
    jitter = 0.1 * h * np.random.default_rng(0).uniform(-1, 1, position.shape)
    position += np.where((wall | on)[:, None], 0.0, jitter)
    flow = np.exp(-wave * abs(position[:, 1])) * (1 - 2 * abs(position[:, 1]))
    position[:, 1] += 0.01 * np.cos(wave * position[:, 0]) * flow
    fluid = (position[:, 1] <= 0.01 * np.cos(wave * position[:, 0]) + 1e-9).astype(int)
    sides = {"left": (0, -0.5, 0, 0.5), "right": (0.5, -0.5, 0.5, 0.5), "floor": (0, -0.5, 0.5, -0.5)}
    sides["lid"] = (0, 0.5, 0.5, 0.5)
    walls = [tp.Wall(name, between=(ends[:2], ends[2:]), slip=True) for name, ends in sides.items()]
    fluids = [tp.Fluid("above", 1.0, 0.0), tp.Fluid("below", 1.0, 0.0)]
    particles = tp.Particles(position, fluid, wall, spacing=h)
    options = {"walls": walls, "numerics": tp.Numerics(**numerics), "surface_tension": {("above", "below"): 1.0}}
    simulation = tp.Simulation(tp.Case(particles, fluids, (0, 0), **options))
    heights = []
    while not heights or heights[-1][1] > 0:
        edges = simulation.state.part(TensionEdges)
        x = simulation.particles.position
        middle, width = 0.5 * (x[edges.one] + x[edges.other]), abs(x[edges.one, 0] - x[edges.other, 0])
        heights.append((simulation.time, float((middle[:, 1] * np.cos(wave * middle[:, 0])) @ width)))
        simulation.step()
    (before, high), (after, low) = heights[-2:]
    quarter = before + (after - before) * high / (high - low)
    return 4 * quarter / (2 * np.pi / np.sqrt(wave**3 / 2 * np.tanh(wave / 2)))


def test_liquids_of_equal_density_slide_so_that_waves_have_their_period():
    assert standing_wave() == pytest.approx(1.0, abs=0.03)
    assert standing_wave(sliding=False) > 1.05


def test_two_drops_that_merge_are_an_event_of_the_history(capfd):
    water, air = tp.Fluid("water", 1000.0, 1e-2), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.01, 0.007), spacing=0.0005).fill(air)
    for x, speed in ((0.0032, 0.6), (0.0068, -0.6)):
        tank.fill(water, disc=((x, 0.0035), 0.0015), velocity=(speed, 0))
    case = tp.Case(tank, [water, air], (0, 0), surface_tension={("water", "air"): 0.0728})
    simulation = tp.Simulation(case, probes=[tp.DropProbe(name="drops", fluid="water"), tp.FilmProbe(name="films")])
    simulation.run(until=0.0022)
    rows = simulation.history
    events = [row for row in rows if row["broken_films"]]
    number = simulation.probes["drops"]["number"]
    before = [row["time"] < events[0]["time"] for row in rows]
    assert (number[before] == 2).all()
    assert 1 in number[np.logical_not(before)]
    # A film has two sides: their energy is lost for good, and its air is elsewhere.
    assert sum(row["breakup_energy"] for row in events) > 0
    for row in events:
        assert 0 < row["broken_film_volume"] < 0.0005**2
        assert abs(row["breakup_energy"]) < 2 * 0.0728 * 0.0015  # of three spacings, at most, in a step
        assert abs(row["energy_residual"]) < 1e-6 * row["surface_energy"]
    assert all(row["breakup_energy"] == row["broken_film_volume"] == 0 for row in rows if not row["broken_films"])
    films = simulation.probes["films"]
    assert set(films["time"]) == {row["time"] for row in events}
    for name, column in (("energy", "breakup_energy"), ("area", "broken_film_volume")):
        assert films[name].sum() == pytest.approx(sum(row[column] for row in events), rel=1e-12)
    np.testing.assert_allclose([films["x"][0], films["y"][0]], [0.005, 0.0035], atol=0.001)  # between the drops
    assert (films["fluid"][0], films["beside"][0]) == (1, 0)  # air, which gave way to water
    assert films["energy"] == pytest.approx(0.0728 * films["length"])
    with pytest.raises(ValueError, match="films that break between samples would be left out"):
        tp.Simulation(case, probes=[tp.FilmProbe(name="films", interval=0.1)])
    with pytest.raises(ValueError, match="no interface of the case has a tension"):
        tp.Simulation(tp.Case(tank, [water, air], (0, 0)), probes=[tp.FilmProbe(name="films")])
    assert simulation.volume("water") == pytest.approx(2 * np.pi * 0.0015**2, rel=0.04)
    assert f"broke, the first at t = {events[0]['time']:.6g} s" in capfd.readouterr().err
