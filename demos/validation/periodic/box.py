"""Flows in a box without walls, periodic in both directions: decaying vortices, and a double shear layer.

The vortices are a closed form of the Navier-Stokes equations; the shear layers are compared with a pseudo-spectral
solution in NumPy.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.render.periodic import with_images

import tipfem as tp

Array = NDArray[np.float64]

WIDTH = 1.0
CARRIED = np.array([1.0, 0.5])  # the mean flow that carries the vortices through both pairs of sides [m/s]
VORTEX_VISCOSITY, VORTEX_END = 0.02, 0.5  # [Pa s], [s]
THICKNESS, LAYER_VISCOSITY, LAYER_END = 1 / 15, 2e-3, 1.2  # of the shear layers [m], [Pa s], [s]
MODES, STEPS = 128, 600  # of the pseudo-spectral solution, along each axis; its steps


def vortices(x: Array, time: float) -> tuple[Array, Array]:
    """Velocity (N, 2) [m/s] and pressure (N,) [Pa] of four vortices in a box at positions (N, 2), density 1 kg/m^3.

    u = U + e sin k X cos k Y, v = V - e cos k X sin k Y, p = e^2 (cos 2 k X + cos 2 k Y) / 4 with X = x - U t,
    Y = y - V t and e = exp(-2 nu k^2 t): G. I. Taylor and A. E. Green, Proc. R. Soc. A 158, 1937.
    """
    k = 2 * math.pi / WIDTH
    a, b = (k * (x - CARRIED * time)).T
    part = math.exp(-2 * VORTEX_VISCOSITY * k**2 * time)
    velocity = CARRIED + part * np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)], axis=1)
    return velocity, part**2 / 4 * (np.cos(2 * a) + np.cos(2 * b))


def layers(x: Array) -> Array:
    """Velocity (N, 2) [m/s] of two opposite shear layers with a small disturbance.

    J. B. Bell, P. Colella, H. M. Glaz, J. Comput. Phys. 85, 1989, with layers twice as thick.
    """
    y = x[:, 1] / WIDTH
    along = np.tanh(WIDTH / THICKNESS * np.where(y <= 0.5, y - 0.25, 0.75 - y))
    return np.stack([along, 0.05 * np.sin(2 * math.pi * x[:, 0] / WIDTH)], axis=1)


def spectral_layers() -> tuple[Array, float]:
    """Fourier coefficients (2, M, M / 2 + 1) of the layers' velocity at `LAYER_END`, and the kinetic energy [J/m].

    Vorticity by Fourier modes, dealiased by the two-thirds rule, and the classical Runge-Kutta method. Half of
    the modes change the velocity by 7e-6 m/s, twice the steps by 1e-11 m/s.
    """
    grid = np.arange(MODES) * WIDTH / MODES
    points = np.stack([a.ravel() for a in np.meshgrid(grid, grid, indexing="ij")], axis=1)
    start = np.fft.rfft2(layers(points).T.reshape(2, MODES, MODES))
    kx = 2j * math.pi / WIDTH * np.fft.fftfreq(MODES, 1 / MODES)[:, None]
    ky = 2j * math.pi / WIDTH * np.arange(MODES // 2 + 1)[None]
    square = -np.real(kx**2 + ky**2)
    square[0, 0] = 1.0
    kept = (np.abs(kx) < 2 * math.pi / WIDTH * MODES / 3) & (np.abs(ky) < 2 * math.pi / WIDTH * MODES / 3)

    def velocity(w: Any) -> Any:
        stream = w / square  # the mean velocity is zero
        return np.stack([ky * stream, -kx * stream])

    def rate(w: Any) -> Any:
        u, v = np.fft.irfft2(velocity(w), (MODES, MODES))
        along, across = np.fft.irfft2(kx * w, (MODES, MODES)), np.fft.irfft2(ky * w, (MODES, MODES))
        return kept * -np.fft.rfft2(u * along + v * across) - LAYER_VISCOSITY * square * w

    w, dt = (kx * start[1] - ky * start[0]) * kept, LAYER_END / STEPS
    for _ in range(STEPS):
        a = rate(w)
        b = rate(w + dt / 2 * a)
        c = rate(w + dt / 2 * b)
        w = w + dt / 6 * (a + 2 * b + 2 * c + rate(w + dt * c))
    found = velocity(w)
    u = np.fft.irfft2(found, (MODES, MODES))
    return found, float(0.5 * (u**2).sum(axis=0).mean() * WIDTH**2)


def at_points(coefficients: Any, x: Array) -> Array:
    """Values (N, 2) at positions (N, 2) [m] of the functions with Fourier coefficients (2, M, M / 2 + 1)."""
    k = 2j * math.pi / WIDTH
    along = np.exp(k * x[:, :1] * np.fft.fftfreq(MODES, 1 / MODES))
    across = np.exp(k * x[:, 1:] * np.arange(MODES // 2 + 1))
    twice = np.where(np.isin(np.arange(MODES // 2 + 1), [0, MODES // 2]), 1.0, 2.0)
    values = [((along @ c) * (across * twice)).sum(axis=1).real for c in coefficients]
    return np.stack(values, axis=1) / MODES**2


def _figures(simulation: tp.Simulation, exact: Array, scale: float) -> dict[str, Any]:
    """Error of the velocity by mass, relative to ``scale`` [m/s]; changes of momentum and volume; iterations."""
    mass, history = simulation.state.mass, simulation.history
    error = ((simulation.particles.velocity - exact) ** 2).sum(axis=1)
    momentum = np.array([[row["momentum_x"], row["momentum_y"]] for row in history])
    return {
        "error": math.sqrt((mass * error).sum() / mass.sum()) / scale,
        "momentum": float(np.ptp(momentum, axis=0).max() / (mass.sum() * scale)),
        "volume": abs(history[-1]["volume_fluid"] / WIDTH**2 - 1),
        "krylov_iterations": float(np.mean([row["krylov_iterations"] for row in history])),
    }


def _run(across: int, viscosity: float, velocity: Any, end: float, time_step: float) -> tp.Simulation:
    fluid = tp.Fluid("fluid", density=1.0, viscosity=viscosity)
    tank = tp.tank((WIDTH, WIDTH), WIDTH / across, periodic="xy").fill(fluid, velocity=velocity)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=time_step)
    simulation.run(end, progress=False)
    return simulation


def vorticity(simulation: tp.Simulation) -> tuple[Array, Array, Array]:
    """Nodes (K, 2) [m] and cells (M, 3) that cover the box, and the vorticity (M,) in them [1/s]."""
    mesh, particles = simulation.mesh, simulation.particles
    place, cells, node, _ = with_images(particles.position, mesh.cells, mesh.period.width, particles.spacing)
    x, v = place[cells], particles.velocity[node][cells]
    gradient = np.linalg.solve(x[:, 1:] - x[:, :1], v[:, 1:] - v[:, :1])  # d v_j / d x_i
    return place, cells, gradient[:, 0, 1] - gradient[:, 1, 0]


def vortex_box(across: int) -> dict[str, Any]:
    """Vortices that decay while a mean flow carries them through the sides: error of the velocity, rate of decay."""
    simulation = _run(across, VORTEX_VISCOSITY, lambda x: vortices(x, 0.0)[0], VORTEX_END, 0.16 / across)
    k, end = 2 * math.pi / WIDTH, simulation.time
    part = math.exp(-2 * VORTEX_VISCOSITY * k**2 * end)
    exact, _ = vortices(simulation.particles.position, end)
    energy = simulation.energy().kinetic - 0.5 * WIDTH**2 * float(CARRIED @ CARRIED)
    decay = -math.log(energy / (0.25 * WIDTH**2)) / (4 * VORTEX_VISCOSITY * k**2 * end)
    return {**_figures(simulation, exact, part), "decay": decay - 1}


def layer_box(across: int) -> dict[str, Any]:
    """Two shear layers that roll up: error of the velocity and of the energy against the pseudo-spectral solution."""
    simulation = _run(across, LAYER_VISCOSITY, layers, LAYER_END, 0.2 / across)
    found, energy = spectral_layers()
    exact = at_points(found, simulation.particles.position)
    return {
        **_figures(simulation, exact, 1.0),
        "energy": simulation.energy().kinetic / energy - 1,
        "vorticity": vorticity(simulation),
    }
