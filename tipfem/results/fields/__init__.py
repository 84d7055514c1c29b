"""Fields on disk: a state's positions, cells and quantities, as VTU files or in one VTKHDF file of the whole run."""

from tipfem.results.fields.field_output import FieldOutput
from tipfem.results.fields.field_state import FieldState

__all__ = ["FieldOutput", "FieldState"]
