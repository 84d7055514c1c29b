"""The impact of a dam break on a wall."""
