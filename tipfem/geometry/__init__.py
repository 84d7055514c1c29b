"""The plane, without fluids or particles: shapes, polygons that bound fluids, curves, periods, lattices."""
