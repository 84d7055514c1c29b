"""Waves from a piston: their height, what a beach reflects, a float on them, and what passes a plate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import i1, k1

import tipfem as tp

Array = NDArray[np.float64]

WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
DEPTH, ROOF = 0.2, 0.36  # [m]
HEIGHT, PERIOD = 0.03, 1.0  # [m], [s]
GAUGES = (1.2, 1.45, 1.75, 2.05)  # [m]
# Deep water with a plate, in wave lengths: depth, draught and place of the plate, length of the tank and of its beach;
# places of gauges before and behind it. Height over length of the waves, which are small, for water whirls off the edge
# of a plate; periods in which the piston moves, and those after which records end: by linear theory for this very tank,
# what the piston sends back again, what is still to come, the floor and the local waves beside the plate then change
# what passes by 0.7 % and what comes back by 0.2 %.
DEEP, DRAUGHT, PLATE, CANAL, SHORE = 0.6, 0.8 / (2 * math.pi), 2.0, 3.7, 1.1
BESIDE = (1.6, 2.4)
STEEPNESS, GROUP, RECORD = 0.001, 4.0, 9.5


def tank(across: int, length: float, beach: float, *bodies: tp.Body, **wave: Any) -> tp.Case:
    """A tank with a piston at the left, a vent in the roof, and a beach at the right.

    Args:
        across: spacings in the depth of the water.
        length: of the tank [m].
        beach: its length, 0 for none [m].
        bodies: in it.
        wave: options of the wave maker.
    """
    filled = tp.tank((length, ROOF), DEPTH / across).fill(AIR).fill(WATER, box=((0, 0), (length, DEPTH)))
    for body in bodies:
        filled.add(body)
    for side in ("right", "top", "bottom"):
        filled.wall(side, slip=True)
    kind = tp.IrregularWaves if "seed" in wave else tp.WavePiston
    filled.wall("left", slip=True, motion=kind(**{"height": HEIGHT, "period": PERIOD, "depth": DEPTH, **wave}))
    vent = tp.Vent(wall="top", between=((0.5 * length, ROOF), (0.5 * length + 0.2, ROOF)))
    beaches = [tp.Beach(wall="right", length=beach, period=PERIOD)] if beach else []
    return tp.Case(filled, [WATER, AIR], (0, -9.81), openings=[vent], beaches=beaches)


def gauged(case: tp.Case, end: float, places: tuple[float, ...]) -> tuple[tp.Simulation, Array, Array]:
    """A run, its times (T,) [s], and the height of the surface above that at rest at places [m], (T, G) [m]."""
    probes = [tp.WaveGauge(name=f"at_{k}", x=x, fluid="water") for k, x in enumerate(places)]
    step = 0.1 * math.sqrt(case.particles.spacing / 9.81)
    simulation = tp.Simulation(case, time_step=step, probes=probes)
    simulation.run(end, progress=False)
    records = [simulation.probes[f"at_{k}"] for k in range(len(places))]
    surface = np.stack([np.asarray(record["depth"]) for record in records], axis=1)
    return simulation, np.asarray(records[0]["time"]), surface - DEPTH


def both_ways(time: Array, surface: Array, places: tuple[float, ...], period: float) -> tuple[float, float]:
    """Amplitudes of the first harmonics of waves to the right and to the left [m], by least squares over all gauges.

    The method is that of E. P. D. Mansard and E. R. Funke, Proc. 17th Int. Conf. Coastal Engineering, 1980.
    """
    omega, number = 2 * math.pi / period, tp.WavePiston(height=1e-4, period=period, depth=DEPTH).number
    basis = np.stack([np.cos(omega * time), np.sin(omega * time), np.ones_like(time)], axis=1)
    cosine, sine, _ = np.linalg.lstsq(basis, surface, rcond=None)[0]
    phase = np.exp(1j * number * np.array(places))
    # cos(omega t - k x) has the complex amplitude exp(i k x) of exp(-i omega t).
    found = np.linalg.lstsq(np.stack([phase, phase.conj()], axis=1), cosine + 1j * sine, rcond=None)[0]
    return float(abs(found[0])), float(abs(found[1]))


def regular(across: int, length: float = 4.0, beach: float = 1.8, end: float = 10.0) -> dict[str, float]:
    """Height of regular waves, and the part of it that comes back, over the last four periods."""
    simulation, time, surface = gauged(tank(across, length, beach), end, GAUGES)
    last = time > end - 4 * PERIOD
    heights = [
        np.ptp(surface[last & (time > end - n * PERIOD) & (time <= end - (n - 1) * PERIOD)], axis=0)
        for n in range(1, 5)
    ]
    onwards, back = both_ways(time[last], surface[last], GAUGES, PERIOD)
    rows = [row for row in simulation.history if row["time"] > end - 4 * PERIOD]
    return {
        "height": float(np.mean(heights)) / HEIGHT,
        "first harmonic": 2 * onwards / HEIGHT,
        "reflection": back / onwards,
        "beach over piston": sum(r.get("beach_dissipation", 0.0) for r in rows) / sum(r["external_work"] for r in rows),
        "steps": len(simulation.history),
        "refused": sum(row["refused_steps"] for row in simulation.history),
    }


def plate(across: int) -> dict[str, float]:
    """A group of waves of a length of 1 m and a fixed thin plate: the parts of its harmonic that pass and come back.

    Those of the same group without the plate are what comes. Theory is that of F. Ursell, Proc. Camb. Phil. Soc. 43,
    1947, in deep water.

    Args:
        across: spacings in the plate's draught.
    """
    kd = 2 * math.pi * DRAUGHT
    both = math.hypot(math.pi * i1(kd), k1(kd))
    (before, behind, refused), (comes, onwards, _) = (_harmonics(across, plate=there) for there in (True, False))
    passes, back = abs(behind / onwards), abs((before - comes) / comes)
    return {
        "transmission": passes,
        "reflection": back,
        "passes": float(k1(kd)) / both,
        "comes back": math.pi * float(i1(kd)) / both,
        "energy": passes**2 + back**2,
        "refused": refused,
    }


def _harmonics(across: int, *, plate: bool) -> tuple[complex, complex, int]:
    """Those of a group of waves before and behind the plate's place [m s], and how many steps were refused."""
    omega, spacing = math.sqrt(9.81 * 2 * math.pi * math.tanh(2 * math.pi * DEEP)), DRAUGHT / across
    period = 2 * math.pi / omega
    stroke = tp.WavePiston(height=STEEPNESS, period=period, depth=DEEP).stroke

    def moves(time: float) -> float:
        return 0.5 * stroke * math.sin(omega * time) * math.sin(math.pi * min(time / period / GROUP, 1.0)) ** 2

    filled = tp.tank((CANAL, DEEP + 0.1 + 4 * spacing), spacing).fill(WATER, box=((0, 0), (CANAL, DEEP)))
    if plate:
        low, high = (PLATE - 0.05 * spacing, DEEP - DRAUGHT), (PLATE + 0.05 * spacing, DEEP + 0.1)
        filled.add(tp.Body(tp.shapes.rectangle(low, high), name="plate", slip=True))
    for side in ("right", "top", "bottom"):
        filled.wall(side, slip=True)
    filled.wall("left", slip=True, motion=moves)
    beach = tp.Beach(wall="right", length=SHORE, period=period)
    case = tp.Case(filled, [WATER], (0, -9.81), beaches=[beach], free_surface=True)
    probes = [tp.WaveGauge(name=f"at_{x}", x=x, fluid="water") for x in BESIDE]
    simulation = tp.Simulation(case, probes=probes)
    simulation.run(RECORD * period, progress=False)
    records = [simulation.probes[probe.name] for probe in probes]
    time = np.asarray(records[0]["time"])
    before, behind = (
        complex(np.trapezoid((np.asarray(record["depth"]) - DEEP) * np.exp(1j * omega * time), time))
        for record in records
    )
    return before, behind, sum(row["refused_steps"] for row in simulation.history)
