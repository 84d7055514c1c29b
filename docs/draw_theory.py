"""Draw the figures of docs/theory, one an idea: docs/images/theory_*.svg.

    python docs/draw_theory.py            all of them
    python docs/draw_theory.py cut_mesh   one

What they show is computed by the program's own functions: meshes, cuts, repairs, stencils and layers.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from scipy.linalg import eigh
from scipy.special import erfc
from write_generated import read_data

import tipfem as tp
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.geometry.period import Period
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.mesh.mesh import Mesh
from tipfem.physics.sliding_liquids.slip import find_slip
from tipfem.physics.surface_tension.edges import TensionEdges
from tipfem.physics.walls.layers import RESOLVED
from tipfem.remesh.triangles.fitted import repair
from tipfem.step.linear_system import GRID_SPACING
from tipfem.typing import Array

IMAGES = Path(__file__).resolve().parent / "images"
HEAVY, LIGHT, LINE, MARK = "#9ecae1", "#fdf0d5", "#555555", "#d55e00"
OIL = tp.Fluid("oil", density=900.0, viscosity=1e-3)
BRINE = tp.Fluid("brine", density=1100.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)


def two_layers(size: float = 0.08, jitter: float = 0.15, light: tp.Fluid = OIL) -> tp.Simulation:
    """A square tank of spacing 0.01 m with brine below and a lighter fluid above."""
    tank = tp.tank(size=(size, size), spacing=0.01, jitter=jitter, seed=3)
    tank.fill(light).fill(BRINE, box=((0, 0), (size, size / 2)))
    return tp.Simulation(tp.Case(tank, [BRINE, light], gravity=(0, -9.81)), time_step=1e-3)


def draw_cells(axes: Axes, position: Array, cells: Array, fluid: Array, alpha: float = 1.0) -> None:
    """Triangles, coloured by their fluids (0: the heavier)."""
    colours = np.array([HEAVY, LIGHT])[fluid]
    axes.add_collection(PolyCollection(position[cells], facecolor=colours, edgecolor=LINE, linewidth=0.6, alpha=alpha))


def frame(axes: Axes, title: str, x: tuple[float, float], y: tuple[float, float]) -> None:
    """A panel without axes."""
    axes.set(aspect="equal", xlim=x, ylim=y)
    axes.set_axis_off()
    axes.set_title(title, fontsize=10)


def cut_mesh() -> Figure:
    """The mesh, and the mesh cut along its interface: copies of particles, one for each side."""
    sim = two_layers()
    mesh, density = sim.mesh, sim.state.material.density
    cut = cut_along_interfaces(mesh, density)
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.6, 3.6), layout="constrained")
    on = np.unique(cut.owner[cut.copied])
    draw_cells(left, mesh.position, mesh.cells, mesh.fluid)
    left.plot(*mesh.position.T, "o", ms=3, color=LINE)
    left.plot(*mesh.position[on].T, "o", ms=6, color=MARK)
    # A shift of the lighter fluid shows the copies, which really stand where their particles are.
    shifted = cut.mesh.position + np.where(cut.fluid == 1, 0.012, 0.0)[:, None] * [0, 1]
    draw_cells(right, shifted, cut.mesh.cells, cut.mesh.fluid)
    right.plot(*shifted[: cut.particles].T, "o", ms=3, color=LINE)
    copy = np.arange(cut.particles, len(cut.owner))
    right.add_collection(
        LineCollection(np.stack([shifted[copy], shifted[cut.owner[copy]]], axis=1), color=MARK, linestyle=":")
    )
    right.plot(*shifted[cut.owner[copy]].T, "o", ms=6, color=MARK)
    right.plot(*shifted[copy].T, "o", ms=6, mfc="white", mec=MARK)
    frame(left, "one velocity, one pressure", (-0.002, 0.082), (0.016, 0.078))
    frame(right, "cut: a pressure for each side,\nvelocities tied", (-0.002, 0.082), (0.016, 0.078))
    return figure


def slip_stencil() -> Figure:
    """An interface particle of two liquids that slide, its tangent, and the weights of the particles beside."""
    sim = two_layers(jitter=0.2)
    particles = sim.particles
    position = particles.position
    moving = particles.shallow_copy(velocity=np.where(position[:, 1:] > 0.0401, 0.02, 0.0) * np.array([1.0, 0.0]))
    slip = find_slip(sim.mesh, moving, np.array([1100.0, 900.0]), np.array([0.0, -9.81]))
    assert slip is not None
    k = int(np.argmin(abs(position[slip.owner, 0] - 0.04)))
    i = slip.owner[k]
    beside = slip.beside[slip.offsets[k] : slip.offsets[k + 1]]
    weight = slip.weight[slip.offsets[k] : slip.offsets[k + 1]]
    figure, axes = plt.subplots(figsize=(5.6, 3.6), layout="constrained")
    draw_cells(axes, position, sim.mesh.cells, sim.mesh.fluid)
    light = np.asarray(sim.mesh.fluid) == 1
    around = sim.mesh.cells[light & (sim.mesh.cells == i).any(axis=1)]
    axes.add_collection(PolyCollection(position[around], facecolor="#f6d58b", edgecolor=LINE, linewidth=0.6))
    axes.add_collection(LineCollection([[position[i], position[j]] for j in beside], color=MARK, linestyle="--"))
    axes.plot(*position.T, "o", ms=3, color=LINE)
    axes.plot(*position[beside].T, "o", ms=8, color=MARK)
    for j, w in zip(beside, weight, strict=True):
        axes.annotate(
            f"$w$ = {w:.2f}",
            position[j],
            (0, 8),
            textcoords="offset points",
            ha="center",
            fontsize=9,
            bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1},
        )
    axes.plot(*position[i], "o", ms=8, color="black")
    axes.annotate("", position[i] + 0.009 * slip.tangent[k], position[i], arrowprops={"arrowstyle": "-|>", "lw": 2})
    axes.annotate("$t$", position[i] + 0.009 * slip.tangent[k], (-12, -14), textcoords="offset points", fontsize=12)
    axes.annotate("$i$", position[i], (-10, -12), textcoords="offset points", fontsize=12)
    frame(axes, "", (position[i, 0] - 0.024, position[i, 0] + 0.024), (0.022, 0.062))
    for height, text in ((0.0245, "heavier liquid"), (0.0595, "lighter liquid")):
        axes.text(position[i, 0] - 0.023, height, text, bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 2})
    return figure


def boundary_layer() -> Figure:
    """A thin layer at a wall: the profile, what a no-slip wall makes of it, and the law "layer"; and its course."""
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(8.4, 3.2), layout="constrained", width_ratios=[1, 1, 1.3]
    )
    y = np.linspace(0, 2, 400)
    thickness = 0.15  # displacement thickness over the spacing
    diffusion = thickness * np.sqrt(np.pi) / 2  # sqrt(nu t) / h of a layer of that age
    exact = 1 - erfc(y / (2 * diffusion))
    rows = np.array([0.0, 1.0, 2.0])
    for axes, slip, title in (
        (left, 0.0, "no-slip: the row stands still"),
        (middle, 1 - 2 * thickness, '"layer": the row slips'),
    ):
        axes.plot(exact, y, color=LINE, label="flow")
        lumped = np.array([slip, 1.0, 1.0])
        axes.plot(lumped, rows, "o-", color=MARK, label="particles")
        axes.fill_betweenx([0, 0.5], slip, 1.0, color=MARK, alpha=0.25, lw=0)
        axes.set(
            xlim=(-0.05, 1.15), ylim=(0, 2), xticks=[0, 0.5, 1], yticks=[0, 1, 2], xlabel="$u / U$", ylabel="$y / h$"
        )
        axes.set_title(title, fontsize=10)
    left.legend(fontsize=8, loc="upper left")
    left.annotate(r"$\delta = h/2$", (0.5, 0.25), ha="center", va="center", fontsize=9)
    middle.annotate(r"$\delta$ of the flow", (0.85, 0.25), (0.45, 0.8), ha="center", fontsize=9,
                    arrowprops={"arrowstyle": "-"})  # fmt: skip
    age = np.linspace(0, 0.3, 300)  # nu t / h^2
    delta = np.minimum(2 * np.sqrt(age / np.pi), 0.5)
    right.plot(age, delta, color="#0072b2", label=r"thickness $\delta / h$")
    length = np.maximum(0.5 * np.pi * delta * (1 - 2 * delta), RESOLVED)  # see `tipfem.physics.walls.layers`
    right.plot(age, length, color="#009e73", label="slip length of the row over $h$")
    right.plot(age, 1 - 2 * delta, color=MARK, label="slip of the row $V / U$")
    right.set(xlabel=r"$\nu t / h^2$", xlim=(0, 0.3), ylim=(0, 1.05))
    right.set_title("wall set off at once", fontsize=10)
    right.legend(fontsize=8)
    return figure


def periodic_images() -> Figure:
    """Cells of a periodic tank; particles near the ends have images at the distance of a width."""
    tank = tp.tank(size=(0.12, 0.05), spacing=0.01, periodic="x", jitter=0.25, seed=1).fill(OIL)
    mesh = tp.Simulation(tp.Case(tank, [OIL], gravity=(0, 0))).mesh
    width, position = 0.12, mesh.position
    corners = mesh.period.unwrapped(position[mesh.cells])
    across = (np.ptp(position[mesh.cells][:, :, 0], axis=1) > width / 2) & True
    figure, axes = plt.subplots(figsize=(7.6, 2.8), layout="constrained")
    for shift in (-width, 0.0, width):
        moved = corners + [shift, 0.0]
        axes.add_collection(PolyCollection(moved, facecolor="white", edgecolor="#bbbbbb", linewidth=0.5))
    axes.add_collection(PolyCollection(corners, facecolor=LIGHT, edgecolor=LINE, linewidth=0.6))
    axes.add_collection(PolyCollection(corners[across], facecolor=HEAVY, edgecolor=LINE, linewidth=0.6))
    for shift in (-width, width):
        axes.plot(position[:, 0] + shift, position[:, 1], "o", ms=4, mfc="white", mec="#888888")
    axes.plot(*position.T, "o", ms=4, color=LINE)
    chosen = int(np.argmin(np.hypot(position[:, 0] - 0.115, position[:, 1] - 0.025)))
    images = position[chosen] + np.array([[-width, 0.0], [0.0, 0.0]])
    axes.plot(*images[1], "o", ms=9, color=MARK)
    axes.plot(*images[0], "o", ms=9, mfc="white", mec=MARK, mew=2)
    axes.annotate("", images[0] + [0.003, 0], images[1] - [0.003, 0],
                  arrowprops={"arrowstyle": "<->", "color": MARK, "connectionstyle": "arc3,rad=0.25"})  # fmt: skip
    axes.text(0.055, 0.0455, "$W$", color=MARK, fontsize=13,
              bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1})  # fmt: skip
    for x in (0.0, width):
        axes.axvline(x, color="black", lw=1, ls="--")
    frame(axes, "", (-0.035, 0.155), (-0.003, 0.053))
    return figure


def stirred(position: Array, size: float, angle: float) -> Array:
    """Positions after a vortex of stream function sin^2 sin^2 has turned them by an angle at its centre."""

    def speed(x: Array) -> Array:
        s, c = np.sin(np.pi * x / size), np.cos(np.pi * x / size)
        return np.stack([s[:, 0] ** 2 * s[:, 1] * c[:, 1], -(s[:, 1] ** 2) * s[:, 0] * c[:, 0]], axis=1)

    steps = 50
    for _ in range(steps):
        half = position + 0.5 * angle / steps * size / np.pi * speed(position)
        position = position + angle / steps * size / np.pi * speed(half)
    return position


def repaired_mesh() -> Figure:
    """The mesh of two fluids that a vortex has deformed, and what the repair makes of it."""
    size = 0.11
    sim = two_layers(size=size, jitter=0.1)
    state = sim.state
    moved = stirred(state.particles.position, size, 0.8)
    particles = state.particles.shallow_copy(position=moved)
    wall = state.particles.wall
    done = repair(particles, state.mesh, np.array([1100.0, 900.0]), np.asarray(wall), tp.FittedRule())
    before, after = edges(state.mesh), edges(done.mesh)
    gone = np.array([moved[list(e)] for e in sorted(before - after)])
    new = np.array([done.mesh.position[list(e)] for e in sorted(after - before)])
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.8, 4.1), layout="constrained")
    draw_cells(left, moved, state.mesh.cells, state.mesh.fluid)
    left.add_collection(LineCollection(gone, color=MARK, linewidth=1.6))
    draw_cells(right, done.mesh.position, done.mesh.cells, done.mesh.fluid)
    right.add_collection(LineCollection(new, color="#0072b2", linewidth=1.6))
    for axes, position in ((left, moved), (right, done.mesh.position)):
        axes.plot(*position.T, "o", ms=2, color=LINE)
        axes.plot(*position[done.relocated].T, "o", ms=6, color=MARK if axes is left else "#0072b2")
    frame(left, "moved with the flow", (0, size), (0, size))
    frame(right, "repaired", (0, size), (0, size))
    return figure


def edges(mesh: Mesh) -> set[tuple[int, int]]:
    """The edges of a mesh as pairs of particles, the lower number first."""
    pairs = np.sort(np.concatenate([mesh.cells[:, [0, 1]], mesh.cells[:, [1, 2]], mesh.cells[:, [2, 0]]]), axis=1)
    return {(int(a), int(b)) for a, b in pairs}


def order_in_time() -> Figure:
    """Changes of a vortex's velocities when the step is halved, from docs/data, beside slopes of orders 1 and 2."""
    _, (_, *rows) = read_data("order_in_time")
    figure, axes = plt.subplots(figsize=(5.6, 3.6), layout="constrained")
    for kind, colour, label in (("default", MARK, "default tolerance"), ("exact", "#0072b2", "Newton's method exact")):
        for mesh in sorted({row[1] for row in rows}):
            found = np.array([row[2:] for row in rows if row[:2] == [kind, mesh]], dtype=float)
            axes.loglog(*found.T, "o-", color=colour, ms=4, lw=1, label=label if mesh == "1" else None)
    dt = np.array([0.5, 8.0])
    axes.loglog(dt, 4.5e-4 * (dt / 8) ** 2, "--", color=LINE, lw=1, label="order 2")
    axes.loglog(dt, 8e-5 * (dt / 8), ":", color=LINE, lw=1, label="order 1")
    axes.set(xlabel=r"$\Delta t$ [ms]", ylabel=r"change of velocities over $U$", ylim=(3e-6, 3e-3))
    axes.set_xticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"], minor=False)
    axes.minorticks_off()
    axes.legend(fontsize=8)
    return figure


def arrow(axes: Axes, start: Array, along: Array, colour: str = MARK, width: float = 1.6) -> None:
    """An arrow from a place along a vector."""
    style = {"arrowstyle": "-|>", "lw": width, "color": colour, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start + along, start, arrowprops=style)


def swept_volumes() -> Figure:
    """What each motion of a floating box sweeps: the volume that it takes from the cells at each particle."""
    tank = tp.tank(size=(0.16, 0.12), spacing=0.01, jitter=0.1, seed=2).fill(OIL)
    tank.add(tp.Body(tp.shapes.rectangle((0.05, 0.04), (0.11, 0.08)), density=500.0))
    case = tp.Case(tank, [OIL], gravity=(0, -9.81))
    sim = tp.Simulation(case, time_step=1e-3)
    mesh, position = sim.mesh, sim.mesh.position
    centre, half = np.array([0.08, 0.06]), np.array([0.03, 0.02])
    on = (np.abs(position - centre) <= half + 1e-6).all(axis=1)
    arm = position - centre
    corners = position[mesh.cells]
    # The change of a cell's area by a corner is half the side opposite, turned by a right angle.
    side = 0.5 * (np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1))
    by_corner = np.stack([-side[..., 1], side[..., 0]], axis=2)
    near = (np.abs(corners.mean(axis=1) - centre) < half + 0.022).all(axis=1)
    titles = "along $x$", "along $y$", "about the centre"
    figure, panels = plt.subplots(1, 3, figsize=(8.4, 2.6), layout="constrained")
    for k, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        move = np.tile(np.eye(2)[k], (len(position), 1)) if k < 2 else np.stack([-arm[:, 1], arm[:, 0]], axis=1) / 0.03
        area = np.einsum("cki,cki->c", by_corner, np.where(on[:, None], move, 0.0)[mesh.cells]) / 3
        swept = np.bincount(mesh.cells.ravel(), np.repeat(area, 3), len(position))
        axes.add_collection(PolyCollection(corners[near], facecolor="white", edgecolor="#bbbbbb", linewidth=0.5))
        box = centre + half * [[-1, -1], [1, -1], [1, 1], [-1, 1]]
        axes.fill(*box.T, color="#dddddd")
        seen = np.abs(swept) > 1e-9
        colours = np.where(swept[seen] > 0, "#0072b2", MARK)
        axes.scatter(*position[seen].T, s=60 * np.abs(swept[seen]) / np.abs(swept).max(), c=colours, zorder=3)
        if k < 2:
            arrow(axes, centre, 0.02 * np.eye(2)[k], "black", 2.0)
        else:
            axes.annotate("", centre + [0, 0.013], centre + [0.013, 0], arrowprops={
                "arrowstyle": "-|>", "lw": 2.0, "connectionstyle": "arc3,rad=0.5"})  # fmt: skip
        frame(axes, title, (0.028, 0.132), (0.016, 0.104))
    return figure


def energy_of_a_collapse() -> Figure:
    """A velocity that is linear in x, before and after a particle is removed: its field, and its lumped energy."""
    figure, panels = plt.subplots(1, 2, figsize=(7.6, 2.8), layout="constrained", sharey=True)
    fine = np.linspace(0, 4, 300)
    for axes, nodes, title in zip(
        panels, (np.array([0.0, 1, 2, 3, 4]), np.array([0.0, 1, 3, 4])), ("before", "after a collapse"), strict=True
    ):
        share = np.concatenate([[nodes[0]], 0.5 * (nodes[1:] + nodes[:-1]), [nodes[-1]]])
        lumped, field = 0.5 * float(np.diff(share) @ nodes**2), 4**3 / 6
        axes.plot(fine, fine**2 / 2, color=LINE, label=f"field: {field:.2f}")
        axes.fill_between(fine, fine**2 / 2, color=HEAVY, alpha=0.6, lw=0)
        axes.stairs(nodes**2 / 2, share, color=MARK, lw=1.6, label=f"lumped: {lumped:.2f}")
        axes.plot(nodes, 0 * nodes, "o", color="black", ms=6, clip_on=False, zorder=3)
        axes.set(xlim=(-0.1, 4.1), ylim=(0, 8.4), xticks=[], yticks=[], xlabel="$x$")
        axes.set_title(title, fontsize=10)
        axes.legend(title=r"energy ($v = x$, $\rho = 1$)", fontsize=9, title_fontsize=9, loc="upper left")
    panels[0].set_ylabel(r"$\frac{1}{2} \rho v^2$")
    return figure


def states_of_a_step() -> Figure:
    """An element at the start of a step, at the intermediate time and at the end, and what is evaluated where."""
    start = np.array([[0.0, 0.0], [1.0, 0.1], [0.35, 0.85]])
    moved = np.array([[2.9, 0.35], [2.75, 0.2], [3.1, 0.25]])
    figure, axes = plt.subplots(figsize=(7.6, 2.9), layout="constrained")
    for part, colour, name, text in (
        (0.0, "#dddddd", "$x_n$", "mesh, masses"),
        (0.52, LIGHT, r"$x_n + c_f u$", "viscous stress, inertia, weight;\ndirections of the pressure's forces"),
        (1.0, HEAVY, "$x_n + u$", "$p_{n+1}$, and $J_{n+1} = 1 + s$"),
    ):
        at = start + part * moved
        axes.add_collection(PolyCollection([at], facecolor=colour, edgecolor=LINE, linewidth=1.2, zorder=2))
        axes.plot(*at.T, "o", color="black", ms=5, zorder=3)
        axes.text(*at.mean(axis=0), name, ha="center", va="center", fontsize=10, zorder=4)
        axes.text(at[:, 0].mean(), at[:, 1].min() - 0.12, text, ha="center", va="top", fontsize=9)
    for corner, along in zip(start, moved, strict=True):
        axes.plot(*np.stack([corner, corner + along]).T, ":", color=MARK, lw=1.2, zorder=1)
    frame(axes, "", (-0.45, 4.75), (-0.55, 1.35))
    return figure


def background_grids() -> Figure:
    """The mesh of a step, the uniform grid over it, and the two coarser ones below."""
    sim = two_layers(jitter=0.2)
    figure, panels = plt.subplots(1, 4, figsize=(8.6, 2.4), layout="constrained")
    for level, axes in enumerate(panels):
        faint = 1.0 if level == 0 else 0.25
        draw_cells(axes, sim.mesh.position, sim.mesh.cells, sim.mesh.fluid, alpha=faint)
        if level:
            spacing = 0.01 * GRID_SPACING * 2 ** (level - 1)
            lines = np.arange(0.0, 0.08 + 1e-9, spacing)
            axes.hlines(lines, 0, 0.08, color="#0072b2", lw=0.8)
            axes.vlines(lines, 0, 0.08, color="#0072b2", lw=0.8)
            axes.plot(*(each.ravel() for each in np.meshgrid(lines, lines)), "o", color="#0072b2", ms=2 + level)
        title = "mesh: smoothing" if level == 0 else f"grid of {GRID_SPACING * 2 ** (level - 1):g} spacings"
        frame(axes, title, (-0.002, 0.082), (-0.002, 0.082))
    return figure


def checkerboard() -> Figure:
    """The weakest mode of the pressure without stabilisation, and the eigenvalues with and without."""
    tank = tp.tank(size=(0.1, 0.1), spacing=0.01, jitter=0.0).fill(OIL)
    sim = tp.Simulation(tp.Case(tank, [OIL], gravity=(0, -9.81)), time_step=1e-3)
    mesh, count = sim.mesh, len(sim.mesh.position)
    corners, area = mesh.position[mesh.cells], mesh.measure
    side = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    gradient = np.stack([-side[..., 1], side[..., 0]], axis=2) / (2 * area[:, None, None])
    divergence, laplacian = np.zeros((count, 2 * count)), np.zeros((count, count))
    for a in range(3):
        for b in range(3):
            pair = area * (gradient[:, a] * gradient[:, b]).sum(axis=1)
            np.add.at(laplacian, (mesh.cells[:, a], mesh.cells[:, b]), pair)
            for k in range(2):
                np.add.at(divergence, (mesh.cells[:, a], 2 * mesh.cells[:, b] + k), area / 3 * gradient[:, b, k])
    mass = np.bincount(mesh.cells.ravel(), np.repeat(area / 3, 3), count)
    free = np.repeat(np.where(sim.particles.wall, 0.0, 1.0 / mass), 2)
    scheme = GeneralizedAlpha(0.0, 1.0)
    schur = divergence @ (free[:, None] * divergence.T) / scheme.cm
    values, modes = eigh(schur, laplacian + 1e-12 * np.eye(count))
    inside = values[1:]  # without the constant pressure
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.8, 3.2), layout="constrained", width_ratios=[1, 1.25])
    # Of the weakest modes the one that the most particles take part in.
    weakest = modes[:, 1:21] - modes[:, 1:21].mean(axis=0)
    weak = weakest[:, int(np.argmin((weakest**4).sum(axis=0) / (weakest**2).sum(axis=0) ** 2))]
    left.tripcolor(*mesh.position.T, mesh.cells, weak, shading="gouraud", cmap="RdBu_r", rasterized=True)
    left.triplot(*mesh.position.T, mesh.cells, color=LINE, lw=0.4)
    frame(left, "a weak mode of the pressure", (0, 0.1), (0, 0.1))
    constant = tp.Numerics().stabilisation
    part = np.linspace(0, 1, len(inside))
    right.plot(part, np.sort(inside), color=MARK, label="without stabilisation")
    right.plot(part, np.sort(inside) + constant, color="#0072b2", label=f"$c = {constant:g}$")
    right.axhline(constant, color=LINE, lw=0.8, ls=":")
    right.set(xlim=(0, 1), ylim=(0, 0.85), xlabel="part of the modes", ylabel=r"eigenvalue over $\Delta t^2 / \rho$")
    right.legend(fontsize=9, loc="upper left")
    return figure


def tension_on_edges() -> Figure:
    """A drop on a wall: the pull of two edges on a particle, and what pulls a contact along the wall."""
    radius, angle, parts = 1.0, np.radians(65.0), 7
    turn = np.linspace(-angle, angle, parts + 1)
    position = radius * np.stack([np.sin(turn), np.cos(turn) - np.cos(angle)], axis=1)
    one, other = np.arange(parts), np.arange(1, parts + 1)
    table = np.zeros((3, 3))
    edges_of = TensionEdges(one, other, np.ones(parts), table, Period([0.0, 0.0]))
    pull = -edges_of.gradient(position)
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 2.9), layout="constrained", width_ratios=[1.35, 1])
    left.fill(*position.T, color=HEAVY)
    left.plot(*position.T, "o-", color=LINE, ms=5)
    for i in range(1, parts):
        arrow(left, position[i], 0.8 * pull[i])
    i = 3
    for j in (i - 1, i + 1):
        along = position[j] - position[i]
        arrow(left, position[i], 0.21 * along / np.hypot(*along), "#0072b2", 3.0)
    left.axhline(0, color="black", lw=2)
    frame(left, "each edge pulls with $\\sigma$; their sum is the force", (-1.05, 1.05), (-0.1, 0.72))
    contact = position[-1]
    right.fill(*position.T, color=HEAVY)
    right.plot(*position.T, "o-", color=LINE, ms=5)
    right.axhline(0, color="black", lw=2)
    along = position[-2] - contact
    arrow(right, contact, 0.28 * along / np.hypot(*along), "#0072b2", 3.0)
    arrow(right, contact, np.array([0.28 * np.cos(angle * (1 - 1 / parts)), 0.0]), width=3.0)
    right.text(contact[0] + 0.06, 0.035, r"$\sigma \cos\theta$, the wall's", color=MARK, fontsize=11)
    right.text(contact[0] + 0.03, 0.2, r"$\sigma$, the edge's", color="#0072b2", fontsize=11)
    right.annotate(r"$\theta$", contact + [-0.13, 0.035], fontsize=12)
    frame(right, "at rest: along the wall the pulls cancel", (0.35, 1.35), (-0.08, 0.5))
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "cut_mesh": cut_mesh,
    "slip_stencil": slip_stencil,
    "boundary_layer": boundary_layer,
    "periodic_images": periodic_images,
    "repaired_mesh": repaired_mesh,
    "order_in_time": order_in_time,
    "swept_volumes": swept_volumes,
    "energy_of_a_collapse": energy_of_a_collapse,
    "states_of_a_step": states_of_a_step,
    "background_grids": background_grids,
    "checkerboard": checkerboard,
    "tension_on_edges": tension_on_edges,
}


def main(names: list[str]) -> None:
    """Draw the figures of these names, or all."""
    mpl.use("agg")
    mpl.rcParams.update({"svg.hashsalt": "tipfem", "svg.fonttype": "path", "font.size": 10})
    tp.init(arch="cpu", threads=1)
    for name in names or list(FIGURES):
        figure = FIGURES[name]()
        figure.savefig(IMAGES / f"theory_{name}.svg", metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    main(sys.argv[1:])
