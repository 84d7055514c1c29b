"""A pressure on each side of interfaces."""
