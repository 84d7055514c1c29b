"""The plane: outlines of tanks and shapes, with holes, curves and corners, and the points along them and within."""
