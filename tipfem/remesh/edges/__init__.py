"""Kernels that flip, split and collapse edges."""
