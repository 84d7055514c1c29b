"""Remeshing alone: bodies of a fluid that are carried by flows given in closed form, without a solver."""
