"""Geometry: boxes and polyhedra, periods, lattices, and the plane, without fluids or particles."""
