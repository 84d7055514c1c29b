"""Benchmarks: how fast a step is, and where its time goes."""
