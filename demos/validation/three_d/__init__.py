"""Flows in three dimensions against theory and published figures."""
