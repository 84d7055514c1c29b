"""A free drop that is stretched, and one that turns too, against the motion of an ellipse."""
