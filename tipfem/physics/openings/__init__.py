"""Openings in the walls: inlets, outlets and vents."""
