"""Walls of a mesh: the particles on each, their frames, and where they are open."""
