"""Newton's method and flexible GMRES; they know no physics."""
