"""tipfem: two-phase incompressible flow by position-based PFEM."""
