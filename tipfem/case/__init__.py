"""What users describe: fluids, tanks, particles, walls, gradings, parameters of the method."""
