"""Studies: many runs of one case with other values, from one file; see `tipfem.app.study.study` for its format."""
