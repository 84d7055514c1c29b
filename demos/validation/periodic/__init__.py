"""Flows between periodic sides, against closed forms and linear stability theory."""
