"""Multigrid on a background grid, and subdomain deflation: the preconditioner of the pressure."""
