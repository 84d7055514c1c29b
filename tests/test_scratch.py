"""Memory that is kept from step to step."""

import numpy as np

import tipfem as tp
from tipfem.errors import StepRefused
from tipfem.physics.side_pressures.carried import PressureJump
from tipfem.scratch import KEPT, SMALL, _pieces, copied, filled, owned, scratch


def test_the_same_array_is_the_same_memory_again():
    one = scratch("test.kept", (4, 2))
    assert scratch("test.kept", (4, 2)) is one
    assert np.shares_memory(scratch("test.kept", 3, np.int32), one)
    again = scratch("test.kept", (4, 2))
    assert again.shape == (4, 2)
    assert again.dtype == np.float64
    assert np.shares_memory(again, one)
    assert not np.shares_memory(scratch("test.other", (4, 2)), one)
    grown = scratch("test.kept", (40, 2))
    one.fill(1.0)
    grown.fill(2.0)
    assert (one == 1.0).all()


def test_what_is_copied_or_filled_takes_the_place_of_the_last():
    given = np.arange(6.0).reshape(3, 2)
    one = copied(given[:, :1], "test.copied")
    np.testing.assert_array_equal(one, given[:, :1])
    assert one.flags.c_contiguous
    one[:] = -1.0
    assert given[0, 0] == 0.0
    assert copied(np.array([True, False]), "test.mask", np.int32).tolist() == [1, 0]
    assert filled(7, "test.mask", 2, np.int32).tolist() == [7, 7]


def test_memory_is_used_again_when_nothing_holds_it_any_more():
    rows = 2 * SMALL - 8
    one = owned((rows, 2))
    assert (one.shape, one.dtype, one.flags.c_contiguous) == ((rows, 2), np.float64, True)
    place = one.ctypes.data
    views = [one[:, 0], one.T[:, ::2], one.view(np.int64), memoryview(one), np.asarray(one).reshape(-1)]
    one.fill(3.0)
    del one
    while views:
        assert owned((rows, 2)).ctypes.data != place
        views.pop()
    assert owned((rows, 2)).ctypes.data == place
    assert owned((rows + 1, 2)).ctypes.data == place  # a few rows more
    assert copied(np.zeros((rows, 4), dtype=np.float32)).ctypes.data == place


def test_unused_memory_of_a_size_is_not_kept_without_end():
    many = [owned(17 * SMALL) for _ in range(2 * KEPT)]
    assert len({array.ctypes.data for array in many}) == len(many)
    for k, array in enumerate(many):
        array.fill(k)
    again = [owned(17 * SMALL) for _ in range(2 * KEPT)]
    for array in again:
        array.fill(-1.0)
    assert [array[-1] for array in many] == list(range(len(many)))
    assert max(map(len, _pieces.values())) == KEPT


def flow(spared, monkeypatch):
    """A dam break in which every third step is refused once it is remeshed, and whether memory is ``spared``."""
    monkeypatch.setattr("tipfem.scratch.SMALL", 64 if spared else 1 << 60)
    water, air = tp.Fluid("water", 998.2, 1.002e-3), tp.Fluid("air", 1.204, 1.825e-5)
    tank = tp.tank((0.4, 0.4), 0.04).fill(air).fill(water, box=((0, 0), (0.14, 0.28)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], gravity=(0, -9.81)))
    remesh, calls = simulation.remesher.remesh, []

    def refusing(solved):
        state = remesh(solved)
        calls.append(solved)
        if len(calls) % 3 == 0:
            calls[-1] = None
            raise StepRefused("for a test")
        return state

    monkeypatch.setattr(simulation.remesher, "remesh", refusing)
    return simulation


def arrays_of(state):
    p, mesh, jump = state.particles, state.mesh, state.part(PressureJump)
    of_particles = [p.position, p.velocity, p.acceleration, p.pressure, p.target, p.fluid, state.mass]
    of_mesh = [mesh.cells, mesh.neighbours, mesh.fluid, mesh.measure, mesh.components.mark, mesh.components.label]
    return [*of_particles, *of_mesh, *([] if jump is None else [jump.values])]


def test_states_that_are_held_and_those_of_refused_steps_stay_what_they_were(monkeypatch):
    results = []
    for spared in (False, True):
        simulation, held = flow(spared, monkeypatch), []
        for _ in range(20):
            held.append([(array, array.copy()) for array in arrays_of(simulation.state)])
            simulation.step()
            del held[:-3:2]
            for array, was in (pair for state in held for pair in state):
                np.testing.assert_array_equal(array, was)
        results.append([array.tobytes() for array in arrays_of(simulation.state)])
    assert results[0] == results[1]
