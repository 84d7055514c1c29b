"""New numbers of particles and cells: nothing but their order in memory depends on them."""

import numpy as np
import pytest
from pairs.features import FEATURES, content, text
from scipy.spatial import cKDTree

import tipfem as tp
from tipfem.remesh.stages import repairing

ALONE = [(name,) for name in FEATURES if name not in ("space", "sloping")]  # in the plane
FREE = [(name, "free_surface") for name in ("floating_body", "contact_angle", "inlet", "hole", "arc", "graded")]

QUICK = (
    *("arc", "boundary_layers", "floating_body", "graded", "inlet", "periodic", "piston", "swaying", "two_pressures"),
    *map("+".join, FREE),
)


def run(case, steps, first):
    """The case after some steps, sorted in each from the ``first`` on."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(repairing, "SORTED", 1)
        patch.setattr(repairing, "MANY", 0)
        simulation = tp.Simulation(case)
        for step in range(steps):
            patch.setattr(repairing, "PART", -1.0 if step >= first else 1.0)
            simulation.step()
    return simulation


def case_of(names, folder):
    """The case with some features."""
    path = folder / "case.toml"
    path.write_text(text(content(names)))
    return tp.load_case(path).simulation(out=None).case


def require_same_flow(kept, again):
    """Each particle of one run is where one of the other is, with the same fields; so are the sums of its history."""
    one, other = kept.particles, again.particles
    assert len(one) == len(other)
    apart, there = cKDTree(other.position).query(one.position)
    assert sorted(there) == list(range(len(one)))
    assert (there == range(len(one))).all() == (kept.case.interface == "interpolated")
    assert apart.max() < 1e-6 * one.spacing
    np.testing.assert_array_equal(one.fluid, other.fluid[there])
    np.testing.assert_array_equal(one.wall, other.wall[there])
    assert other.wall[again.boundary.index].all()
    assert len(again.boundary.index) == len(kept.boundary.index)
    np.testing.assert_allclose(other.velocity[there], one.velocity, atol=1e-6 * one.max_speed)
    for first, second in zip(kept.history, again.history, strict=True):
        assert second["kinetic_energy"] == pytest.approx(first["kinetic_energy"], rel=1e-6)
        assert second["energy_residual"] == pytest.approx(first["energy_residual"], abs=1e-9 * first["kinetic_energy"])
        assert second["refused_steps"] == first["refused_steps"]


@pytest.mark.slow(but=QUICK)
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("names", ALONE + FREE, ids="+".join)
def test_a_flow_is_the_same_under_new_numbers(names, tmp_path):
    case = case_of(names, tmp_path)
    require_same_flow(run(case, 9, 9), run(case, 9, 1))


def test_walls_of_particles_given_as_arrays_have_their_new_numbers():
    """No wall is named, slips or moves: nothing is found anew from the places of its particles."""
    water, air = tp.Fluid("water", 998.2, 1e-3), tp.Fluid("air", 1.204, 1.825e-5)
    tank = tp.tank((0.4, 0.3), 0.02).fill(air).fill(water, box=((0, 0), (0.2, 0.15)))
    case = tp.Case(tp.Case(tank, [water, air], (0, -9.81)).particles, [water, air], (0, -9.81))
    assert not case.boundary.active
    require_same_flow(run(case, 9, 9), run(case, 9, 1))


@pytest.mark.parametrize("names", [(), ("free_surface",), ("contact_angle",)], ids="+".join)
def test_relocated_particles_are_the_same_under_new_numbers(names, tmp_path):
    """Where the flow is fast enough for some to be relocated while others get new numbers."""
    case = case_of(names, tmp_path)
    kept, again = (run(case, 124, first) for first in (124, 120))
    assert sum(row["relocated"] for row in kept.history[120:]) > 0
    require_same_flow(kept, again)
