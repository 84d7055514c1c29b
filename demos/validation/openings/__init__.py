"""Flows through openings, and waves, against theory and experiments."""
