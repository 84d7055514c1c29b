"""Solids that touch: closed gaps between their outlines."""
