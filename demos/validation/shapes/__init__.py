"""Tanks of any shape: walls at angles, round ones, and obstacles."""
