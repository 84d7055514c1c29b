"""A drop of glycerin falls through air into water, and sinks to the floor: three fluids.

No case of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation", but one that their
method takes as it is: properties belong to the fluids, and there may be any number of them. The drop's surface is at
first one between glycerin and air, and then one between glycerin and water. Nothing is compared with measurements; the
check is on volumes, and on where the fluids end.

    python demos/sinking_drop.py --spacing 0.005
"""

from tipfem.demos import harness
from tipfem.demos.support.checks import DropSinks

import tipfem as tp

# Resolution. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.0025,  # [m]
    time_step=1e-3,  # the largest; it adapts below [s]
    end_time=2.0,  # [s]
    frames_per_second=50.0,  # of simulated time; at 25 pictures a second the movie is two times slower
    out="out/sinking_drop",
)

# Fluids, at 20 degrees Celsius.
glycerin = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)

# Geometry: water in the lower half of the tank, and a drop of 25 mm in the air above it.
depth = 0.06  # of the water [m]
tank = tp.tank(size=(0.1, 0.12), spacing=options.spacing)
tank.fill(air)
tank.fill(water, box=((0, 0), (0.1, depth)))
tank.fill(glycerin, disc=((0.05, 0.09), 0.0125))
case = tp.Case(
    tank,
    fluids=[glycerin, water, air],
    gravity=(0, -9.81),
    interface=options.interface,
    title="Glycerin falls through air into water",
)

# Run. The harness runs the case, checks and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/sinking_drop", time_step=1e-3, output_interval=0.02).run(2.0)
harness.run(
    case,
    options,
    check=DropSinks(depth),
    strip=(0.0, 0.06, 0.1, 0.14, 0.2, 0.3, 0.5, options.end_time),
)
