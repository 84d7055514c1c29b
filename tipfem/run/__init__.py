"""Runs: the simulation with what is recorded of it, its checkpoints, and the ways to go on from one."""
