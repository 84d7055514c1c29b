"""Drops, bubbles, waves and films with surface tension, against closed forms and reference solutions."""
