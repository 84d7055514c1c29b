"""Contact angles: Young's force where interfaces end on walls, drops that come to their angle, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from case_texts import WATER_IN_AIR
from drop_particles import RADIUS

import tipfem as tp
from tipfem.case.surface_tension import wall_energies
from tipfem.casefile.describing import describe
from tipfem.casefile.loading import read_case
from tipfem.casefile.problems import CaseFileError
from tipfem.errors import Invalid
from tipfem.physics.surface_tension.edges import TensionEdges, young_forces


def half_disc(angle, spacings=5, names=("drop", "outside"), **wall):
    """A drop that begins as half a disc on a floor, with a contact angle there."""
    h, size, rng = RADIUS / spacings, (4 * RADIUS, 2.4 * RADIUS), np.random.default_rng(0)
    axes = [np.linspace(0, length, round(length / h) + 1) for length in size]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    held = [(lattice[:, k] == axes[k][0]) | (lattice[:, k] == axes[k][-1]) for k in range(2)]
    on_wall = held[0] | held[1]
    lattice += np.where(on_wall[:, None], 0.0, 0.12 * h * rng.uniform(-1, 1, lattice.shape))
    count = round(math.pi * spacings)
    phi = np.pi * np.arange(1, count) / count
    ring = np.array([size[0] / 2, 0]) + RADIUS * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    away = np.hypot(lattice[:, 0] - size[0] / 2, lattice[:, 1])
    keep = on_wall | (abs(away - RADIUS) > 0.62 * h)
    position = np.concatenate([lattice[keep], ring])
    on_wall = np.append(on_wall[keep], np.zeros(len(ring), dtype=bool))
    inside = np.hypot(position[:, 0] - size[0] / 2, position[:, 1]) < RADIUS * (1 + 1e-9)
    fluids = [tp.Fluid("outside", 0.1, 0.02), tp.Fluid("drop", 1.0, 0.2)]
    floor = tp.Wall("floor", between=((0, 0), (size[0], 0)), contact_angle={names: angle}, **wall)
    particles = tp.Particles(position, inside.astype(int), on_wall, spacing=h)
    return tp.Case(particles, fluids, (0, 0), walls=[floor], surface_tension={("drop", "outside"): 1.0})


def fitted(simulation):
    """Radius, and angle in degrees through the drop, of the circle through the interface."""
    edges = simulation.state.part(TensionEdges)
    x = simulation.particles.position[np.unique(np.concatenate([edges.one, edges.other]))]
    unknown = np.linalg.lstsq(np.column_stack([2 * x, np.ones(len(x))]), (x**2).sum(axis=1), rcond=None)[0]
    radius = math.sqrt(unknown[2] + unknown[0] ** 2 + unknown[1] ** 2)
    return radius, math.degrees(math.acos(-unknown[1] / radius))


def test_a_probe_measures_drops():
    simulation = tp.Simulation(half_disc(70, slip=True))
    drop, outside = (tp.DropProbe(name="p", fluid=name) for name in ("drop", "outside"))
    assert [name for name, _ in drop.columns(simulation.case)][:3] == ["number", "x", "y"]
    number, x, y, *velocity, circularity, angle, area = drop.sample(simulation)
    assert number == 1
    assert np.isnan(velocity).all()
    assert x == pytest.approx(2 * RADIUS)
    assert y == pytest.approx(4 * RADIUS / (3 * np.pi), rel=0.02)
    assert circularity == pytest.approx(np.sqrt(2) * np.pi / (np.pi + 2), rel=0.01)
    assert area == pytest.approx(simulation.volume("drop"))
    assert angle == pytest.approx(90, abs=1e-3)
    assert angle == pytest.approx(fitted(simulation)[1])
    assert outside.sample(simulation)[-2] == pytest.approx(180 - angle)
    for _ in range(20):
        simulation.step()
    before = simulation.state
    simulation.step()
    area = before.mesh.measure * (before.mesh.fluid == 1)
    start = area @ before.mesh.corners().mean(axis=1) / area.sum()
    _, _, _, vx, vy, _, angle, _ = drop.sample(simulation)
    moved = simulation.solved.mesh
    area = moved.measure * (moved.fluid == 1)
    end = area @ moved.corners().mean(axis=1) / area.sum()
    np.testing.assert_allclose([vx, vy], (end - start) / simulation.solved.dt, rtol=1e-9, atol=1e-12)
    assert vy < 0
    assert angle < 90
    with pytest.raises(Invalid, match="with interface = 'interpolated'"):
        drop.columns(tp.Case(simulation.case.particles, simulation.case.fluids, (0, 0), interface="interpolated"))


def test_a_film_on_a_floor_has_no_contact_angle():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.012, 0.006), spacing=0.0005).fill(air).fill(water, box=((0.002, 0), (0.01, 0.0015)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, 0), surface_tension={("water", "air"): 0.0728}))
    *_, angle, area = tp.DropProbe(name="p", fluid="water").sample(simulation)
    assert math.isnan(angle)
    assert area == pytest.approx(simulation.volume("water"))


def test_of_several_drops_the_largest_is_measured():
    water, air = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
    tank = tp.tank((0.012, 0.006), spacing=0.0005).fill(air)
    tank.fill(water, disc=((0.003, 0.003), 0.0015)).fill(water, disc=((0.008, 0.003), 0.002))
    tension = {("water", "air"): 0.0728}
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, 0), surface_tension=tension))
    simulation.step()
    drops, around = (
        dict(zip([name for name, _ in probe.columns(simulation.case)], probe.sample(simulation), strict=True))
        for probe in (tp.DropProbe(name="p", fluid=name) for name in ("water", "air"))
    )
    assert (drops["number"], around["number"]) == (2, 1)
    assert drops["area"] == pytest.approx(math.pi * 0.002**2, rel=0.02)
    assert (drops["x"], drops["y"]) == pytest.approx((0.008, 0.003), abs=1e-8)
    assert drops["circularity"] == pytest.approx(1, abs=0.01)
    assert abs(drops["velocity_x"]) < 1e-6
    assert around["area"] == pytest.approx(simulation.volume("air"))


@pytest.mark.slow
def test_a_drop_that_nothing_holds_hardly_drifts():
    """On a floor that slips; in the mirror image of its mesh it drifts as far to the other side."""
    moved = []
    for mirrored in (False, True):
        case = half_disc(50, 4, slip=True)
        particles = case.particles.copy()
        if mirrored:
            particles.position[:, 0] = 4 * RADIUS - particles.position[:, 0]
        again = tp.Case(particles, case.fluids, (0, 0), walls=case.walls, surface_tension={("drop", "outside"): 1.0})
        simulation = tp.Simulation(again)
        for _ in range(60):
            simulation.step()
        moved.append(tp.DropProbe(name="p", fluid="drop").sample(simulation)[1] - 2 * RADIUS)
    assert abs(moved[0]) < 1e-4 * RADIUS
    assert moved[1] == pytest.approx(-moved[0], abs=1e-5 * RADIUS)  # by the tolerance of Newton's method


@pytest.mark.parametrize("names", [("drop", "outside"), ("outside", "drop")])
def test_the_force_at_contacts_is_that_of_young(names):
    angle = 60 if names[0] == "drop" else 120
    case = half_disc(angle, slip=True, names=names)
    simulation = tp.Simulation(case)
    edges, wall = simulation.state.part(TensionEdges), simulation.particles.wall
    energies = [wall_energies(cosines, edges.table) for cosines in case.contact_cosines]
    force = -young_forces(edges, simulation.mesh, simulation.particles, simulation.boundary, energies)
    contact = np.flatnonzero(force.any(axis=1))
    ends = np.unique(np.concatenate([edges.one, edges.other]))
    np.testing.assert_array_equal(contact, ends[wall[ends]])
    assert len(contact) == 2
    outwards = np.sign(simulation.particles.position[contact, 0] - case.particles.position[:, 0].max() / 2)
    np.testing.assert_allclose(force[contact, 0], 0.5 * outwards, rtol=1e-12)
    np.testing.assert_allclose(force[contact, 1], 0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("wall", "within"), [({"slip": True}, 0.015), ({"law": "layer"}, 0.05), ({}, 0.05)])
def test_a_drop_comes_to_its_angle(wall, within):
    """On walls that hold the fluid the contact is slower; there it is still on its way."""
    case = half_disc(70, **wall)
    simulation = tp.Simulation(case)
    area, theta = simulation.volume("drop"), math.radians(70)
    radius = math.sqrt(area / (theta - math.sin(theta) * math.cos(theta)))
    for _ in range(220):
        simulation.step()
        row = simulation.history[-1]
        assert abs(row["energy_residual"]) < 1e-6
    found, angle = fitted(simulation)
    assert found == pytest.approx(radius, rel=within)
    assert angle == pytest.approx(70, abs=150 * within)
    assert simulation.volume("drop") == pytest.approx(area, rel=1e-12)


@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
@pytest.mark.parametrize(("angle", "way"), [(60, 1), (120, -1)])
def test_contacts_of_a_free_surface_slide_to_their_angle(interface, angle, way):
    drop = tp.Fluid("drop", 1.0, 0.2)
    tank = tp.tank((6.0, 3.0), 0.25).fill(drop, disc=((3.0, 0.0), 1.0))
    tank.wall("bottom", slip=True, contact_angle={"drop": angle})
    options = {"free_surface": True, "interface": interface, "surface_tension": {"drop": 1.0}}
    simulation = tp.Simulation(tp.Case(tank, [drop], (0, 0), **options))
    for _ in range(20):
        simulation.step()
    x = simulation.particles.position[simulation.mesh.used & (simulation.particles.position[:, 1] < 1e-9), 0]
    assert way * (x.max() - x.min() - 2) > 0.1
    # The wall's energy falls by cos(angle) times the way of both contacts.
    work = sum(row["external_work"] for row in simulation.history)
    assert work == pytest.approx(math.cos(math.radians(angle)) * (x.max() - x.min() - 2), rel=0.05)


def test_the_work_of_youngs_force_is_external():
    case = half_disc(70, slip=True)
    simulation = tp.Simulation(case)
    for _ in range(3):
        before, boundary = simulation.state, simulation.boundary
        simulation.step()
        edges = before.part(TensionEdges)
        energies = [wall_energies(cosines, edges.table) for cosines in case.contact_cosines]
        force = -young_forces(edges, before.mesh, before.particles, boundary, energies)
        work = float((force * simulation.solved.displacement).sum())
        assert simulation.history[-1]["external_work"] == pytest.approx(work, rel=1e-4)
        assert abs(work) > 1e-5


def test_energies_of_walls_follow_from_the_angles_and_contradictions_are_refused():
    sigma = np.array([[0, 3.0, 2.0], [3.0, 0, 4.0], [2.0, 4.0, 0]])
    energy = wall_energies({(0, 1): (0.5, 0), (2, 1): (-0.25, 0.1)}, sigma)
    assert energy[1] - energy[0] == pytest.approx(1.5)
    assert energy[1] - energy[2] == pytest.approx(-1.0)
    with pytest.raises(Invalid, match="contradict each other"):
        wall_energies({(0, 1): (0.5, 0), (1, 2): (0.25, 0), (0, 2): (0.9, 0)}, sigma, "floor")


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {("drop", "oil"): 60},
            "wall 'left': contact_angle: without surface tension a contact angle has no meaning, and the",
        ),
        ({5: 60}, "it must be two names of fluids"),
        ({("drop", "outside"): 190}, "it is 190; it must be from 0 to 180 degrees"),
        (
            {("drop", "outside"): (90, 60)},
            "it is .90, 60.; it must be two angles from 0 to 180 degrees, the one at which contacts recede",
        ),
        ({("drop", "outside"): (60, 90, 100)}, "a number of degrees, or two: those at which"),
        ({("drop", "outside"): 60, ("outside", "drop"): 100}, "given twice"),
        (60, "it must be a dict"),
    ],
)
def test_wrong_angles_are_refused(given, text):
    fluids = [tp.Fluid("outside", 0.1, 0.02), tp.Fluid("drop", 1.0, 0.2)]
    tank = tp.tank((1.0, 1.0), 0.1).fill(fluids[0]).fill(fluids[1], box=((0, 0), (1, 0.5)))
    tank.wall("left", contact_angle=given)
    with pytest.raises(Invalid, match=text):
        tp.Case(tank, fluids, (0, 0), surface_tension={("drop", "outside"): 1.0})


@pytest.mark.parametrize(
    ("wall", "given", "text"),
    [
        ({"velocity": (0.0, 0.1)}, {}, "one number of degrees on a wall that moves"),
        ({}, {"tank_motion": tp.Motion(lambda t: (0.1 * t**2, 0))}, "is given with two contact angles of a wall"),
    ],
)
def test_a_wall_that_moves_holds_no_contacts(wall, given, text):
    fluids = [tp.Fluid("outside", 0.1, 0.02), tp.Fluid("drop", 1.0, 0.2)]
    tank = tp.tank((1.0, 1.0), 0.1).fill(fluids[0]).fill(fluids[1], box=((0, 0), (1, 0.5)))
    tank.wall("left", contact_angle={("drop", "outside"): (60, 90)}, **wall)
    with pytest.raises(Invalid, match=text):
        tp.Case(tank, fluids, (0, 0), surface_tension={("drop", "outside"): 1.0}, **given)


def contacts(simulation):
    """The two ends of the interface of a drop on the floor, from the left [m]."""
    edges, position = simulation.state.part(TensionEdges), simulation.particles.position
    ends = np.unique(np.concatenate([edges.one, edges.other]))
    return np.sort(position[ends[simulation.particles.wall[ends]], 0])


@pytest.mark.slow
@pytest.mark.parametrize("wall", [{"slip": True}, {}])
def test_a_wall_holds_contacts_between_two_angles(wall):
    """A drop that begins with 90 degrees stays where it is between 60 and 120, and comes to 75 from above."""
    h = RADIUS / 5
    held, slid = (tp.Simulation(half_disc(angles, **wall)) for angles in ((60, 120), (40, 75)))
    start = contacts(held)
    for simulation in (held, slid):
        for _ in range(120 if simulation is slid else 40):
            simulation.step()
            assert abs(simulation.history[-1]["energy_residual"]) < 1e-6
    assert np.abs(contacts(held) - start).max() < 0.05 * h
    assert held.particles.max_speed < 1e-3
    assert abs(contacts(slid) - start).min() > 0.5 * h
    assert fitted(slid)[1] == pytest.approx(75, abs=2 if wall else 5)


@pytest.mark.slow
def test_a_drop_on_an_incline_is_held_up_to_the_force_of_its_angles():
    """It slides where gravity along the wall exceeds sigma (cos(receding) - cos(advancing)), and not below."""
    receding, advancing, tension = 70.0, 110.0, 1.0
    area = 0.5 * math.pi * RADIUS**2
    most = tension * (math.cos(math.radians(receding)) - math.cos(math.radians(advancing))) / (0.9 * area)
    moved = []
    for part in (0.7, 1.25):
        case = half_disc((receding, advancing), slip=True)
        case = tp.Case(
            case.particles, case.fluids, (part * most, 0), walls=case.walls, surface_tension={("drop", "outside"): 1.0}
        )
        simulation = tp.Simulation(case)
        start = contacts(simulation)
        for _ in range(100):
            simulation.step()
        moved.append(np.abs(contacts(simulation) - start).min() / (RADIUS / 5))
    assert moved[0] < 0.1
    assert moved[1] > 0.5


CASE = (
    WATER_IN_AIR
    + """\
box = [[0, 0], [0.4, 0.2]]
[surface_tension]
water.air = 0.0728
[walls.left]
slip = true
contact_angle.water.air = 60
[time]
end = 0.1
"""
)


def test_case_files_have_angles():
    case = read_case(CASE, "case.toml").case()
    wall = next(wall for wall in case.walls if wall.name == "left")
    assert wall.contact_angle == {("water", "air"): 60}
    again = read_case(describe(case, 0.1).text, "again.toml").case()
    assert again.contact_cosines == case.contact_cosines
    both = read_case(CASE.replace("= 60", "= [50, 80]"), "case.toml").case()
    ((mean, half),) = both.contact_cosines[[wall.name for wall in both.walls].index("left")].values()
    assert [mean + half, mean - half] == pytest.approx(np.cos(np.radians([50, 80])))
    assert read_case(describe(both, 0.1).text, "again.toml").case().contact_cosines == both.contact_cosines
    with pytest.raises(
        CaseFileError, match=r"contact_angle\.water\.air is 200 degrees; it must be a number from 0 to 180"
    ):
        read_case(CASE.replace("= 60", "= 200"), "case.toml")


@pytest.mark.slow
@pytest.mark.parametrize("free_surface", [False, True])
def test_the_angle_of_a_lens_is_that_between_its_interfaces(free_surface):
    water, oil, air = (tp.Fluid(name, density, 1e-3) for name, density in (("w", 1000.0), ("o", 900.0), ("a", 1.0)))
    half, angles = 0.3, np.radians([40.0, 60.0])
    x = half * np.linspace(-1, 1, 41)
    outline = []
    for angle, side in zip(angles, (1, -1), strict=True):
        radius = half / math.sin(angle)
        outline.append(np.stack([side * x[:-1], side * (np.sqrt(radius**2 - x**2) - radius * math.cos(angle))[:-1]], 1))
    lens = np.concatenate(outline[::-1]) + (0.5, 0.5)
    tank = tp.tank((1, 1), 0.02)
    tank = tank if free_surface else tank.fill(air)
    tank.fill(water, box=((0, 0), (1, 0.5))).fill(oil, shape=lens)
    tension = {"w": 1.0, "o": 0.7, ("w", "o"): 0.7} if free_surface else None
    tension = tension or {("w", "a"): 1.0, ("o", "a"): 0.7, ("w", "o"): 0.7}
    fluids = [water, oil] if free_surface else [water, oil, air]
    case = tp.Case(tank, fluids, (0, 0), free_surface=free_surface, surface_tension=tension)
    *_, angle, _area = tp.DropProbe(name="p", fluid="o").sample(tp.Simulation(case))
    assert angle == pytest.approx(np.degrees(angles.sum()), abs=0.1)
