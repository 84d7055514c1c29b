"""tipfem/remesh/stages: each stage alone, on steps of a dam break with air, and of one in empty space."""

import dataclasses
import hashlib

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh.mesh import simplex_measure
from tipfem.remesh.stages.balances import energy_kept
from tipfem.remesh.stages.empty_space import spray_kept_in_tank, with_empty_space, without_empty_space
from tipfem.remesh.stages.in_space import RemeshingInSpace
from tipfem.remesh.stages.motion import left_by_physics, set_back, with_targets
from tipfem.remesh.stages.next_state import labelled
from tipfem.remesh.stages.order import STAGES, STAGES_IN_SPACE
from tipfem.remesh.stages.remeshing import Remeshing
from tipfem.remesh.stages.repairing import held

SIZE, SPACING = (0.4, 0.3), 0.02
WATER, AIR = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)


def simulation(free: bool) -> tp.Simulation:
    """A column of water that falls over, in air or in empty space."""
    tank = tp.tank(SIZE, SPACING)
    tank = (tank if free else tank.fill(AIR)).fill(WATER, box=((0, 0), (0.12, 0.24)))
    fluids = [WATER] if free else [WATER, AIR]
    return tp.Simulation(tp.Case(tank, fluids, (0, -9.81), free_surface=free), time_step=4e-3)


@pytest.fixture(scope="module", params=[False, True], ids=["air", "empty"])
def begun(request):
    """The last remeshing of 40 steps, as it begins, and the state that it led to."""
    s, seen = simulation(request.param), []
    remesh = s.remesher.remesh
    s.remesher.remesh = lambda solved: (seen.append(solved), remesh(solved))[1]
    for _ in range(40):
        s.step()
    return Remeshing.of(seen[-1], s.remesher._rules, s.remesher.account), s.state


def bits(value: object, depth: int = 0) -> str:
    """A hash of the arrays in a dataclass and in those it has."""
    found = hashlib.sha256()
    for field in dataclasses.fields(value):
        part = getattr(value, field.name)
        if isinstance(part, np.ndarray):
            found.update(part.tobytes())
        elif dataclasses.is_dataclass(part) and not isinstance(part, type) and depth < 4:
            found.update(bits(part, depth + 1).encode())
    return found.hexdigest()


def before_the_repair(r: Remeshing) -> Remeshing:
    """A remeshing after the stages that are about motion."""
    return with_targets(left_by_physics(spray_kept_in_tank(set_back(r))))


def test_the_stages_lead_to_the_state_and_change_nothing_they_are_given(begun):
    """A step may be refused at any stage, and taken anew."""
    r, state = begun
    for stage in STAGES:
        start = bits(r)
        after = stage(r)
        assert bits(r) == start, stage.__name__
        r = after
    np.testing.assert_array_equal(r.particles.position, state.particles.position)
    np.testing.assert_array_equal(r.particles.velocity, state.particles.velocity)
    np.testing.assert_array_equal(r.mesh.cells, state.mesh.cells)
    assert r.memory == state.memory


@pytest.mark.parametrize("free", [False, True])
def test_the_stages_in_space_lead_to_the_state(free):
    """They leave the step and the state before it as they were."""
    tank = tp.tank((0.5, 0.25, 0.4), 0.06, jitter=0.1)
    tank = (tank if free else tank.fill(AIR)).fill(WATER, box=((0, 0, 0), (0.2, 0.25, 0.3)))
    s, seen = tp.Simulation(tp.Case(tank, [WATER] if free else [WATER, AIR], (0, 0, -9.81), free_surface=free)), []
    remesh = s.remesher.remesh
    s.remesher.remesh = lambda solved: (seen.append(solved), remesh(solved))[1]
    for _ in range(12):
        s.step()
    r = RemeshingInSpace.of(seen[-1], s.remesher._rules, s.remesher.account)
    solved, before = bits(r.solved), bits(r.before)
    for stage in STAGES_IN_SPACE:
        r = stage(r)
        assert (bits(r.solved), bits(r.before)) == (solved, before), stage.__name__
    state = s.state
    np.testing.assert_array_equal(r.particles.position, state.particles.position)
    np.testing.assert_array_equal(r.particles.velocity, state.particles.velocity)
    np.testing.assert_array_equal(r.mesh.cells, state.mesh.cells)


def test_empty_space_is_meshed_and_left_out_again(begun):
    """With it cells fill the tank; without the repair between, those of the fluids are what they were."""
    r = before_the_repair(begun[0])
    whole = with_empty_space(r)
    if whole is r:
        assert r.mesh.surface.empty is None
        assert without_empty_space(r) is r
        return
    x = whole.particles.position
    assert simplex_measure(x, whole.mesh.cells).sum() == pytest.approx(SIZE[0] * SIZE[1], rel=1e-12)
    assert np.unique(whole.mesh.fluid).tolist() == [0, 1]
    assert whole.spray is not None
    again = without_empty_space(whole)
    order = [np.lexsort(mesh.cells.T) for mesh in (again.mesh, r.mesh)]
    np.testing.assert_array_equal(again.mesh.cells[order[0]], r.mesh.cells[order[1]])
    np.testing.assert_array_equal(again.mesh.surface.loose, r.mesh.surface.loose)


@pytest.mark.parametrize("begun", [False], indirect=True)
def test_particles_that_stay_are_told_by_their_new_numbers(begun):
    r = before_the_repair(begun[0])
    number = np.random.default_rng(0).permutation(len(r.particles)).astype(np.int32)
    order = np.argsort(number)
    fields = {name: getattr(r.particles, name)[order] for name in ("position", "wall")}
    mesh = dataclasses.replace(r.mesh, position=fields["position"], cells=number[r.mesh.cells], components=None)
    end = labelled(r.with_(particles=r.particles.shallow_copy(**fields), mesh=mesh, renumbered=number, reference=3))
    assert end.reference == number[3]
    assert end.fixed.sum() > 0
    np.testing.assert_array_equal(end.fixed[number], r.fixed)
    np.testing.assert_array_equal(end.particles.fluid[number], labelled(r).particles.fluid)


def test_corners_of_the_tank_are_held(begun):
    r = before_the_repair(begun[0])
    fixed, slippery, curved = held(r)
    on = [np.isin(r.particles.position[:, k], [0.0, SIZE[k]]) for k in range(2)]
    corners = on[0] & on[1]
    assert corners.sum() == 4
    assert fixed[corners].all()
    assert not (fixed & (slippery > 0)).any()
    assert r.particles.wall[slippery > 0].all()
    assert curved is None


def test_without_a_balance_energy_is_left_alone(begun):
    r = begun[0]
    r = r.with_(rules=dataclasses.replace(r.rules, balance=None))
    assert energy_kept(r) is r
