"""The user's description of a flow: fluids, tanks, particles, walls, grading, parameters of the method."""
