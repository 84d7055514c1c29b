"""The dam break of Martin & Moyce."""
