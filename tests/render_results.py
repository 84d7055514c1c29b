"""A results folder made up for the tests of the pictures: water below a sine curve in a square tank."""

import json

import meshio
import numpy as np
from scipy.spatial import Delaunay

SIDE = 0.5  # [m]
FLUIDS = [
    {"name": "water", "density": 998.2, "viscosity": 1.002e-3},
    {"name": "air", "density": 1.204, "viscosity": 1.82e-5},
]


def surface(x, time):
    """Height of the water [m] at x [m]."""
    return 0.25 + 0.06 * np.sin(2 * np.pi * (x / SIDE - time))


def tank(time, count=24):
    """Jittered points (N, 2), cells (M, 3), the fluid (N,), the wall flag (N,)."""
    spacing = SIDE / count
    random = np.random.default_rng(7)
    line = np.arange(count + 1) * spacing
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    wall = (np.isclose(points, 0) | np.isclose(points, SIDE)).any(axis=1)
    points[~wall] += random.uniform(-0.3, 0.3, (int((~wall).sum()), 2)) * spacing
    fluid = (points[:, 1] > surface(points[:, 0], time)).astype(int)
    return points, Delaunay(points).simplices, fluid, wall


def sharp_tank(time, count=24):
    """The same with a fluid for every cell (M,), and a bubble of air deep in the water.

    Returns points (N, 2), cells (M, 3), the fluid (N,) - water's on the interface -, the fluid (M,), and the wall
    flag (N,). The bubble is three cells around a common edge; none of its particles is within the air.
    """
    points, cells, _, wall = tank(time, count)
    centres = points[cells].mean(axis=1)
    cell_fluid = (centres[:, 1] > surface(centres[:, 0], time)).astype(int)
    seed = np.linalg.norm(centres - [0.3, 0.1], axis=1).argmin()
    shared = (cells[:, :, None] == cells[seed]).any(axis=1).sum(axis=1)
    cell_fluid[[seed, *np.flatnonzero(shared == 2)[:2]]] = 1
    fluid = np.ones(len(points), int)
    fluid[cells[cell_fluid == 0]] = 0
    return points, cells, fluid, cell_fluid, wall


def write_results(out, times=(0.0, 0.1, 0.2), count=24, sharp=False):
    """Write the folder and return it. sharp: every cell has its fluid."""
    (out / "fields").mkdir(parents=True)
    lines = []
    for step, time in enumerate(times):
        cell_data = {}
        if sharp:
            points, cells, fluid, cell_fluid, wall = sharp_tank(time, count)
            cell_data["fluid"] = [cell_fluid.astype(np.int32)]
        else:
            points, cells, fluid, wall = tank(time, count)
        depth = np.maximum(surface(points[:, 0], time) - points[:, 1], 0)
        data = {
            "velocity": np.stack([points[:, 1], -points[:, 0], 0 * points[:, 0]], axis=1),
            "pressure": 998.2 * 9.81 * depth,
            "fluid": fluid,
            "density": np.array([entry["density"] for entry in FLUIDS])[fluid],
            "wall": wall.astype(int),
        }
        points = np.column_stack([points, np.zeros(len(points))])
        mesh = meshio.Mesh(points, [("triangle", cells)], point_data=data, cell_data=cell_data)
        mesh.write(out / f"fields/step_{step:06d}.vtu")
        lines.append(f'<DataSet timestep="{time}" part="0" file="fields/step_{step:06d}.vtu"/>')
    (out / "fields.pvd").write_text(
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"><Collection>'
        + "".join(lines)
        + "</Collection></VTKFile>"
    )
    case = {
        "format": 1,
        "dimension": 2,
        "fluids": FLUIDS,
        "lower": [0, 0],
        "upper": [SIDE, SIDE],
        "spacing": SIDE / count,
        "gravity": [0, -9.81],
        "title": "Sloshing",
    }
    (out / "case.json").write_text(json.dumps(case))
    return out
