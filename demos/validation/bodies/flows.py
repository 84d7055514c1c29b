"""The cases of the study of bodies, and what is known about them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tipfem as tp

Array = NDArray[np.float64]

GRAVITY = 9.81  # [m/s^2]
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
THICK = tp.Fluid("water", density=1000.0, viscosity=0.5)  # which comes to rest sooner


def rectangle(centre: tuple[float, float], width: float, height: float, angle: float = 0.0) -> Array:
    """Corners (4, 2) of a rectangle that is turned by an angle [rad]."""
    corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (width, height)
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(corners @ np.array([[c, s], [-s, c]]) + centre)


# A box of 0.3 m x 0.2 m in a tank of 1 m x 1 m, half full.
BOX = (0.3, 0.2)
LEVEL = 0.5


def floating_box(
    across: int, density: float, lift: float, damping: float = 0.0, water: tp.Fluid = WATER, *, air: bool = True
) -> tp.Case:
    """A box that floats on water.

    Args:
        across: spacings in a side of the tank.
        density: of the box [kg/m^3].
        lift: of its centre above the level of the water around it at the start [m].
        damping: of a damper in y [N s/m per metre of depth].
        water: the fluid that it floats on.
        air: whether there is air above it; a free surface otherwise.
    """
    shape = rectangle((0.5, LEVEL + lift), *BOX)
    body = tp.Body(shape, law="layer", name="box", density=density, damping=(0.0, damping, 0.0))
    tank = tp.tank((1.0, 1.0), 1.0 / across).add(body)
    if air:
        tank.fill(AIR)
    tank.fill(water, box=((0, 0), (1, LEVEL)))
    fluids = [AIR, water] if air else [water]
    return tp.Case(tank, fluids, (0, -GRAVITY), free_surface=not air, title="A box floats")


def draught(simulation: tp.Simulation) -> float:
    """Depth of the lowest corner of the box below the surface of the water at the sides of the tank [m]."""
    states, x = simulation.state.parts["bodies"], simulation.particles.position
    assert states is not None
    mesh = simulation.mesh
    if mesh.surface.exists:
        surface = x[mesh.surface.front & ~simulation.particles.wall]
    else:
        assert mesh.components is not None
        surface = x[mesh.components.mark == 1]  # on the interface, off the walls
    far = np.abs(surface[:, 0] - 0.5) > 0.3
    y, angle = states.position[0, 1:]
    return float(surface[far, 1].mean() - rectangle((0.0, y), *BOX, angle)[:, 1].min())


# The barge of Jung, Chang & Jo: it only rolls, about its centre of mass at the level of the water.
BARGE = (0.3, 0.1)
BARGE_LENGTH = 0.9  # along the axis [m]
BARGE_INERTIA = 0.236  # of that length [kg m^2]
BARGE_ANGLE = math.radians(15)
BARGE_PERIOD = 0.93  # [s], measured
BARGE_DEPTH = 0.9


def rolling_barge(spacing: float, *, length: float = 2.4, height: float = 1.2) -> tp.Case:
    """A barge that is released at an angle, with particles that are coarser away from the surface."""
    body = tp.Body(
        rectangle((0.5 * length, BARGE_DEPTH), *BARGE, BARGE_ANGLE),
        name="barge",
        law="layer",
        mass=500.0 * BARGE[0] * BARGE[1],
        inertia=BARGE_INERTIA / BARGE_LENGTH,
        hinge=(0.5 * length, BARGE_DEPTH),
    )

    def near(x: Array) -> Array:
        off = np.maximum(np.abs(x - (0.5 * length, BARGE_DEPTH)) - (0.6 * BARGE[0], 1.2 * BARGE[1]), 0.0)
        return np.asarray(np.minimum(spacing + 0.2 * np.hypot(*off.T), 0.06))

    tank = tp.tank((length, height), spacing).fill(AIR).fill(WATER, box=((0, 0), (length, BARGE_DEPTH))).add(body)
    grading = tp.Grading(where=near)
    return tp.Case(tank, [AIR, WATER], (0, -GRAVITY), grading=grading, title="A barge rolls")


def faxen(ratio: float) -> float:
    """Drag over mu U of a cylinder per length midway between walls, by its diameter over their distance.

    H. Faxen, Forces exerted on a rigid cylinder moving between two parallel fixed planes, Proc. Royal Swedish Academy
    of Engineering Science 187 (1946) 1-13.
    """
    k = ratio
    series = -math.log(k) - 0.9157 + 1.7244 * k**2 - 1.7302 * k**4 + 2.4056 * k**6 - 4.5913 * k**8
    return 4 * math.pi / series


SYRUP = tp.Fluid("syrup", density=1000.0, viscosity=10.0)
CHANNEL = 0.1  # distance of the walls [m]
FALLING = 0.025  # diameter of the cylinder [m]
HEAVY = 1100.0  # its density [kg/m^3]


def falling_cylinder(across: int) -> tp.Case:
    """A cylinder that falls in a closed channel; ``across`` spacings in its diameter."""
    height = 4 * CHANNEL
    body = tp.Body(
        tp.shapes.circle((0.5 * CHANNEL, 0.6 * height), 0.5 * FALLING), law="layer", name="cylinder", density=HEAVY
    )
    tank = tp.tank((CHANNEL, height), FALLING / across).fill(SYRUP).add(body)
    return tp.Case(tank, [SYRUP], (0, -GRAVITY), title="A cylinder falls in a channel")


def terminal_speed(case: tp.Case) -> float:
    """Faxen's, for the net weight of the case's polygon [m/s]."""
    weight = (HEAVY - SYRUP.density) * case.bodies[0].area * GRAVITY
    return weight / (SYRUP.viscosity * faxen(FALLING / CHANNEL))


# A cylinder of diameter 1 that oscillates in a fluid at rest with the largest speed 1.
REYNOLDS, KEULEGAN_CARPENTER = 100.0, 5.0
DUTSCH = {"drag": 2.09, "inertia": 1.45}
STILL = tp.Fluid("still", density=1.0, viscosity=1.0 / REYNOLDS)


def oscillating_cylinder(across: int, size: tuple[float, float] = (12.0, 10.0)) -> tp.Case:
    """A cylinder with x = -KC / (2 pi) sin(2 pi t / KC); ``across`` spacings in its diameter."""
    amplitude, frequency = KEULEGAN_CARPENTER / (2 * math.pi), 2 * math.pi / KEULEGAN_CARPENTER

    def shift(time: float) -> tuple[float, float]:
        return -amplitude * math.sin(frequency * time), 0.0

    centre = np.array([0.5 * size[0], 0.5 * size[1]])
    body = tp.Body(tp.shapes.circle(centre, 0.5), law="layer", name="cylinder", motion=tp.Motion(translation=shift))

    def near(x: Array) -> Array:
        far = np.hypot(np.maximum(np.abs(x[:, 0] - centre[0]) - amplitude, 0.0), x[:, 1] - centre[1])
        return np.asarray(np.clip(1.0 + 2.0 * (far - 1.0), 1.0, 8.0) / across)

    tank = tp.tank(size, 1.0 / across).fill(STILL).add(body)
    grading = tp.Grading(where=near)
    return tp.Case(tank, [STILL], (0, 0), grading=grading, title="A cylinder oscillates in a fluid at rest")


def morison(time: Array, force: Array) -> dict[str, float]:
    """Coefficients of F = -rho D (c_D U |U| + c_M pi D U' / 2) / 2, by least squares; rho, D and the speed are one."""
    frequency = 2 * math.pi / KEULEGAN_CARPENTER
    speed, rate = -np.cos(frequency * time), frequency * np.sin(frequency * time)
    basis = np.stack([-0.5 * speed * np.abs(speed), -0.25 * math.pi * rate], axis=1)
    drag, inertia = np.linalg.lstsq(basis, force, rcond=None)[0]
    return {"drag": float(drag), "inertia": float(inertia)}


# A paddle that stirs oil and water.
OIL = tp.Fluid("oil", density=900.0, viscosity=0.5)
BRINE = tp.Fluid("brine", density=1000.0, viscosity=0.2)
TURN = 1.0  # [s]


def stirred(across: int) -> tp.Case:
    """A paddle turns in a tank of 1 m x 1 m, half full of oil."""

    def angle(time: float) -> float:
        return 2 * math.pi / TURN * (time - 0.2 * (1 - math.exp(-time / 0.2)))

    paddle = tp.Body(rectangle((0.5, 0.5), 0.6, 0.08), law="layer", name="paddle", motion=tp.Motion(angle=angle))
    tank = tp.tank((1.0, 1.0), 1.0 / across).fill(OIL).fill(BRINE, box=((0, 0), (1, 0.5))).add(paddle)
    return tp.Case(tank, [OIL, BRINE], (0, -GRAVITY), title="A paddle stirs oil and brine")


# A wedge that comes down on a free surface at constant speed, without gravity: the water's flow is similar at all times
# until it leaves the wedge's shoulders.
HALF, DEADRISE, ENTRY = 0.3, math.radians(30), 1.0  # [m], [rad], [m/s]
SLAMMING = 14.139  # force over rho V^3 t: R. Zhao, O. Faltinsen, J. Fluid Mech. 246 (1993) 593-612, table 1
OFFSET = 2.0  # spacings from the surface to the wedge at the start


def slamming_wedge(across: int) -> tp.Case:
    """A wedge above water in a tank eight times as wide and more than three times as deep as its half width.

    There are ``across`` spacings in the half width.
    """
    spacing, depth, width = HALF / across, 3.5 * HALF, 8 * HALF
    rise, low = HALF * math.tan(DEADRISE), np.array([0.5 * width, depth + OFFSET * spacing])
    shape = low + [(0, 0), (HALF, rise), (HALF, rise + 0.1), (-HALF, rise + 0.1), (-HALF, rise)]
    down = tp.Motion(translation=lambda time: np.array([0.0, -ENTRY * time]))
    tank = tp.tank((width, 5 * HALF), spacing).fill(WATER, box=((0, 0), (width, depth)))
    tank.add(tp.Body(shape, name="wedge", motion=down))
    return tp.Case(tank, [WATER], (0, 0), free_surface=True, title="A wedge comes down on water")


def advance(simulation: tp.Simulation, end: float, sample: Callable[[tp.Simulation], Any] | None = None) -> list[Any]:
    """Step until a time [s]; what ``sample`` gives after each step."""
    found = []
    while simulation.time < end * (1 - 1e-9):
        simulation.step(end)
        if sample is not None:
            found.append(sample(simulation))
    return found
