"""Demos: one script a case."""
