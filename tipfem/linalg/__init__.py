"""Newton's method, flexible GMRES and multigrid, independent of the physics."""
