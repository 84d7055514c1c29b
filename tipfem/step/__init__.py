"""The time step: the nonlinear problem, its linear systems, and the budget."""
