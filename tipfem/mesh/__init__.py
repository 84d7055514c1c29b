"""Simplices on particles: Delaunay, free surfaces, interfaces, and what is measured on them."""
