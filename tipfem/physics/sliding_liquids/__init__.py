"""Liquids that slide along each other at their interface."""
