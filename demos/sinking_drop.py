"""A drop of glycerin falls through air into water, and sinks to the floor: three fluids.

No case of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation", but one that their
method takes as it is: properties belong to the fluids, and there may be any number of them. The drop's surface is at
first one between glycerin and air, and then one between glycerin and water. Nothing is compared with measurements; the
check is on volumes, and on where the fluids end.

    python demos/sinking_drop.py --spacing 0.005
"""

import math

from tipfem.demos import harness
from tipfem.demos.support.checks import DropSinks
from tipfem.demos.support.options import Positive, Rule

import tipfem as tp

DEPTH = 0.06  # of the water [m]


def case(spacing: Positive = 0.0025, interface: Rule = "sharp") -> tp.Case:
    """Water in the lower half of a tank, and a drop of 25 mm in the air above it.

    Args:
        spacing: distance between particles [m].
        interface: rule for the interface of two fluids.
    """
    glycerin = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)  # all at 20 degrees Celsius
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
    tank = tp.tank(size=(0.1, 0.12), spacing=spacing)
    tank.fill(air)
    tank.fill(water, box=((0, 0), (0.1, DEPTH)))
    tank.fill(glycerin, disc=((0.05, 0.09), 0.0125))
    return tp.Case(
        tank,
        fluids=[glycerin, water, air],
        gravity=(0, -9.81),
        interface=interface,
        title="Glycerin falls through air into water",
    )


# Runs the case, checks and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case(), out="out/sinking_drop", time_step=1e-3, output_interval=0.02).run(2.0)
main = harness.Demo(
    case,
    end_time=2.0,  # [s]
    time_step=1e-3,  # the largest; it adapts below [s]
    frames_per_second=50.0,  # of simulated time; at 25 pictures a second the movie is two times slower
    check=DropSinks(DEPTH),
    strip=(0.0, 0.06, 0.1, 0.14, 0.2, 0.3, 0.5, math.inf),
)

if __name__ == "__main__":
    harness.command(__name__)
