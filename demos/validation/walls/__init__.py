"""Walls that slip, slide and move against closed forms."""
