"""A standing wave against linear theory."""
