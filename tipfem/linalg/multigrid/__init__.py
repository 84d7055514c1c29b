"""The preconditioner: multigrid on a background grid."""
