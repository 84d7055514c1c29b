"""Layers of fluids at rest in a closed tank: pressure against the analytic one.

The first case of section 4.1 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM
formulation": glycerin below, water above. Pressure is to be hydrostatic from the first step on, and to stay so; see
demos/validation/layers. Water under air, whose densities are further apart, and three layers are there too.

    python demos/layers_at_rest.py --layers water-air --interface interpolated
"""

from typing import Literal

from tipfem.demos import harness
from tipfem.demos.support.options import Positive, Rule
from tipfem.demos.validation.layers.check import LayersAtRest

import tipfem as tp

EDGE = 0.1  # of the tank [m]

# Fluids, at 20 degrees Celsius.
glycerin = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)


def case(
    spacing: Positive = 0.005,
    interface: Rule = "sharp",
    layers: Literal["glycerin-water", "water-air", "three"] = "glycerin-water",
) -> tp.Case:
    """A square tank, whose height the layers share evenly.

    Args:
        spacing: distance between particles [m].
        interface: rule for the interface of two fluids.
        layers: the fluids, from the floor up.
    """
    fluids = {"glycerin-water": [glycerin, water], "water-air": [water, air], "three": [glycerin, water, air]}[layers]
    # The particles inside are moved at random by up to a fifth of their spacing: a regular lattice would be too easy.
    tank = tp.tank(size=(EDGE, EDGE), spacing=spacing, jitter=0.2).fill(fluids[-1])
    thickness, floor = EDGE / len(fluids), 0.0
    for fluid in fluids[:-1]:
        tank.fill(fluid, box=((0.0, floor), (EDGE, floor + thickness)))
        floor += thickness
    title = " under ".join(fluid.name for fluid in fluids).capitalize() + ", at rest"
    return tp.Case(tank, fluids=fluids, gravity=(0, -9.81), interface=interface, title=title)


def check(case: tp.Case) -> harness.Check:
    """Hydrostatics of the case's layers."""
    return LayersAtRest([(fluid, EDGE / len(case.fluids)) for fluid in case.fluids], EDGE)


# Runs the case, compares it with hydrostatics and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case(), out="out/layers_at_rest", time_step=5e-3, output_interval=0.1).run(1.0)
main = harness.Demo(
    case,
    end_time=1.0,  # [s]
    time_step=5e-3,  # the largest; it adapts below [s]
    frames_per_second=10.0,  # of simulated time
    check=check,
)

if __name__ == "__main__":
    harness.command(__name__)
