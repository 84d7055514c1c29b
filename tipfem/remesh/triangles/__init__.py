"""Triangulations: triangles that follow their particles and are changed in place, in two dimensions."""
