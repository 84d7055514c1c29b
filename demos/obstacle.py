"""Dam break against an obstacle: a column of water in air collapses and hits a block on the floor.

The geometry of OpenFOAM's tutorial damBreak: a column 0.1461 m wide and twice as high in a square tank, and a block
24 mm wide and 48 mm high in the middle of its floor. The tank is a polygon; so any shape is described. When the water
meets the block and the right wall, and how high it is thrown, is compared with OpenFOAM's interFoam; see
demos/validation/shapes.

    python demos/obstacle.py --spacing 0.01 --end-time 0.4
"""

from tipfem.demos import harness
from tipfem.demos.validation.shapes.obstacle import Obstacle

import tipfem as tp

# Resolution. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.006,  # [m]
    time_step=1.2e-3,  # the largest; it adapts below [s]
    end_time=0.5,  # [s]
    frames_per_second=250.0,  # of simulated time; at 25 pictures a second the movie is ten times slower
    out="out/obstacle",
)

# Fluids, at 20 degrees Celsius.
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)

# Geometry: the corners of the tank, anticlockwise, with the block in its floor.
corners = [
    (0, 0),
    (0.292, 0),
    (0.292, 0.048),
    (0.316, 0.048),
    (0.316, 0),
    (0.584, 0),
    (0.584, 0.584),
    (0, 0.584),
]
tank = tp.tank(shape=corners, spacing=options.spacing)
tank.fill(air)
tank.fill(water, box=((0, 0), (0.1461, 0.292)))
case = tp.Case(
    tank,
    fluids=[water, air],
    gravity=(0, -9.81),
    interface=options.interface,
    title="Dam break against an obstacle",
)

# Run. The harness runs the case, compares it with interFoam and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/obstacle", time_step=1.2e-3, output_interval=0.004).run(0.5)
harness.run(case, options, check=Obstacle(), strip=(0.0, 0.1, 0.2, 0.25, 0.3, 0.4, 0.5))
