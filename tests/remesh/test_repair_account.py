"""tipfem/remesh/repair_account.py: its parts add up to what remeshing adds, and nothing depends on it."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.results.remeshing_table import remeshing_sums, remeshing_table

QUANTITIES = ("kinetic_energy", "potential_energy", "momentum_x", "momentum_y")


def dam_break(fluids, *, budget="detailed", steps=60, out=None, mass="lumped", **options):
    """A coarse dam break after some steps."""
    tank = tp.tank((0.584, 0.584), 0.0292)
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, law="no-slip")
    for fluid in fluids[1:]:
        tank.fill(fluid)
    tank.fill(fluids[0], box=((0, 0), (0.146, 0.292)))
    case = tp.Case(tank, fluids, (0, -9.81), numerics=tp.Numerics(budget=budget, mass=mass), **options)
    simulation = tp.Simulation(case, out, time_step=3e-3)
    simulation.run(steps * 3e-3, progress=False)
    return simulation


def by_fluid(state, fluid, density):
    """Energies [J] and momentum [N s] of the cells of one fluid."""
    mesh, particles = state.mesh, state.particles
    own = mesh.fluid == fluid
    corner, mass = mesh.cells[own], density * mesh.measure[own] / 3
    v, y = particles.velocity[corner], particles.position[corner][..., 1]
    kinetic, potential = 0.5 * (mass * (v**2).sum(axis=(1, 2))).sum(), 9.81 * (mass * y.sum(axis=1)).sum()
    return np.array([kinetic, potential, *np.einsum("m,mki->i", mass, v)])


@pytest.mark.parametrize("options", [{"free_surface": True}, {}], ids=str)
def test_the_parts_add_up_in_space(water, air, options):
    """Through the first impact, with films that break and, below a free surface, walls that become wet."""
    tank = tp.tank((0.8, 0.4, 0.6), 0.1, jitter=0.15)
    fluids = [water] if options else [water, air]
    tank = (tank if options else tank.fill(air)).fill(water, box=((0, 0, 0), (0.4, 0.4, 0.4)))
    runs = []
    for budget in ("detailed", "total"):
        case = tp.Case(tank, fluids, (0, 0, -9.81), numerics=tp.Numerics(budget=budget), **options)
        runs.append(tp.Simulation(case, time_step=0.01))
        runs[-1].run(0.28, progress=False)
    np.testing.assert_array_equal(*(run.particles.position for run in runs))
    columns, history = runs[0].remesher.account.columns, runs[0].history
    scale = history[0]["potential_energy"]
    for row in history:
        added = sum(row[name] for name in columns if "_energy_" in name)
        assert added == pytest.approx(-row["remeshing_dissipation"], abs=1e-12 * scale)
        for axis in "xyz":
            momentum = sum(row[name] for name in columns if f"_momentum_{axis}_" in name)
            assert momentum == pytest.approx(row[f"remeshing_momentum_{axis}"], abs=1e-11 * scale)
    happened = {name.split("_")[1] for name in columns if any(row[name] for row in history)}
    assert happened >= {"areas", "swaps", "collapses", "splits", "volumes", "momentum"}
    assert ("wetting" in happened) == bool(options)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"interface": "sharp"},
        {"interface": "sharp", "mass": "interfaces"},
        {"interface": "interpolated", "mass": "consistent"},
        {"free_surface": True},
        {"free_surface": True, "interface": "interpolated"},
    ],
    ids=str,
)
def test_the_parts_add_up(water, air, options):
    """For every step, kinds and fluids together give the columns of the budget; the run is the same without them."""
    fluids = [water] if "free_surface" in options else [water, air]
    simulation = dam_break(fluids, **options)
    plain = dam_break(fluids, budget="total", **options)
    np.testing.assert_array_equal(simulation.particles.position, plain.particles.position)
    account = simulation.remesher.account
    assert set(simulation.history[-1]) - set(plain.history[-1]) == set(account.columns)
    scale = simulation.history[0]["potential_energy"]
    for row in simulation.history:
        added = {q: sum(row[name] for name in account.columns if f"_{q}_" in name) for q in QUANTITIES}
        energy = added["kinetic_energy"] + added["potential_energy"]
        assert energy == pytest.approx(-row["remeshing_dissipation"], abs=1e-13 * scale)
        assert added["potential_energy"] == pytest.approx(row["remeshing_potential_energy"], abs=1e-13 * scale)
        for axis in "xy":
            assert added[f"momentum_{axis}"] == pytest.approx(row[f"remeshing_momentum_{axis}"], abs=1e-13 * scale)
    # Each kind that such a flow has does something.
    taken = {name.split("_")[1] for row in simulation.history for name in account.columns if row[name]}
    if "free_surface" in options:
        assert taken >= {"areas", "volumes", "triangulation" if "interface" in options else "flips"}
    elif options["interface"] == "interpolated":
        assert taken >= {"areas", "triangulation", "transfer"}
    else:
        assert taken >= {"areas", "flips", "contacts", "collapses", "splits", "volumes"}


def test_each_fluid_has_its_own(water, air, monkeypatch):
    """What the kinds add to one fluid is the difference of sums over its cells before and after the remeshing."""
    simulation = dam_break([water, air], interface="sharp", steps=40)
    seen = []
    remesh = simulation.remesher.remesh
    monkeypatch.setattr(simulation.remesher, "remesh", lambda solved: (seen.append(solved), remesh(solved))[1])
    for _ in range(3):
        simulation.step()
        sums = remeshing_sums(simulation.history[-1])
        solved = seen.pop()
        moved = type(solved.before)(**{**vars(solved.before), "particles": solved.particles})  # with the old areas
        for number, fluid in enumerate((water, air)):
            added = by_fluid(simulation.state, number, fluid.density) - by_fluid(moved, number, fluid.density)
            found = [sum(kind[q] for kind in sums[fluid.name].values()) for q in QUANTITIES]
            np.testing.assert_allclose(found, added, rtol=1e-9, atol=1e-12)


def test_the_table_at_the_end(water, air, tmp_path):
    """It is the sum of the history, in the results, the summary and as a text."""
    simulation = dam_break([water, air], interface="sharp", steps=20, out=tmp_path / "out")
    sums, results = simulation.remeshing_sums(), tp.read_results(tmp_path / "out")
    collapsed = sum(row["remeshing_collapses_kinetic_energy_air"] for row in simulation.history)
    assert sums["air"]["collapses"]["kinetic_energy"] == pytest.approx(collapsed, rel=1e-14)
    assert results.summary["remeshing"] == sums
    read = results.remeshing_sums()
    assert list(read) == ["water", "air"]
    assert read["water"]["flips"] == pytest.approx(sums["water"]["flips"], rel=1e-6, abs=1e-12)
    text = remeshing_table(sums)
    assert results.remeshing_table().count("\n") == text.count("\n") == 2 * 12 - 1
    assert f"{sums['air']['collapses']['kinetic_energy']:.4g}" in text


def test_without_a_detailed_budget_there_is_no_table(water, air):
    """Nothing is summed, and nothing is printed."""
    simulation = dam_break([water, air], interface="sharp", steps=2, budget="total")
    assert simulation.remeshing_sums() == {}
    assert remeshing_table({}) == ""
    with pytest.raises(ValueError, match="it must be one of 'total', 'detailed'"):
        tp.Numerics(budget="all")
