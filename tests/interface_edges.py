"""Edges that cross an interface, or that it runs along: how long they are, and for how long they stay so.

python tests/interface_edges.py inversion --interface interpolated
python tests/interface_edges.py dam-break --spacing 0.01
"""

from __future__ import annotations

from typing import Literal

import cyclopts
import numpy as np
from demo_runs import load

import tipfem as tp


def interface_edges(mesh, fluid) -> np.ndarray:
    """(K, 2) particles: of different fluids, or, where triangles have the fluids, between two such triangles."""
    if mesh.fluid is None:
        i, j = mesh.edges.T
        return mesh.edges[fluid[i] != fluid[j]]
    cell, corner = np.nonzero(mesh.neighbours > np.arange(len(mesh.cells))[:, None])
    other = mesh.neighbours[cell, corner]
    between = mesh.fluid[cell] != mesh.fluid[other]
    cell, corner = cell[between], corner[between]
    return np.sort(np.stack([mesh.cells[cell, (corner + 1) % 3], mesh.cells[cell, (corner + 2) % 3]], axis=1), axis=1)


class LongEdges:
    """Watches a simulation's interface edges.

    Attributes:
        limit: beyond it an edge is long [spacings].
        longest: length of the longest edge seen [spacings].
        stay: longest time that one edge was long without a break [s]; and in steps.
        part: of all edges seen in all steps, those that were long.
    """

    def __init__(self, limit: float = 2.0) -> None:
        self.limit, self.longest, self.stay, self.stay_steps = limit, 0.0, 0.0, 0
        self._since: dict[tuple[int, int], tuple[float, int]] = {}
        self._seen = self._long = 0

    @property
    def part(self) -> float:
        """Part of the edges that were long."""
        return self._long / max(self._seen, 1)

    def watch(self, simulation: tp.Simulation) -> None:
        """Take note of the present mesh."""
        mesh, particles = simulation.mesh, simulation.particles
        edges = interface_edges(mesh, particles.fluid)
        # Wall particles cannot be set anywhere else, nor can any be put between two of them.
        edges = edges[~particles.wall[edges].all(axis=1)]
        if not len(edges):
            return
        length = np.linalg.norm(mesh.position[edges[:, 0]] - mesh.position[edges[:, 1]], axis=1) / particles.spacing
        self.longest = max(self.longest, float(length.max()))
        self._seen += len(edges)
        long = [(int(a), int(b)) for a, b in edges[length > self.limit]]
        self._long += len(long)
        now = simulation.time, simulation.step_number
        self._since = {edge: self._since.get(edge, now) for edge in long}
        for time, step in self._since.values():
            self.stay = max(self.stay, now[0] - time)
            self.stay_steps = max(self.stay_steps, now[1] - step)


def watched(simulation: tp.Simulation, until: float, limit: float = 2.0) -> LongEdges:
    """Run a simulation to a time [s] and watch its edges."""
    edges = LongEdges(limit)
    edges.watch(simulation)
    while simulation.time < until:
        simulation.step(until)
        edges.watch(simulation)
    return edges


def main(
    flow: Literal["inversion", "dam-break"],
    /,
    *,
    interface: Literal["interpolated", "sharp"] = "interpolated",
    spacing: float | None = None,
    until: float | None = None,
) -> None:
    """Measure one of the demos."""
    tp.init(arch="cpu")
    settings = {} if spacing is None else {"spacing": spacing}
    name = {"inversion": "layer_inversion", "dam-break": "dam_break"}[flow]
    demo = load(name, interface=interface, **settings)
    simulation = tp.Simulation(demo.case, time_step=demo.options.time_step)
    edges = watched(simulation, until or demo.options.end_time)
    print(
        f"{flow}, {interface}: longest {edges.longest:.2f} h; {edges.part:.2%} above {edges.limit:g} h, "
        f"none for longer than {edges.stay:.3g} s, {edges.stay_steps} steps"
    )


if __name__ == "__main__":
    cyclopts.run(main)
