"""Layers of fluids under gravity against hydrostatics."""
