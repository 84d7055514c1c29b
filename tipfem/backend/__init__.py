"""Taichi: starting it, its arrays, launching kernels."""
