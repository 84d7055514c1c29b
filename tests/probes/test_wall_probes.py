"""All probes of walls on all kinds of walls: fluids at rest load each as their depth says, wherever the wall stands."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from operator import mul

import meshio
import numpy as np
import pytest

import tipfem as tp
from tipfem.probes.walls import side_names

G, RHO = 9.81, 1000.0
SYRUP = tp.Fluid("syrup", density=RHO, viscosity=10.0)
LEVEL = 0.5  # of the top of all tanks [m]


@dataclass
class Walled:
    """A tank full of one fluid to `LEVEL`.

    Attributes:
        tank: made anew.
        sides: of each wall by its name the ends, from one to the other with the fluid on the left [m]; of a closed one,
            twice a point.
        places: points on walls by their names [m].
        area: enclosed by a closed wall [m^2].
    """

    tank: tp.Tank
    sides: dict[str, tuple[tuple[float, float], tuple[float, float]]]
    places: dict[str, tuple[float, float]]
    area: dict[str, float] = field(default_factory=dict)


BOX = {
    "bottom": ((0, 0), (0.8, 0)),
    "right": ((0.8, 0), (0.8, LEVEL)),
    "top": ((0.8, LEVEL), (0, LEVEL)),
    "left": ((0, LEVEL), (0, 0)),
}
ON_BOX = {"bottom": (0.33, 0.0), "right": (0.8, 0.12), "left": (0.0, 0.27), "top": (0.4, LEVEL)}


def box():
    return Walled(tp.tank((0.8, LEVEL), 0.08).fill(SYRUP), BOX, ON_BOX)


def named_in_a_box():
    tank = tp.tank((0.8, LEVEL), 0.08).fill(SYRUP)
    for name in BOX:
        tank.wall(name, slip=True)
    return Walled(tank, BOX, ON_BOX)


def box_with_a_body():
    tank = tp.tank((0.8, LEVEL), 0.05).fill(SYRUP)
    tank.add(tp.Body(tp.shapes.rectangle((0.3, 0.15), (0.5, 0.3)), name="block"))
    return Walled(tank, BOX, ON_BOX)


POLYGON = [(0, 0.1), (0.3, 0.0), (0.8, 0.0), (0.8, LEVEL), (0, LEVEL)]
POLYGON_SIDES = {
    "slope": ((0, 0.1), (0.3, 0)),
    "floor": ((0.3, 0), (0.8, 0)),
    "east": ((0.8, 0), (0.8, LEVEL)),
    "lid": ((0.8, LEVEL), (0, LEVEL)),
    "west": ((0, LEVEL), (0, 0.1)),
}
ON_POLYGON = {"slope": (0.15, 0.05), "floor": (0.41, 0.0), "east": (0.8, 0.2)}


def polygon():
    shape = tp.shapes.polygon(POLYGON, names=list(POLYGON_SIDES))
    return Walled(tp.tank(shape=shape, spacing=0.06).fill(SYRUP), POLYGON_SIDES, ON_POLYGON)


def hole_and_body():
    hole = tp.shapes.circle((0.27, 0.25), 0.08, name="hole")
    shape = tp.shapes.polygon(POLYGON, names=list(POLYGON_SIDES), holes=[hole])
    tank = tp.tank(shape=shape, spacing=0.04).fill(SYRUP)
    tank.add(tp.Body(tp.shapes.circle((0.57, 0.25), 0.08), name="ball"))
    sides = {**POLYGON_SIDES, "hole": ((0.35, 0.25), (0.35, 0.25))}
    place = 0.27 + 0.08 * math.cos(1), 0.25 - 0.08 * math.sin(1)
    return Walled(tank, sides, {**ON_POLYGON, "hole": place}, {"hole": math.pi * 0.08**2})


def bowl(*, slip):
    def made():
        corners = [(-0.4, LEVEL), tp.shapes.arc((0, LEVEL)), (0.4, LEVEL)]
        shape = tp.shapes.polygon(corners, names=["bowl", "lid"])
        tank = tp.tank(shape=shape, spacing=0.06).fill(SYRUP).wall("bowl", slip=slip)
        sides = {"bowl": ((-0.4, LEVEL), (0.4, LEVEL)), "lid": ((0.4, LEVEL), (-0.4, LEVEL))}
        place = 0.4 * math.cos(-1), LEVEL + 0.4 * math.sin(-1)
        return Walled(tank, sides, {"bowl": place}, {"bowl": 0.5 * math.pi * 0.4**2})

    return made


def meshed(shape, spacing, names=None):
    """The mesh that a tank of a shape begins with, as a mesh file; walls may have other names there."""

    def made(folder):
        case = tp.Case(tp.tank(shape=shape, spacing=spacing).fill(SYRUP), [SYRUP], (0, -G))
        x, cells = case.particles.position, tp.Simulation(case).mesh.cells
        domain = case.domain
        pairs, edges = boundary_pairs(cells), []
        for pair in pairs:
            middle = x[pair].mean(axis=0)
            edges.append(int(domain.side[np.argmin(domain.distances(middle[None])[0][0])]))
        groups = {name: k + 1 for k, name in enumerate(domain.sides)}
        points = np.column_stack([x, np.zeros(len(x))])
        tags = [np.full(len(cells), 9), np.array(edges) + 1]
        mesh = meshio.Mesh(points, [("triangle", cells), ("line", pairs)], cell_data={"medit:ref": tags})
        mesh.write(folder / "tank.mesh")
        walls = {number: (names or {}).get(name, name) for name, number in groups.items()}
        return tp.read_mesh(folder / "tank.mesh", spacing, fluids={9: "syrup"}, walls=walls)

    return made


def boundary_pairs(cells):
    pairs = cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    known = {tuple(pair) for pair in pairs.tolist()}
    return np.array([pair for pair in pairs.tolist() if tuple(pair[::-1]) not in known])


def mesh_of_a_box(folder):
    names = {"bottom": "floor", "right": "outflow", "top": "ceiling", "left": "inflow"}
    tank = meshed(tp.shapes.rectangle((0, 0), (0.8, LEVEL)), 0.08, names)(folder)
    return Walled(tank, {names[k]: v for k, v in BOX.items()}, {names[k]: v for k, v in ON_BOX.items()})


def mesh_of_a_polygon(folder):
    tank = meshed(tp.shapes.polygon(POLYGON, names=list(POLYGON_SIDES)), 0.06)(folder)
    return Walled(tank, POLYGON_SIDES, ON_POLYGON)


def mesh_with_a_hole(folder):
    hole = tp.shapes.circle((0.27, 0.25), 0.08, name="hole")
    tank = meshed(tp.shapes.polygon(POLYGON, names=list(POLYGON_SIDES), holes=[hole]), 0.04)(folder)
    sides = {**POLYGON_SIDES, "hole": ((0.35, 0.25), (0.35, 0.25))}
    place = 0.27 + 0.08 * math.cos(1), 0.25 - 0.08 * math.sin(1)
    return Walled(tank, sides, {**ON_POLYGON, "hole": place}, {"hole": math.pi * 0.08**2})


def mesh_of_a_bowl(folder):
    known = bowl(slip=False)()
    known.tank = meshed(known.tank.shape, 0.06)(folder)
    return known


CASES = {
    "box": box,
    "walls given by name": named_in_a_box,
    "box with a body": box_with_a_body,
    "polygon": polygon,
    "hole and body": hole_and_body,
    "arc": bowl(slip=False),
    "arc, slip": bowl(slip=True),
    "mesh of a box": mesh_of_a_box,
    "mesh of a polygon": mesh_of_a_polygon,
    "mesh with a hole": mesh_with_a_hole,
    "mesh of a curve": mesh_of_a_bowl,
}


def hydrostatic(walled, name):
    """Force of the fluid at rest on a wall (2,) [N/m]: the integral of p n."""
    (x, y), (u, v) = walled.sides[name]
    below = RHO * G * (LEVEL - 0.5 * (y + v))  # its mean, of a straight wall
    force = below * np.array([v - y, x - u])
    return force + np.array([0.0, RHO * G * walled.area.get(name, 0.0) * (1 if name == "hole" else -1)])


@pytest.mark.parametrize("kind", CASES)
def test_probes_of_walls_give_the_loads_of_a_fluid_at_rest(kind, tmp_path):
    make = CASES[kind]
    walled = make(tmp_path) if kind.startswith("mesh") else make()
    case = tp.Case(walled.tank, [SYRUP], (0, -G))
    assert set(side_names(case)) == set(walled.sides)
    forces = [tp.WallForce(name=f"force_{name}", wall=name) for name in walled.sides]
    places = [tp.WallPressure(name=f"at_{name}", wall=name, at=at) for name, at in walled.places.items()]
    simulation = tp.Simulation(case, time_step=2e-3, probes=[*forces, *places])
    simulation.step()
    top = simulation.particles.pressure[simulation.particles.position[:, 1] > LEVEL - 1e-9].mean()
    scale = RHO * G * LEVEL
    assert list(simulation.probes) == [probe.name for probe in (*forces, *places)]
    found = {name: {key: values[-1] for key, values in probe.items()} for name, probe in simulation.probes.items()}
    for name, ((x, y), (u, v)) in walled.sides.items():
        # Pressures of a closed tank have no level of their own.
        exact = hydrostatic(walled, name) + top * np.array([v - y, x - u])
        force = [found[f"force_{name}"][f"pressure_force_{axis}"] for axis in "xy"]
        curved = name in walled.area
        np.testing.assert_allclose(force, exact, atol=(0.04 if curved else 1e-6) * scale * (0.1 if curved else 1))
    for name, (_, y) in walled.places.items():
        slack = 0.02 if name in walled.area else 1e-6
        assert found[f"at_{name}"]["pressure"] == pytest.approx(top + RHO * G * (LEVEL - y), abs=slack * scale)


@pytest.mark.parametrize("kind", CASES)
def test_walls_that_are_not_there_are_refused_with_those_that_are(kind, tmp_path):
    make = CASES[kind]
    walled = make(tmp_path) if kind.startswith("mesh") else make()
    case = tp.Case(walled.tank, [SYRUP], (0, -G))
    for probe in (tp.WallForce(name="f", wall="nowhere"), tp.WallPressure(name="p", wall="nowhere", at=(0, 0))):
        with pytest.raises(ValueError, match="there is no wall 'nowhere'") as error:
            probe.columns(case)
        for name in walled.sides:
            assert repr(name) in str(error.value)
    name, at = next(iter(walled.places.items()))
    with pytest.raises(ValueError, match=f"which is not on the wall '{name}'"):
        tp.WallPressure(name="p", wall=name, at=(at[0], at[1] + 0.05)).columns(case)
    for body in case.bodies:
        with pytest.raises(ValueError, match=f"'{body.name}' is a body"):
            tp.WallForce(name="f", wall=body.name).columns(case)


@pytest.mark.parametrize("kind", ["box", "polygon", "mesh"])
def test_probes_follow_walls_that_move(kind, tmp_path):
    """Two walls go the same way; each bears its hydrostatic load and the pressure at a place that moves with it."""
    names = {"left": "west", "right": "east", "bottom": "floor", "top": "lid"}
    if kind == "box":
        tank, names = tp.tank((0.8, LEVEL), 0.08).fill(SYRUP), {name: name for name in BOX}
    else:
        corners = [(0, 0), (0.8, 0), (0.8, LEVEL), (0, LEVEL)]
        shape = tp.shapes.polygon(corners, names=["floor", "east", "lid", "west"])
        tank = tp.tank(shape=shape, spacing=0.08).fill(SYRUP) if kind == "polygon" else meshed(shape, 0.08)(tmp_path)
    for name, speed in {"left": 0.5, "right": -0.5, "bottom": 0.0, "top": 0.0}.items():
        tank.wall(names[name], slip=True, **({"motion": partial(mul, speed)} if speed else {}))
    sides = {names["left"]: (0.0, 0.2), names["right"]: (0.8, 0.2), names["bottom"]: (0.4, 0.0)}
    forces = [tp.WallForce(name=f"force_{name}", wall=name) for name in sides]
    places = [tp.WallPressure(name=f"at_{name}", wall=name, at=at) for name, at in sides.items()]
    simulation = tp.Simulation(tp.Case(tank, [SYRUP], (0, -G)), time_step=4e-3, probes=[*forces, *places])
    for _ in range(30):
        simulation.step()
    assert simulation.particles.position[:, 0].min() == pytest.approx(0.5 * simulation.time, abs=1e-9)
    load = {name: {key: values[-1] for key, values in probe.items()} for name, probe in simulation.probes.items()}
    west, east, floor = names["left"], names["right"], names["bottom"]
    # All goes as a rigid body, at a speed that is constant after the first step.
    step = load[f"force_{east}"]["pressure_force_x"] + load[f"force_{west}"]["pressure_force_x"]
    assert abs(step) < 0.02 * RHO * G * LEVEL**2 / 2
    top = load[f"at_{floor}"]["pressure"] - RHO * G * LEVEL
    for name in (west, east):
        assert load[f"at_{name}"]["pressure"] == pytest.approx(
            top + RHO * G * (LEVEL - 0.2), abs=0.02 * RHO * G * LEVEL
        )
        exact = RHO * G * LEVEL**2 / 2 + top * LEVEL
        assert abs(load[f"force_{name}"]["pressure_force_x"]) == pytest.approx(exact, abs=0.02 * RHO * G * LEVEL**2)
    assert load[f"force_{floor}"]["pressure_force_y"] == pytest.approx(-0.8 * (top + RHO * G * LEVEL), rel=0.02)


@pytest.mark.parametrize(
    "corners", [[(0, 0), (0.8, 0), (0.8, LEVEL), (0, LEVEL)], [(0, 0), (0.8, 0.1), (0.8, LEVEL), (0, LEVEL)]]
)
def test_openings_are_on_the_named_walls_of_a_mesh(corners, tmp_path):
    shape = tp.shapes.polygon(corners, names=["floor", "outflow", "ceiling", "inflow"])
    made, passed = meshed(shape, 0.08), []
    for tank in (made(tmp_path), tp.tank(shape=shape, spacing=0.08).fill(SYRUP)):
        inlet = tp.Inlet(wall="inflow", fluid=SYRUP, velocity=0.1, name="in")
        case = tp.Case(tank, [SYRUP], (0, 0), openings=[inlet, tp.Outlet(wall="outflow", name="out")])
        simulation = tp.Simulation(case, time_step=0.01)
        for _ in range(3):
            simulation.step()
        passed.append([sum(row[f"through_{name}_syrup"] for row in simulation.history) for name in ("in", "out")])
    np.testing.assert_allclose(passed[0], passed[1], rtol=1e-9)
    np.testing.assert_allclose(passed[0], 0.1 * LEVEL * simulation.time * np.array([1, -1]), rtol=0.02)
    with pytest.raises(ValueError, match="wall is 'left'; the tank has floor, outflow, ceiling, inflow"):
        tp.Case(made(tmp_path), [SYRUP], (0, 0), openings=[tp.Outlet(wall="left")])
