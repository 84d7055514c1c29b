"""Pictures and movies of tipfem results."""
