"""Dam break against an obstacle: a column of water in air collapses and hits a block on the floor.

The geometry of OpenFOAM's tutorial damBreak: a column 0.1461 m wide and twice as high in a square tank, and a block
24 mm wide and 48 mm high in the middle of its floor. The tank is a polygon; so any shape is described. When the water
meets the block and the right wall, and how high it is thrown, is compared with OpenFOAM's interFoam; see
demos/validation/shapes.

    python demos/obstacle.py --spacing 0.01 --until 0.4
"""

from tipfem.demos import harness
from tipfem.demos.support.options import Positive, Rule
from tipfem.demos.validation.shapes.obstacle import Obstacle

import tipfem as tp

# The corners of the tank, anticlockwise, with the block in its floor [m].
CORNERS = [
    (0, 0),
    (0.292, 0),
    (0.292, 0.048),
    (0.316, 0.048),
    (0.316, 0),
    (0.584, 0),
    (0.584, 0.584),
    (0, 0.584),
]


def case(spacing: Positive = 0.006, interface: Rule = "sharp") -> tp.Case:
    """A column of water beside a block.

    Args:
        spacing: distance between particles [m].
        interface: rule for the interface of two fluids.
    """
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)  # both at 20 degrees Celsius
    air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
    tank = tp.tank(shape=CORNERS, spacing=spacing)
    tank.fill(air)
    tank.fill(water, box=((0, 0), (0.1461, 0.292)))
    return tp.Case(
        tank, fluids=[water, air], gravity=(0, -9.81), interface=interface, title="Dam break against an obstacle"
    )


# Runs the case, compares it with interFoam and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case(), out="out/obstacle", time_step=1.2e-3, output_interval=0.004).run(0.5)
main = harness.Demo(
    case,
    end_time=0.5,  # [s]
    time_step=1.2e-3,  # the largest; it adapts below [s]
    frames_per_second=250.0,  # of simulated time; at 25 pictures a second the movie is ten times slower
    check=Obstacle(),
    strip=(0.0, 0.1, 0.2, 0.25, 0.3, 0.4, 0.5),
)

if __name__ == "__main__":
    harness.command(__name__)
