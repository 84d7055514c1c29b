"""What a mesh knows of its walls: which particles lie on which walls, in which frames, and where openings are."""
