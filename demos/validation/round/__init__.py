"""Axisymmetric flows against theory: layers at rest, threads that break up, drops that swing, rest and stand."""
