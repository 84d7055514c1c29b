"""Layers of fluids at rest in a closed tank: pressure against the analytic one.

The first case of section 4.1 of Carvalho & Sanches, "Analysis of two-phase flows using position-based PFEM
formulation": glycerin below, water above. Pressure is to be hydrostatic from the first step on, and to stay so; see
demos/validation/layers. Water under air, whose densities are further apart, and three layers are there too.

    python demos/layers_at_rest.py --layers water-air --interface interpolated
"""

from tipfem.demos import harness
from tipfem.demos.validation.layers.check import LayersAtRest

import tipfem as tp

# Resolution. All of these can be changed on the command line.
options = harness.options(
    __doc__,
    spacing=0.005,  # [m]
    time_step=5e-3,  # the largest; it adapts below [s]
    end_time=1.0,  # [s]
    frames_per_second=10.0,  # of simulated time
    out="out/layers_at_rest",
    layers=harness.Option(
        "glycerin-water", "the fluids, from the floor up", choices=("glycerin-water", "water-air", "three")
    ),
)

# Fluids, at 20 degrees Celsius; those of the layers, from the floor up.
glycerin = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
fluids = {"glycerin-water": [glycerin, water], "water-air": [water, air], "three": [glycerin, water, air]}[
    options.layers
]

# Geometry: a square tank, whose height the layers share evenly. The particles inside are moved at random by up to a
# fifth of their spacing: a regular lattice would be too easy.
edge = 0.1  # [m]
layers = [(fluid, edge / len(fluids)) for fluid in fluids]
tank = tp.tank(size=(edge, edge), spacing=options.spacing, jitter=0.2).fill(fluids[-1])
floor = 0.0
for fluid, thickness in layers[:-1]:
    tank.fill(fluid, box=((0.0, floor), (edge, floor + thickness)))
    floor += thickness
title = " under ".join(fluid.name for fluid in fluids).capitalize() + ", at rest"
case = tp.Case(tank, fluids=fluids, gravity=(0, -9.81), interface=options.interface, title=title)

# Run. The harness runs the case, compares it with hydrostatics and draws it. Without the harness:
#     tp.init()
#     tp.Simulation(case, out="out/layers_at_rest", time_step=5e-3, output_interval=0.1).run(1.0)
harness.run(case, options, check=LayersAtRest(layers, edge))
