"""Fluids whose viscosity follows a law."""
