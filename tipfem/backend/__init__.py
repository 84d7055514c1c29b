"""Taichi: start the runtime, hold its arrays, launch kernels."""

from tipfem.backend import runtime as runtime  # first, for it prepares the import of Taichi
