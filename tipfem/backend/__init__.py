"""Taichi: start the runtime, hold its arrays, launch kernels."""
