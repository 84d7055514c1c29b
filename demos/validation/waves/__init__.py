"""Standing waves between two fluids."""
