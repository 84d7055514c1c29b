"""Floating: a box and a log, moored by springs, in the waves of a column of water that collapses.

Rigid bodies whose motions are solved together with the fluids: the box has half the density of water, the log a
fifth. The history has their positions, angles and velocities, and the forces of the fluids on them.

    python demos/floating.py --spacing 0.015 --end-time 3
"""

from tipfem.demos import harness

import tipfem as tp

# Resolution. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.012,  # [m]
    time_step=2e-3,  # the largest; it adapts below [s]
    end_time=3.0,  # [s]
    frames_per_second=50.0,
    interface=None,  # the sharp one
    out="out/floating",
)

# Fluids.
air = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
water = tp.Fluid("water", density=1000.0, viscosity=1e-3)

# Geometry: a tank of 1.5 m x 0.7 m with 0.2 m of water, a column 0.42 m high on the left, and two bodies on the water.
tank = tp.tank(size=(1.5, 0.7), spacing=options.spacing)
tank.fill(air)
tank.fill(water, box=((0, 0), (1.5, 0.2)))
tank.fill(water, box=((0, 0), (0.25, 0.42)))
box = tp.shapes.rectangle((0.56, 0.16), (0.74, 0.24))
log = tp.shapes.circle((1.06, 0.24), 0.055)
tank.add(tp.Body(box, name="box", density=500.0, stiffness=(400.0, 0.0, 0.0), damping=(20.0, 0.0, 0.0)))
tank.add(tp.Body(log, name="log", density=200.0, stiffness=(400.0, 0.0, 0.0), damping=(20.0, 0.0, 0.0)))
case = tp.Case(tank, fluids=[water, air], gravity=(0, -9.81), title="A box and a log in the waves of a dam break")

# Run. The harness runs the case and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/floating", time_step=2e-3, output_interval=0.02).run(3.0)
harness.run(case, options, strip=(0.0, 0.4, 0.8, 1.6))
