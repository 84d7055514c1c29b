"""Remeshing: triangulations that follow the particles, volumes of the fluids, relocation of particles."""
