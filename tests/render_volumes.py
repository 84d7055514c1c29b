"""Flows in 3-D made up for the tests of the pictures: a box of 1 x 0.6 x 0.8 m, of jittered particles."""

import json

import meshio
import numpy as np
from scipy.spatial import Delaunay
from tipfem.render.volume import Volume

from tipfem.results.fields.catalogue import Lazy

SIZE = np.array([1.0, 0.6, 0.8])
SPACING = 0.1
FLUIDS = [
    {"name": "water", "density": 998.2, "viscosity": 1.002e-3},
    {"name": "air", "density": 1.204, "viscosity": 1.82e-5},
]


def box(level=None, jitter=0.2):
    """Points (N, 3), positive cells (M, 4) and wall flags (N,) of the box, or of water in it up to a level [m]."""
    lines = [np.arange(round(length / SPACING) + 1) * SPACING for length in SIZE]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    ends = np.isclose(points, 0) | np.isclose(points, SIZE)
    wall = ends.any(axis=1)
    move = np.random.default_rng(3).uniform(-jitter, jitter, points.shape) * SPACING
    move[ends | (np.isclose(points, -1 if level is None else level) & [False, False, True])] = (
        0  # along what they are on
    )
    points += move
    inside = np.full(len(points), True) if level is None else points[:, 2] <= level + 1e-9
    chosen = np.flatnonzero(inside)
    cells = chosen[Delaunay(points[chosen]).simplices]
    sides = points[cells[:, 1:]] - points[cells[:, :1]]
    measure = np.linalg.det(sides)
    cells = np.where((measure < 0)[:, None], cells[:, [0, 1, 3, 2]], cells)[abs(measure) > 1e-9 * SPACING**3]
    return points, cells, wall


def volume(level=None, fluid=None, fields=None, **others):
    """The box as a `Volume` of water, or of water and air by the fluid (N,) of the particles; see `box`."""
    points, cells, wall = box(level)
    kept = np.isin(np.arange(len(points)), cells) | wall
    number = np.cumsum(kept) - 1
    points, cells, wall = points[kept], number[cells], wall[kept]
    made = {name: of(points) for name, of in (fields or {}).items()}
    names = ("water",) if fluid is None else ("water", "air")
    facts = dict(
        position=points,
        cells=cells,
        wall=wall,
        fluid=np.zeros(len(points), int) if fluid is None else fluid(points).astype(int),
        fluid_names=names,
        fluid_densities=(998.2, 1.204)[: len(names)],
        lower=np.zeros(3),
        upper=SIZE,
        spacing=SPACING,
        fields=Lazy({name: (lambda values=values: values) for name, values in made.items()}),
    )
    return Volume(**(facts | others))


def write_volumes(out, levels=(0.5, 0.4, 0.3), air=False):
    """A results folder of the box with water at these levels, a tenth of a second apart."""
    (out / "fields").mkdir(parents=True)
    fluids = FLUIDS[: 1 + air]
    case = {"format": 1, "title": "A box", "dimension": 3, "fluids": fluids, "lower": [0, 0, 0], "upper": list(SIZE)}
    case |= {
        "size": list(SIZE),
        "spacing": SPACING,
        "gravity": [0, 0, -9.81],
        "interface": "interpolated",
        "bodies": [],
    }
    (out / "case.json").write_text(json.dumps(case))
    sets = []
    for number, level in enumerate(levels):
        points, cells, wall = box(None if air else level)
        fluid = (points[:, 2] > level + 1e-9).astype(int) if air else np.zeros(len(points), int)
        data = {
            "velocity": np.stack([points[:, 2], 0 * points[:, 0], points[:, 0]], axis=1),
            "pressure": 9810 * (level - points[:, 2]),
            "fluid": fluid,
            "wall": wall.astype(int),
        }
        name = f"fields/step_{number:06d}.vtu"
        meshio.write(out / name, meshio.Mesh(points, [("tetra", cells)], point_data=data))
        sets.append(f'<DataSet timestep="{number / 10}" file="{name}"/>')
    (out / "fields.pvd").write_text(f'<VTKFile type="Collection"><Collection>{"".join(sets)}</Collection></VTKFile>')
    return out
