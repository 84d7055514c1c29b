"""The two interface rules side by side."""
