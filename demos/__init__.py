"""Demos: one script a case; beside them validation against references, and benchmarks."""
