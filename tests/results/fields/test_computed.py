"""Fields that are computed from velocities: closed forms, orders, sides of interfaces, and the ways to see them."""

from __future__ import annotations

import dataclasses

import meshio
import numpy as np
import pytest
from scipy.spatial import Delaunay

import tipfem as tp
from tipfem.case.fluid import law_table
from tipfem.run.liveview.control import describe, snapshot_of
from tipfem.run.liveview.source import Scenes

MUD = tp.Fluid("mud", 1000.0, tp.Bingham(yield_stress=20.0, viscosity=0.5, regularisation=40.0))
PASTE = tp.Fluid("paste", 1100.0, tp.PowerLaw(consistency=2.0, index=0.5))
OIL = tp.Fluid("oil", 900.0, 0.05)


def state(velocity, dimension=2, across=12, fluids=(MUD,), jitter=0.3, pressure=lambda x: 0 * x[:, 0]):
    """A `FieldState` on a jittered lattice in the unit box; cells right of x = 1/2 are of the last fluid."""
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, across + 1)] * dimension, indexing="ij"), axis=-1).reshape(
        -1, dimension
    )
    inside = ((x > 0) & (x < 1)) & (np.abs(x - 0.5) > 1e-9)[:, :1]
    x = x + inside * np.random.default_rng(1).uniform(-jitter, jitter, x.shape) / across
    cells = Delaunay(x).simplices
    edges = x[cells[:, 1:]] - x[cells[:, :1]]
    cells = cells[np.abs(np.linalg.det(edges)) > 1e-3 / across**dimension]
    owner = np.where(x[cells].mean(axis=1)[:, 0] > 0.5, len(fluids) - 1, 0)
    fluid = np.where(x[:, 0] > 0.5 + 1e-9, len(fluids) - 1, 0)
    density = np.array([one.density for one in fluids])[fluid]
    none = np.zeros(0, dtype=int)
    values = velocity(x), pressure(x), fluid, density, np.zeros(len(x), bool)
    return tp.FieldState(0, 0.0, x, *values, cells, owner, none, law_table(fluids), spacing=1 / across)


def inner(x, margin=1e-9):
    return ((x > margin) & (x < 1 - margin)).all(axis=1)


@pytest.mark.parametrize("dimension", [2, 3])
def test_rigid_rotation_has_twice_its_rate_as_vorticity_and_no_shear(dimension):
    spin = np.array([0.4, -1.1, 0.7])
    wide = lambda x: np.pad(x - 0.3, ((0, 0), (0, 3 - dimension)))  # noqa: E731
    turned = state(
        lambda x: np.cross(spin if dimension == 3 else (0, 0, spin[2]), wide(x))[:, :dimension], dimension, 6
    )
    expected = 2 * spin if dimension == 3 else 2 * spin[2]
    np.testing.assert_allclose(
        turned.field("vorticity"), np.broadcast_to(expected, turned.field("vorticity").shape), rtol=1e-10
    )
    np.testing.assert_allclose(turned.field("shear_rate"), 0.0, atol=1e-10)


@pytest.mark.parametrize("dimension", [2, 3])
def test_fields_at_places_are_those_of_their_cells(dimension):
    """What is linear is exact, densities are those of the side of the interface, and outside there is nothing."""
    slope = np.arange(1.0, dimension + 1)
    flow = state(lambda x: 2.0 * x, dimension, 6, fluids=(MUD, OIL), pressure=lambda x: x @ slope)
    places = np.random.default_rng(2).uniform(0.0, 1.0, (20, dimension))
    np.testing.assert_allclose(flow.at("pressure", places), places @ slope, rtol=1e-12)
    np.testing.assert_allclose(flow.at("velocity_y", places), 2.0 * places[:, 1], rtol=1e-12)
    assert flow.at("vorticity", places).shape == (20, 3)[: dimension - 1]
    np.testing.assert_array_equal(flow.at("density", places), np.where(places[:, 0] > 0.5, 900.0, 1000.0))
    assert (flow.at("viscosity", places)[places[:, 0] > 0.5] == 0.05).all()
    assert np.isnan(flow.at("speed", places + 1.0)).all()
    for wrong in (places[0], places[:, :1], "here", [(np.nan,) * dimension]):
        with pytest.raises(ValueError, match=rf"places: .* must have {dimension} numbers a place"):
            flow.at("speed", wrong)


@pytest.mark.filterwarnings("ignore:tank_motion begins")
def test_means_are_over_the_times_at_which_a_fluid_is_there(tmp_path):
    """A level that is lifted: above it there is fluid for a part of the time only, over which the mean is."""
    water = tp.Fluid("water", 1000.0, 1e-3)
    tank = tp.tank((0.2, 0.2), 0.02).fill(water, box=((0, 0), (0.2, 0.1)))
    motion = tp.Motion(translation=lambda t: (0.0, 0.5 * t))
    case = tp.Case(tank, [water], (0, -9.81), tank_motion=motion, free_surface=True)
    simulation = tp.Simulation(case, tmp_path / "out", time_step=2e-3, output_interval=0.01)
    simulation.run(0.04, progress=False)
    results, places = tp.read_results(tmp_path / "out"), [(0.1, 0.05), (0.1, 0.109), (0.1, 0.19)]
    by_hand = np.array([state.at("velocity_y", places) for state in results])
    np.testing.assert_allclose(results.times, [0.0, 0.01, 0.02, 0.03, 0.04])
    wet = np.isfinite(by_hand)
    assert wet.sum(axis=0).tolist() == [5, 3, 0]
    mean = results.mean("velocity_y", places)
    assert mean[0] == pytest.approx(np.trapezoid(by_hand[:, 0], results.times) / 0.04, rel=1e-12)
    assert mean[1] == pytest.approx(by_hand[2:, 1] @ [1.0, 1.0, 0.5] / 2.5, rel=1e-12)
    assert np.isnan(mean[2])
    np.testing.assert_array_equal(results.mean("velocity_y", places, start=0.035), by_hand[-1])
    with pytest.raises(ValueError, match=r"none of 5 stored states is from 1 to inf s"):
        results.mean("speed", places, start=1.0)


def test_stretching_along_the_axis_strains_rings_too():
    """Of u = (-a r / 2, a z) the rate is sqrt(3) a."""
    stretched = state(lambda x: 2.0 * np.stack([-x[:, 0] / 2, x[:, 1]], axis=1))
    round_flow = dataclasses.replace(stretched, axial=True)
    np.testing.assert_allclose(round_flow.field("shear_rate"), np.sqrt(3) * 2.0, rtol=1e-10)
    np.testing.assert_allclose(stretched.field("shear_rate"), np.sqrt(2.5) * 2.0, rtol=1e-10)


def test_simple_shear_has_its_rate_in_both():
    sheared = state(lambda x: np.stack([3.0 * x[:, 1], 0 * x[:, 0]], axis=1))
    np.testing.assert_allclose(sheared.field("vorticity"), -3.0, rtol=1e-11)
    np.testing.assert_allclose(sheared.field("shear_rate"), 3.0, rtol=1e-11)
    np.testing.assert_allclose(
        sheared.field("viscosity", cells=True), 0.5 + 20 * (1 - np.exp(-40 * 3.0)) / 3.0, rtol=1e-11
    )


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_errors_inside_are_of_first_order(jitter):
    """Vortices of Taylor and Green; the mean square over particles away from the walls."""
    wave = lambda x: np.stack(  # noqa: E731
        [np.sin(np.pi * x[:, 0]) * np.cos(np.pi * x[:, 1]), -np.cos(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])], axis=1
    )
    errors = []
    for across in (12, 24, 48):
        flow = state(wave, across=across, jitter=jitter)
        x = flow.position
        exact = 2 * np.pi * np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])
        errors.append(np.sqrt(np.mean((flow.field("vorticity") - exact)[inner(x, 0.1)] ** 2)) / (2 * np.pi))
    assert errors[-1] < 0.01
    assert np.log2(errors[0] / errors[-1]) / 2 > 0.9


def test_viscosity_of_a_power_law_between_plates():
    """Of the exact profile: as accurate as the gradients in cells, whose error falls with the spacing."""
    drive, law = 3.0, PASTE.viscosity
    rate = lambda y: (drive * np.abs(y - 0.5) / law.consistency) ** (1 / law.index)  # noqa: E731

    def profile(x):
        s, power = np.abs(x[:, 1] - 0.5), 1 + 1 / law.index
        return np.stack([(drive / law.consistency) ** (1 / law.index) / power * (0.5**power - s**power), 0 * s], axis=1)

    errors = []
    for across in (16, 32, 64):
        flow = state(profile, across=across, fluids=(PASTE,), jitter=0.2)
        y = flow.position[flow.cells].mean(axis=1)[:, 1]
        away = np.abs(y - 0.5) > 0.1
        exact = law.consistency * rate(y) ** (law.index - 1)
        errors.append(np.sqrt(np.mean((flow.field("viscosity", cells=True) / exact - 1)[away] ** 2)))
    assert errors[-1] < 0.03
    assert np.log2(errors[0] / errors[-1]) / 2 > 0.9


def test_each_side_of_an_interface_has_its_own_viscosity():
    """A particle on the interface has the mean of the cells of its own fluid."""
    sides = state(lambda x: np.stack([x[:, 1], 0 * x[:, 0]], axis=1), fluids=(OIL, MUD))
    mud = 0.5 + 20 * (1 - np.exp(-40.0))
    np.testing.assert_allclose(
        sides.field("viscosity", cells=True), np.where(sides.cell_fluid == 0, 0.05, mud), rtol=1e-11
    )
    np.testing.assert_allclose(sides.field("viscosity"), np.where(sides.fluid == 0, 0.05, mud), rtol=1e-11)


def test_what_has_yielded():
    """A plug that moves as one has not; sheared mud has where its stress is above the yield stress, and oil always."""
    plug = state(
        lambda x: np.stack([np.maximum(x[:, 1] - 0.5, 0.0) * 5.0, 0 * x[:, 0]], axis=1), fluids=(MUD,), jitter=0.0
    )
    middle = plug.position[plug.cells].mean(axis=1)[:, 1]
    np.testing.assert_array_equal(plug.field("yielded", cells=True), middle > 0.5)
    still = state(lambda x: 0 * x, fluids=(OIL, MUD))
    np.testing.assert_array_equal(still.field("yielded", cells=True), still.cell_fluid == 0)
    sand = tp.Fluid("sand", 1600.0, tp.Granular(0.4, 0.7, diameter=1e-3, grain_density=2500.0, least_viscosity=0.0))
    for rate, expected in ((1e-4, 0.0), (5.0, 1.0)):
        heap = state(
            lambda x, g=rate: np.stack([g * x[:, 1], 0 * x[:, 0]], axis=1),
            fluids=(sand,),
            pressure=lambda x: 1e3 + 0 * x[:, 0],
        )
        np.testing.assert_array_equal(heap.field("yielded", cells=True), expected)


def test_fields_that_a_flow_does_not_have_are_refused():
    plain = dataclasses.replace(state(lambda x: 0 * x), laws=None)
    with pytest.raises(ValueError, match=r"'viscosity' is not in this flow; there are: .*shear_rate.*vorticity"):
        plain.field("viscosity")
    with pytest.raises(ValueError, match="'vorticity' is not in this flow in cells"):
        plain.field("vorticity", cells=True)
    with pytest.raises(ValueError, match=r"quantities has 'vortex'; expected some of .*vorticity"):
        tp.FieldOutput(quantities=["vortex"])
    tank = tp.tank((0.4, 0.4), 0.1).fill(OIL)
    with pytest.raises(ValueError, match="quantities has 'viscosity', which this flow has not: no fluid has a law of"):
        tp.Simulation(tp.Case(tank, [OIL], (0, 0)), fields=tp.FieldOutput(quantities=["viscosity"]))
    case = tp.Case(tp.tank((0.4, 0.4), 0.1).fill(PASTE), [PASTE], (0, 0))
    with pytest.raises(ValueError, match="'yielded', which this flow has not: no fluid has a yield stress"):
        tp.Simulation(case, fields=tp.FieldOutput(quantities=["viscosity", "yielded"]))


def sheared_mud(**options):
    """Mud between plates that a force drives, periodic along x."""
    tank = tp.tank((0.4, 0.3), 0.05, periodic="x", jitter=0.2, seed=2)
    tank.fill(MUD, velocity=lambda x: np.stack([4.0 * x[:, 1] * (0.3 - x[:, 1]), 0 * x[:, 0]], axis=1))
    return tp.Simulation(tp.Case(tank, [MUD], (30.0, 0.0)), time_step=1e-3, **options)


def test_files_scenes_and_pages_have_the_same(tmp_path):
    """Written to VTU and VTKHDF, computed when read, drawn, and live; across periodic sides, and after steering."""
    names = ["vorticity", "shear_rate", "viscosity", "yielded"]
    output = tp.FieldOutput(format="both", quantities=names)
    simulation = sheared_mud(out=tmp_path / "out", fields=output, output_interval=2e-3)
    simulation.run(2e-3, progress=False)
    simulation.steer(tp.Viscosity("mud", 30.0, number="yield_stress"))
    simulation.run(4e-3, progress=False)
    results = tp.read_results(tmp_path / "out")
    assert results[-1].laws[0, 1] == 30.0
    assert results[0].laws[0, 1] == 20.0
    live = Scenes(describe(simulation.case, None)).of(snapshot_of(simulation, 1.0))
    drawn = tp.render.Results(tmp_path / "out").scene(-1)
    for name in names:
        values = results[-1].field(name)
        raw = meshio.read(sorted((tmp_path / "out" / "fields").glob("*.vtu"))[-1])
        np.testing.assert_array_equal(raw.point_data[name], values)
        if name in ("viscosity", "yielded"):
            np.testing.assert_array_equal(np.concatenate(raw.cell_data[name]), results[-1].field(name, cells=True))
        assert live.fields[name].shape == live.position.shape[:1]
        np.testing.assert_allclose(
            np.sort(live.fields[name])[::7], np.sort(drawn.fields[name])[::7], rtol=1e-3, atol=1e-3
        )
    (tmp_path / "out" / "fields.pvd").unlink()  # the other file is read
    for name in names:
        np.testing.assert_array_equal(
            tp.read_results(tmp_path / "out")[-1].field(name), values if name == "yielded" else results[-1].field(name)
        )


def test_periodic_sides_have_whole_surroundings():
    """Between plates that slide, every particle has the shear of the whole, at the sides as inside."""
    simulation = sheared_mud()
    position = simulation.particles.position
    scene = Scenes(describe(simulation.case, None)).of(snapshot_of(simulation, 1.0))
    at_side = scene.position[:, 0] < 1e-9
    assert at_side.any() or len(position)
    exact = -4.0 * (0.3 - 2 * scene.position[:, 1])
    inside = np.abs(scene.position[:, 1] - 0.15) < 0.08
    assert np.abs(scene.fields["vorticity"] - exact)[inside].max() < 0.12


def test_nothing_is_computed_before_it_is_asked_for(tmp_path, monkeypatch):
    sheared_mud(out=tmp_path / "out", output_interval=1e-3).run(1e-3, progress=False)
    calls = []
    monkeypatch.setattr("tipfem.results.fields.catalogue.cell_gradients", lambda *given: calls.append(given) or 1 / 0)
    scene = tp.render.Results(tmp_path / "out").scene(-1)
    assert {"vorticity", "viscosity"} <= set(scene.fields)
    assert scene.fields["pressure"].size
    assert not calls


def test_convert_writes_them_afterwards(tmp_path):
    import h5py

    from tipfem.app.commands import main

    out = tmp_path / "out"
    sheared_mud(out=out, output_interval=1e-3).run(1e-3, progress=False)
    assert main(["convert", str(out), "--quantities", "vorticity", "viscosity"]) == 0
    with h5py.File(out / "fields.vtkhdf") as file:
        assert {"vorticity", "viscosity"} <= set(file["VTKHDF/PointData"])
        assert set(file["VTKHDF/CellData"]) == {"fluid", "viscosity"}
