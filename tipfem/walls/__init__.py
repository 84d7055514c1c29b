"""Walls that slip, slide or move, in a time step."""
