"""Layers of fluids in a closed tank against hydrostatics: layers at rest, and layers that turn over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tipfem.demos import harness
from tipfem.demos.validation.layers import profiles

import tipfem as tp

# Layers at rest: the largest figures that a run may show; an error of pressure is a part of the largest pressure.
LARGEST_PRESSURE_ERROR = 0.01
LARGEST_REST_VOLUME_ERROR = 0.01
LARGEST_REST_SPEED = 1e-6  # with the sharp interface [m/s]

# Layers that turn over: the figures that a whole run must reach; of a shorter one only the volumes are judged.
END_TIME = 40.75  # that of Carvalho & Sanches [s]
AVERAGED = 4.0  # pressure is averaged over this time at the end [s]: remeshing makes it oscillate
SMALLEST_AGREEMENT = 0.985  # of pressure; the paper reports 0.95
SMALLEST_SUNK = 0.97  # part of the heavy fluid's particles below the interface of the inverted layers
LARGEST_VOLUME_ERROR = 0.01


def volume_error(history: Sequence[Mapping[str, float]], layers: profiles.Layers, width: float) -> float:
    """Largest relative change of a fluid's volume in a run; layers are (fluid, thickness [m]) of this width [m]."""
    return max(
        float(np.abs(np.array([row[f"volume_{fluid.name}"] for row in history]) / (width * thickness) - 1).max())
        for fluid, thickness in layers
    )


@dataclass
class LayersAtRest(harness.Check):
    """Pressure is hydrostatic from the first step on; volumes stay, and with a sharp interface nothing moves.

    Attributes:
        layers: (fluid, thickness [m]) from the floor up.
        width: of the tank [m].
        gravity: [m/s^2].
        first: the simulation after its first step.
    """

    layers: Sequence[tuple[tp.Fluid, float]]
    width: float
    gravity: float = 9.81
    first: tp.Simulation | None = field(init=False, default=None, repr=False)

    def columns(self) -> dict[str, harness.Probe]:
        """The largest error of a particle's pressure over the largest pressure."""
        return {"pressure_error": profiles.PressureWatch(self.layers, self.gravity, since=np.inf)}

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """Keep the state after the first step, for the figure: that of another simulation of the case."""
        self.first = tp.Simulation(simulation.case, time_step=options.time_step)
        self.first.step()

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Errors of pressure, the largest change of a volume, and the largest speed of the run's second half [m/s]."""
        history = simulation.history
        error, time, speed = (
            np.array([row[name] for row in history]) for name in ("pressure_error", "time", "max_speed")
        )
        return {
            "pressure_error_first_step": float(error[0]),
            "pressure_error_end": float(error[-1]),
            "pressure_error_median": float(np.median(error)),
            "pressure_error_largest": float(error.max()),
            "volume_error": volume_error(history, self.layers, self.width),
            "rest_speed": float(speed[time >= time[-1] / 2].max()),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """What a run misses of what is expected of it; only the sharp rule has to keep still."""
        limits = {
            "pressure_error_first_step": LARGEST_PRESSURE_ERROR,
            "pressure_error_end": LARGEST_PRESSURE_ERROR,
            "volume_error": LARGEST_REST_VOLUME_ERROR,
        }
        if options.interface == "sharp":
            limits["rest_speed"] = LARGEST_REST_SPEED
        return harness.above(figures, limits)

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """layers.png: pressure, density and viscosity along the height."""
        states = {} if self.first is None else {"after the first step": self.first}
        states[f"t = {simulation.time:g} s"] = simulation
        profiles.plot_layers(Path(options.out) / "layers.png", states, self.layers, self.gravity)


def sunk(simulation: tp.Simulation, level: float) -> dict[str, float]:
    """Part of the first fluid below the interface of the inverted layers.

    Args:
        simulation: at any time.
        level: height of that interface [m]; a particle that is less than half a spacing above is on it.

    Returns:
        `sunk_particles` of all its particles, walls included; `sunk_inside` of those off the walls; `sunk_volume`.
    """
    particles, mesh = simulation.particles, simulation.mesh
    own = particles.fluid == 0
    below = particles.position[:, 1] <= level + 0.5 * particles.spacing
    share = simulation.state.material.fraction[:, 0] * mesh.measure
    middle = mesh.position[mesh.cells].mean(axis=1)[:, 1]
    return {
        "sunk_particles": float(below[own].mean()),
        "sunk_inside": float(below[own & ~particles.wall].mean()),
        "sunk_volume": float(share[middle <= level].sum() / share.sum()),
    }


@dataclass
class LayersTurnOver(harness.Check):
    """The heavy fluid, on top at first, ends below the light one, and the pressure is hydrostatic then.

    Attributes:
        heavy: the case's first fluid.
        light: its second.
        width: of the tank [m].
        gravity: [m/s^2].
    """

    heavy: tp.Fluid
    light: tp.Fluid
    width: float
    gravity: float = 9.81
    _watch: profiles.PressureWatch | None = field(init=False, default=None, repr=False)

    @property
    def watch(self) -> profiles.PressureWatch:
        """Compares pressure with that of the layers at the end; there is one once the run begins."""
        assert self._watch is not None
        return self._watch

    def inverted(self, simulation: tp.Simulation) -> list[tuple[tp.Fluid, float]]:
        """The layers at the end, (fluid, thickness [m]) from the floor up, by the volumes of a simulation."""
        return [(fluid, simulation.volume(fluid.name) / self.width) for fluid in (self.heavy, self.light)]

    def columns(self) -> dict[str, harness.Probe]:
        """The largest error of a particle's pressure over the largest pressure."""
        return {"pressure_error": lambda simulation: self.watch(simulation)}

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """Compute the layers at the end from the volumes at the start."""
        since = max(0.9 * options.end_time, options.end_time - AVERAGED)
        self._watch = profiles.PressureWatch(self.inverted(simulation), self.gravity, since=since)

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Figures of a run at its end.

        Returns:
            Largest speed [m/s]; agreement of pressure, 1 - its largest error over the largest pressure: of its mean
            over the run's last `AVERAGED` seconds, of the last state, and the median of the states of that time;
            parts of the heavy fluid that have sunk, see `sunk`; largest relative change of a fluid's volume.
        """
        history = simulation.history
        late = [row["pressure_error"] for row in history if row["time"] > self.watch.since]
        return {
            "end_speed": history[-1]["max_speed"],
            "pressure_agreement": 1.0 - float(np.abs(self.watch.mean[1]).max()),
            "pressure_agreement_last": 1.0 - history[-1]["pressure_error"],
            "pressure_agreement_median": 1.0 - float(np.median(late)),
            **sunk(simulation, self.watch.layers[0][1]),
            "volume_error": volume_error(history, self.watch.layers, self.width),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """What a run misses of what is expected of it; one that ends early is judged by its volumes alone."""
        missed = harness.above(figures, {"volume_error": LARGEST_VOLUME_ERROR})
        if options.end_time < END_TIME:  # still falling
            return missed
        for name, limit in (("pressure_agreement", SMALLEST_AGREEMENT), ("sunk_particles", SMALLEST_SUNK)):
            if not figures[name] >= limit:
                missed.append(f"{name} is {figures[name]:.4f}, below {limit:g}")
        return missed

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """pressure.png: pressure along the height at the end, and its mean."""
        profiles.plot_pressure(Path(options.out) / "pressure.png", simulation, self.watch)
