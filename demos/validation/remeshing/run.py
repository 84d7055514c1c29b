"""Remeshing by cavities in rounds, alone: bodies carried by flows in closed form, in 2-D and 3-D.

A disc in the single vortex (W. J. Rider and D. B. Kothe, J. Comput. Phys. 141, 1998); a ball, of one fluid and of two,
in the deformation of R. J. LeVeque (SIAM J. Numer. Anal. 33, 1996); a slotted sphere that turns once (after
S. T. Zalesak, J. Comput. Phys. 31, 1979); two drops that meet and become one; a drop that is stretched to a thread,
which breaks. Particles move by Runge and Kutta's fourth order, half a spacing a step at most, and the mesh is repaired
in place after each. No step may be refused because a cell would be inverted.

summary.json   figures of all runs
angles.png     smallest angles over time

python -m tipfem demo validation/remeshing --flow deformation --across 20
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.options import Arch, Count, Several
from tipfem.demos.validation.remeshing.flows import FLOWS, Array, Flow, start

import tipfem as tp
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.cavity.cavities import Cavities

# Resolution: spacings along an edge, and how far a particle moves in a step, in spacings.
ACROSS = {"vortex": 100}
DEFAULT_ACROSS = 20
SHRUNK = 0.1  # of its measure before: a cell that would be smaller refuses a step
MOST_REFUSED = 50  # steps of a run
OUTPUTS = 16  # a run, at which angles are measured

# Check: the largest error of a volume, and of the shape [h]; angles are in `flows.FLOWS`.
LARGEST_VOLUME, LARGEST_SHAPE = 1e-12, 1.0


def smallest_angle(mesh: Mesh) -> float:
    """Of all triangles, or the smallest dihedral angle of all tetrahedra [degrees]."""
    corner = mesh.position[mesh.cells]
    side = corner[:, 1:] - corner[:, :1]
    rows = np.linalg.inv(side).transpose(0, 2, 1)  # gradients of the shape functions, normal to the faces
    normal = np.concatenate([-rows.sum(axis=1, keepdims=True), rows], axis=1)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    one, other = np.triu_indices(mesh.dimension + 1, 1)
    cosine = -(normal[:, one] * normal[:, other]).sum(axis=2)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)).min()))


def after(flow: Flow, x: Array, t: float, dt: float) -> Array:
    """Where particles are after a step, by Runge and Kutta's fourth order."""
    k1 = flow.velocity(x, t)
    k2 = flow.velocity(x + dt / 2 * k1, t + dt / 2)
    k3 = flow.velocity(x + dt / 2 * k2, t + dt / 2)
    return np.asarray(x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + flow.velocity(x + dt * k3, t + dt)))


def shape_error(flow: Flow, mesh: Mesh, spacing: float) -> float:
    """Mean distance of the body's surface from that of the start, at the middles of its faces [h]."""
    fluid = np.asarray(mesh.fluid)
    cell, i = np.nonzero((mesh.neighbours >= 0) & (fluid[:, None] > 0))
    outer = fluid[mesh.neighbours[cell, i]] == 0
    cell, i = cell[outer], i[outer]
    face = mesh.cells[cell[:, None], (i[:, None] + np.arange(1, mesh.dimension + 1)) % (mesh.dimension + 1)]
    corner = mesh.position[face]
    side = corner[:, 1:] - corner[:, :1]
    size = np.sqrt(np.linalg.det(side @ side.transpose(0, 2, 1)))
    off = np.abs(flow.distance(corner.mean(axis=1)))
    return float((off * size).sum() / size.sum() / spacing)


def pieces(mesh: Mesh) -> int:
    """How many connected parts the body's fluids have."""
    fluid = np.asarray(mesh.fluid)
    cell, i = np.nonzero(mesh.neighbours >= 0)
    same = fluid[cell] == fluid[mesh.neighbours[cell, i]]
    ends, count = (cell[same], mesh.neighbours[cell, i][same]), len(fluid)
    part = connected_components(sparse.csr_matrix((np.ones(same.sum()), ends), shape=(count, count)))[1]
    return len(np.unique(part[fluid > 0]))


def carry(flow: Flow, across: int, end: float | None = None) -> dict[str, Any]:
    """Figures of a run to an end, by default that of the flow, with ``across`` spacings along an edge."""
    spacing = 1 / across
    mesh, wall = start(flow, spacing)
    cavities = Cavities(mesh, wall, spacing)
    labels = 3 if flow.half else 2
    wanted = cavities.volumes(cavities.label, labels)
    cavities.repair(flow.film)
    end, t, steps, refused, began = end or flow.end, 0.0, 0, 0, time.process_time()
    angles: list[tuple[float, float]] = []
    while t < end * (1 - 1e-12):
        dt = min(flow.step * spacing / max(np.linalg.norm(flow.velocity(cavities.x, t), axis=1).max(), 0.25), end - t)
        cells = cavities.cells[cavities.label >= 0]
        before, moved = simplex_measure(cavities.x, cells), after(flow, cavities.x, t, dt)
        while (simplex_measure(moved, cells) < SHRUNK * before).any():
            dt, refused = dt / 2, refused + 1
            if refused > MOST_REFUSED:
                raise RuntimeError(f"at t = {t:.3f} a cell would be inverted by a step of {dt:.1e}")
            moved = after(flow, cavities.x, t, dt)
        cavities.x = moved
        cavities.repair(flow.film)
        cavities.restore_volumes(wanted, cavities.label)
        t, steps = t + dt, steps + 1
        if t >= end * (len(angles) + 1) / OUTPUTS * (1 - 1e-12):
            angles.append((t, smallest_angle(cavities.mesh())))
    last = cavities.mesh()
    seconds = time.process_time() - began
    return {
        "particles": int((cavities.marks > 0).sum()),
        "cells": len(last.cells),
        "steps": steps,
        "refused": refused,
        "rounds": cavities.rounds / steps,
        "angles": angles,
        "angle": min(angle for _, angle in angles),
        "volume": float(np.abs(cavities.volumes(cavities.label, labels) / wanted - 1)[1:].max()),
        "filled": abs(float(last.measure.sum()) - 1),
        "pieces": pieces(last),
        "shape": shape_error(flow, last, spacing) if flow.returns and end == flow.end else math.nan,
        "microseconds": 1e6 * seconds / steps / len(last.cells),
    }


def check(name: str, found: dict[str, Any]) -> list[str]:
    """What a run misses of what is expected; an empty list when all is well."""
    flow, missed = FLOWS[name], []
    if found["refused"]:
        missed.append(f"{name}: {found['refused']} steps were refused")
    if not found["angle"] > flow.angle:
        missed.append(f"{name}: an angle of {found['angle']:.2f} degrees")
    for volume in ("volume", "filled"):
        if not found[volume] < LARGEST_VOLUME:
            missed.append(f"{name}: {volume} has an error of {found[volume]:.1e}")
    if not flow.pieces[0] <= found["pieces"] <= flow.pieces[1]:
        missed.append(f"{name}: {found['pieces']} pieces")
    if found["shape"] > LARGEST_SHAPE:
        missed.append(f"{name}: the shape is {found['shape']:.2f} spacings off")
    return missed


def plot(path: Path, summary: dict[str, dict[str, Any]]) -> None:
    """Draw the smallest angles over time.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(7, 4)
    axes = figure.add_subplot()
    for colour, (name, found) in zip(COLOURS, summary.items(), strict=False):
        t, angle = np.array(found["angles"]).T
        axes.plot(t / t[-1], angle, "o-", color=colour, markersize=4, label=f"{name}, {found['particles']} particles")
    axes.set(xlabel="t / end", ylabel="smallest angle [degrees]", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)
    save(figure, path)


Name = Literal["vortex", "deformation", "halves", "zalesak", "meeting", "thread"]


def main(
    *,
    flow: Several[Name] | None = None,
    across: Count | None = None,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/remeshing"),
) -> int:
    """Carry bodies by flows, and repair the mesh on the way.

    Args:
        flow: which; by default all.
        across: spacings along an edge; by default 100 of the vortex, and 20 in space.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    summary: dict[str, dict[str, Any]] = {}
    missed: list[str] = []
    for name in flow or FLOWS:
        found = summary[name] = carry(FLOWS[name], across or ACROSS.get(name, DEFAULT_ACROSS))
        missed += check(name, found)
        print(
            f"{name}: {found['particles']} particles, {found['steps']} steps, {found['refused']} refused, "
            f"{found['rounds']:.0f} rounds a step, smallest angle {found['angle']:.1f} degrees, error of the volume "
            f"{found['volume']:.0e}, of the shape {found['shape']:.2f} h, {found['pieces']} pieces, "
            f"{found['microseconds']:.1f} us a cell and step",
            flush=True,
        )
    plot(out / "angles.png", summary)
    return harness.report(out, {"runs": summary}, missed)


if __name__ == "__main__":
    harness.command(__name__)
