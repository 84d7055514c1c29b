"""A physics in one file and one line of the registry: here springs that hold particles where they were at first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend.launch import launch
from tipfem.physics import linear_rows, registry
from tipfem.physics.carried import Carried
from tipfem.physics.physics import Physics
from tipfem.physics.term import Term, TermWork

STIFFNESS = 400.0  # of the spring of a particle [N/m, per metre of depth]
LONGEST_STEP = 7e-4


@dataclass(frozen=True)
class Anchors(Carried):
    """Where the springs of N particles are fixed, (N, 2) [m], and which of them have one."""

    place: np.ndarray
    free: np.ndarray
    lost: float = 0.0

    def energy(self, position):
        return 0.5 * STIFFNESS * float(((position - self.place)[self.free] ** 2).sum())


class SpringTerm(Term):
    """k (x_alpha - X) on the particles off the walls, with their anchors X."""

    def __init__(self, anchors):
        self.anchors = anchors.place

    def begin(self, equations, first_node):
        self.equations, e = equations, equations
        self.free = free = np.flatnonzero(~e.particles.wall)
        self.count, put = len(free), e.buffers.upload
        block, constant = np.zeros((self.count, 3, 3)), np.zeros((self.count, 3))
        block[:, (0, 1), (0, 1)] = STIFFNESS * e.scheme.cf
        constant[:, :2] = STIFFNESS * (e.particles.position - self.anchors)[free]
        self.matrix = (
            put("springs.rows", free.astype(np.int32)),
            put("springs.offsets", np.arange(self.count + 1, dtype=np.int32)),
            put("springs.columns", free.astype(np.int32)),
            put("springs.values", block.ravel()),
        )
        self.constant = put("springs.constant", constant.ravel())

    def diagonal(self):
        launch(
            linear_rows.add_diagonal,
            *self.matrix,
            self.equations.scale,
            self.count,
            2,
            work=(self.count, linear_rows.ROW),
        )

    def residual(self, x, out):
        arrays = (*self.matrix, self.constant, self.equations.scale, x, out, self.count, 2)
        launch(linear_rows.add_product, *arrays, work=(self.count, linear_rows.ROW))

    def gather(self, matrix):
        e, work = self.equations, (self.count, linear_rows.ROW)
        launch(linear_rows.add_blocks, *self.matrix, e.scale, matrix, e.rows, self.count, 2, work=work)

    def work(self, x, displacement):
        e, u = self.equations, displacement[self.free]
        stretch = (e.particles.position - self.anchors)[self.free] + e.scheme.cf * u
        return TermWork(stored=float(STIFFNESS * (stretch * u).sum()))


class Springs(Physics[Anchors]):
    """Springs in cases of that title."""

    name = "springs"
    longest_step = LONGEST_STEP
    stored_columns = ("spring_energy", "remeshing_spring_energy", "spring_dissipation")
    columns = ("spring_mean",)

    @classmethod
    def of(cls, case):
        return cls() if case.title == cls.name else None

    def start(self, particles, step):
        return Anchors(particles.position.copy(), ~particles.wall)

    def terms(self, part, step):
        return (SpringTerm(part),)

    def remeshed(self, part, particles, remap):
        """New particles have their springs where they are."""
        place = particles.position.copy()
        if remap.renumbered is None:
            place[~remap.relocated] = part.place[~remap.relocated]
        else:
            kept = np.flatnonzero(remap.renumbered >= 0)
            kept = kept[~remap.relocated[remap.renumbered[kept]]]
            place[remap.renumbered[kept]] = part.place[kept]
        return Anchors(place, ~particles.wall), particles

    def row(self, part, particles):
        return {"spring_mean": float(part.place.mean())}


@pytest.fixture
def springs(monkeypatch):
    monkeypatch.setattr(registry, "PHYSICS", (*registry.PHYSICS, Springs))


def stirred(water, oil, title="springs", **options):
    tank = tp.tank((0.4, 0.3), 0.025).fill(oil).fill(water, box=((0, 0), (0.4, 0.15)))
    k = np.pi / np.array([0.4, 0.3])
    numerics = tp.Numerics(newton_tolerance=1e-11)
    case = tp.Case(tank, [water, oil], (0.3, -9.81), title=title, numerics=numerics, **options)

    def velocity(x):
        return 0.3 * np.stack(
            [np.sin(k[0] * x[:, 0]) * np.cos(k[1] * x[:, 1]), -np.cos(k[0] * x[:, 0]) * 0.75 * np.sin(k[1] * x[:, 1])],
            axis=1,
        )

    free = ~case.particles.wall
    case.particles.velocity[free] = velocity(case.particles.position[free])
    return tp.Simulation(case)


@pytest.fixture
def oil():
    return tp.Fluid("oil", 900.0, 0.05)


@pytest.mark.slow
@pytest.mark.usefixtures("springs")
def test_a_physics_acts_in_steps_remeshings_and_accounts(water, oil):
    options = {"grading": tp.Grading(largest={"oil": 0.05}), "surface_tension": {("water", "oil"): 0.05}}
    simulation, without = stirred(water, oil, **options), stirred(water, oil, title="none", **options)
    assert simulation.control.largest == LONGEST_STEP
    assert without.control.largest > LONGEST_STEP
    count = len(simulation.particles)
    for _ in range(60):
        simulation.step()
        anchors = simulation.state.part(Anchors)
        assert len(anchors.place) == len(simulation.particles)
    assert len(simulation.particles) != count
    last = simulation.history[-1]
    assert last["spring_mean"] == anchors.place.mean()
    assert last["spring_energy"] == anchors.energy(simulation.particles.position)
    tension = simulation.state.parts["surface_tension"]  # whose energy has columns of its own
    assert last["surface_energy"] == tension.energy(simulation.particles.position)
    assert last["spring_energy"] > 0.01 * last["kinetic_energy"]
    kinetic = max(row["kinetic_energy"] for row in simulation.history)
    assert max(abs(row["energy_residual"]) for row in simulation.history) < 1e-8 * kinetic
    assert any(row["remeshing_spring_energy"] < 0 for row in simulation.history)
    assert max(row["newton_iterations"] for row in simulation.history) <= 4  # the derivative is right
    assert all(row["spring_dissipation"] >= 0 for row in simulation.history)
    assert "spring_energy" not in without.budget.columns
    assert Springs not in [type(physics) for physics in without.solver.physics]
