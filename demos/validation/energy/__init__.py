"""The energy budget of the dam break."""
