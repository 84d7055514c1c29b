"""Walls that slip, slide or move, with their friction and boundary layers."""
