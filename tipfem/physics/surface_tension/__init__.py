"""Surface tension of interfaces and free surfaces."""
