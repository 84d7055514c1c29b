"""Bodies that touch walls and each other: what stands, falls, slides and is pushed."""
