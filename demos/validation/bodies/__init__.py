"""Rigid bodies in fluids: what floats, rolls, falls, oscillates and stirs."""
