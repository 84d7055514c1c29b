"""The next mesh: triangulations that follow the particles, volumes, relocation."""
