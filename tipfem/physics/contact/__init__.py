"""Solids that touch: closed gaps between their outlines, and contacts of bodies."""
