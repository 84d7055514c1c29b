"""Dam break of water with a free surface: one fluid, and nothing around it.

The column of section 4.2 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation",
in the same tank, but without the air: where the water ends, pressure is zero (the alpha-shape of their section 3). The
front is compared with the experiments of Martin & Moyce (1952) and Koshizuka & Oka (1996), the height of the column
with Martin & Moyce; see demos/validation/dam_break.

    python demos/dam_break_free_surface.py --spacing 0.01 --end-time 0.3
"""

from tipfem.demos import harness
from tipfem.demos.validation.dam_break.check import DamBreak

import tipfem as tp

# Resolution: 5 mm is the coarser of the paper's two. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.005,  # [m]
    time_step=1e-3,  # the largest; it adapts below [s]
    end_time=0.6,  # [s]; the splash at the far wall begins at 0.27 s
    frames_per_second=250.0,  # of simulated time; at 25 pictures a second the movie is ten times slower
    interface=None,  # there is one fluid
    out="out/dam_break_free_surface",
)

# Fluids, at 20 degrees Celsius.
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)

# Geometry: a column of water 0.146 m wide and twice as high; the rest of the tank stays empty.
tank = tp.tank(size=(0.584, 0.584), spacing=options.spacing)
tank.fill(water, box=((0, 0), (0.146, 0.292)))
case = tp.Case(
    tank,
    fluids=[water],
    gravity=(0, -9.81),
    free_surface=True,
    title="Dam break of water with a free surface",
)

# Run. The harness runs the case, compares it with the experiments and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/dam_break_free_surface", time_step=1e-3, output_interval=0.004).run(0.6)
harness.run(case, options, check=DamBreak(free_surface=True))
