"""Texts of case files that tests of several subjects begin with."""

# Water in a tank of air; the box of the water, and what is tested, follow.
WATER_IN_AIR = """
gravity = [0, -9.81]
[fluids.water]
density = 1000.0
viscosity = 1e-3
[fluids.air]
density = 1.2
viscosity = 1.8e-5
[tank]
size = [0.4, 0.3]
spacing = 0.02
[[fill]]
fluid = "air"
[[fill]]
fluid = "water"
"""
