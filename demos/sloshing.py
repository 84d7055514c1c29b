"""Sloshing: a standing wave of small amplitude on water with a free surface, between walls that slip.

The position-based PFEM of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
with one fluid and nothing above it. A wave of one half length in the tank is let go from rest; its period and its
damping are compared with linear theory, see demos/validation/sloshing.

    python demos/sloshing.py --spacing 0.05 --end-time 2.4
"""

import numpy as np
from tipfem.demos import harness
from tipfem.demos.validation.sloshing.check import StandingWave

import tipfem as tp

# Resolution. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.025,  # [m]
    time_step=0.01,  # the largest; it adapts below [s]
    end_time=4.8,  # four periods [s]
    frames_per_second=25.0,
    interface=None,  # there is one fluid
    out="out/sloshing",
)

# Fluids: as heavy as water, and so viscous that the wave loses a tenth in a period.
water = tp.Fluid("water", density=1000.0, viscosity=5.0)

# Geometry: a tank 1 m long, half a metre of water, and a wave whose crest is at the left wall.
length, depth, amplitude = 1.0, 0.5, 0.01  # [m]
tank = tp.tank(size=(length, 0.7), spacing=options.spacing)
tank.fill(water, where=lambda x: x[:, 1] < depth + amplitude * np.cos(np.pi / length * x[:, 0]))
for side in ("left", "right", "bottom"):
    tank.wall(side, slip=True)
case = tp.Case(tank, fluids=[water], gravity=(0, -9.81), free_surface=True, title="Sloshing")

# Run. The harness runs the case, compares it with linear theory and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/sloshing", time_step=0.01, output_interval=0.04).run(4.8)
harness.run(case, options, check=StandingWave(water, length, depth, amplitude))
