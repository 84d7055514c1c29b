"""Likely mistakes of units or signs in a case that can be simulated; and the scales of its flow."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tipfem.case.case import NEAR, Case
from tipfem.case.rheology import Law
from tipfem.case.waves import WaveMaker
from tipfem.casefile.estimate import largest_speed
from tipfem.casefile.registry import LISTED
from tipfem.probes import Probe
from tipfem.probes.impulses import LoadProbe
from tipfem.typing import Array

KINEMATIC = (1e-7, 1e-1)  # viscosities of fluids that flow [m^2/s]: liquid metals have the least, honey 1e-2
DENSITY = (0.01, 20000.0)  # of gases at a low pressure, and of the heaviest metals [kg/m^3]
SIZE = (1e-4, 200.0)  # of tanks [m]: of the smallest drops, and of basins
EARTH = 9.81  # [m/s^2]


def hints(case: Case, end: float, interval: float | None, probes: Sequence[Probe] = ()) -> list[str]:
    """Lines on what may be a mistake in a run to ``end`` [s]; none of them keeps it from starting."""
    found = []
    for fluid in case.fluids:
        low, high = DENSITY
        if not low <= fluid.density <= high:
            found.append(f"{fluid.name} has {fluid.density:g} kg/m^3, not {low:g} to {high:g}; is the unit right?")
        if isinstance(fluid.viscosity, Law):
            continue
        kinematic = fluid.viscosity / fluid.density
        low, high = KINEMATIC
        if fluid.viscosity > 0 and not low <= kinematic <= high:
            found.append(
                f"{fluid.name} has {fluid.viscosity:g} Pa s, a kinematic viscosity of {kinematic:.2g} m^2/s, outside "
                f"of {low:g} to {high:g}; is it in Pa s? 1 cP is 1e-3 Pa s"
            )
    widest = float(case.extent.max())
    if not SIZE[0] <= widest <= SIZE[1]:
        found.append(f"the tank is {widest:g} m wide or high; are its lengths in m? A mesh in mm takes scale = 1e-3")
    found += case.doubts()
    found += case.slips()
    found += _waves(case)
    found += _dry(case)
    found += _gravity(case)
    found += [line for each in LISTED for line in each.hints(case)]
    found += _single_steps(case, probes)
    found += _upside_down(case)
    if interval is not None and interval > end:
        found.append(f"states are to be written every {interval:g} s, and the run is {end:g} s long")
    return found


def _single_steps(case: Case, probes: Sequence[Probe]) -> list[str]:
    """A line on probes that measure the pressures of single steps alone, where these steps are long."""
    names = [repr(probe.name) for probe in probes if isinstance(probe, LoadProbe) and not probe.averages]
    if not names or case.largest_move <= NEAR:
        return []
    steps = f"single steps, of up to {case.largest_move:g} spacings here"
    return [
        f"loads of {', '.join(names)} are those of {steps}: they jump from step to step after an impact; compare "
        "impulses (impulse = true) or means over a time (time_constant), or set numerics.largest_move to "
        f"{NEAR:g}"
    ]


def _waves(case: Case) -> list[str]:
    """Lines on waves whose depth is not that of the fluids."""
    found, heavy = [], int(np.argmax([fluid.density for fluid in case.fluids]))
    height = _heights(case)
    own = None if height is None else height[case.particles.fluid == heavy]
    for wall in case.walls:
        if not isinstance(maker := wall.motion, WaveMaker):
            continue
        depth = 0.0 if own is None else float(np.ptp(own))
        if abs(depth - maker.depth) > max(0.1 * maker.depth, 1.5 * case.particles.spacing):
            name = case.fluids[heavy].name
            found.append(f"waves of wall {wall.name!r} are for a depth of {maker.depth:g} m; {name} has {depth:.3g} m")
    return found


def _dry(case: Case) -> list[str]:
    """Lines on walls that move, or slide along themselves, where no fluid is at the start."""
    boundary = case.boundary
    parts = [(number, member) for number, _, member in boundary.members]
    parts += [(curve.wall, boundary.on_curve == k) for k, curve in enumerate(boundary.curves)]
    wet = {number for number, on in parts if (case.particles.fluid[boundary.index[on]] >= 0).any()}
    return [
        f"wall {wall.name!r} moves, and no fluid is at it at the start: it does nothing until one comes there"
        for number, wall in enumerate(boundary.walls)
        if number not in wet and (wall.motion is not None or wall.velocity is not None)
    ]


def _gravity(case: Case) -> list[str]:
    gravity = np.asarray(case.gravity, dtype=float)
    strength = float(np.linalg.norm(gravity))
    if strength == 0:
        return []
    found = []
    if gravity[-1] > 0.5 * strength:
        found.append(f"gravity is {gravity.tolist()} m/s^2, which is upwards; {-EARTH:g} is downwards")
    if abs(strength - EARTH) > 0.05:
        found.append(f"gravity is {strength:g} m/s^2; that of the Earth is {EARTH:g}")
    return found


def _upside_down(case: Case) -> list[str]:
    """A line on each pair of fluids of which the lighter one lies below, in the mean."""
    particles, height = case.particles, _heights(case)
    if height is None:
        return []
    there = [np.flatnonzero(particles.fluid == k) for k in range(len(case.fluids))]
    mean = [float(height[own].mean()) if len(own) else math.nan for own in there]  # a fluid may enter later
    return [
        f"{light.name} ({light.density:g} kg/m^3) is lighter than {heavy.name} ({heavy.density:g}) and lies below it"
        for i, light in enumerate(case.fluids)
        for j, heavy in enumerate(case.fluids)
        if light.density < heavy.density and mean[i] < mean[j] - case.particles.spacing
    ]


def _heights(case: Case) -> Array | None:
    """(N,) of the particles, against gravity [m]; None without gravity."""
    gravity = np.asarray(case.gravity, dtype=float)
    strength = float(np.linalg.norm(gravity))
    return None if strength == 0 else np.asarray(-case.particles.position @ (gravity / strength))


def scales(case: Case) -> str:
    """A line on the scales of the flow: its fastest speed, the Reynolds number, and what the spacing resolves.

    The speed is that of a free fall, sqrt(2 g H); length and viscosity are those of the heaviest fluid. A boundary
    layer has the thickness sqrt(nu H / U).
    """
    speed, particles = largest_speed(case), case.particles
    heaviest = max(range(len(case.fluids)), key=lambda k: case.fluids[k].density)
    fluid, own = case.fluids[heaviest], particles.position[particles.fluid == heaviest]
    if not speed > 0 or not len(own):
        step = case.default_step()
        if math.isinf(step):
            return "nothing moves at the start, and there is no gravity"
        return f"forces other than gravity set the fluids in motion, by default in steps of up to {step:.2g} s"
    height = _heights(case)
    values = own[:, -1] if height is None else height[particles.fluid == heaviest]
    length = float(np.ptp(values))
    kinematic = 0.0 if isinstance(fluid.viscosity, Law) else fluid.viscosity / fluid.density
    resolved = f"{length / particles.spacing:.0f} spacings over {length:.3g} m of {fluid.name}"
    if kinematic == 0 or length == 0:
        return f"up to {speed:.2g} m/s; {resolved}"
    layer = math.sqrt(kinematic * length / speed)
    fine = "resolves" if layer > 3 * particles.spacing else "does not resolve"
    return (
        f"up to {speed:.2g} m/s, Reynolds number up to {speed * length / kinematic:.1e}; {resolved}, which "
        f"{fine} boundary layers of {layer:.1g} m"
    )
