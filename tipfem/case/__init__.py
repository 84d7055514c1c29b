"""What a user says: fluids, tanks, particles, walls, gradings, the numbers of the method."""
