"""Kernels that flip, split and collapse edges of a triangulation."""
