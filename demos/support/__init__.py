"""Checks and figures that several demos share."""
