"""Dam break of water in air, in a closed tank.

The case of section 4.2 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM formulation": a
column of water collapses under gravity and runs along the floor of a tank full of air. The front is compared with the
experiments of Martin & Moyce (1952) and Koshizuka & Oka (1996), the height of the column with Martin & Moyce; see
demos/validation/dam_break.

    python demos/dam_break.py --spacing 0.01 --end-time 0.3

With --air-spacing particles stand farther apart in the air, the farther from the water: as good a front, for a part
of the time.

    python demos/dam_break.py --spacing 0.002 --air-spacing 0.02
"""

from tipfem.demos import harness
from tipfem.demos.validation.dam_break.check import DamBreak

import tipfem as tp

# Resolution: 5 mm is the coarser of the paper's two. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.005,  # [m]
    time_step=1.2e-3,  # the largest; it adapts below [s]
    end_time=0.4,  # [s]
    frames_per_second=250.0,  # of simulated time; at 25 pictures a second the movie is ten times slower
    out="out/dam_break",
    air_spacing=harness.Option(
        None, "distance between particles in the air, far from the water [m]; none for that of all", harness.positive
    ),
)

# Fluids, at 20 degrees Celsius.
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)

# Geometry: a column of water 0.146 m wide and twice as high, in a square tank four times as wide.
tank = tp.tank(size=(0.584, 0.584), spacing=options.spacing)
tank.fill(air)
tank.fill(water, box=((0, 0), (0.146, 0.292)))
case = tp.Case(
    tank,
    fluids=[water, air],
    gravity=(0, -9.81),
    interface=options.interface,
    # A particle may move by 0.8 spacings in a step, more than by default, where no element would be inverted.
    numerics=tp.Numerics(largest_move=0.8),
    grading=tp.Grading({"air": options.air_spacing}) if options.air_spacing else None,
    title="Dam break of water in air",
)

# Run. The harness runs the case, compares it with the experiments and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/dam_break", time_step=1.2e-3, output_interval=0.004).run(0.4)
harness.run(case, options, check=DamBreak(), strip=(0.0, 0.1, 0.2, 0.25, 0.3, 0.4, 0.6, 1.0))
