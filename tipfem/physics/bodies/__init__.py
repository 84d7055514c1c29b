"""Rigid bodies that float or are moved, their contacts and their energy."""
