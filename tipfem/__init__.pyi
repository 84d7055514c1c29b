"""The public names, once: `tipfem` imports them as these lines say, when they are first used."""

from tipfem.backend.runtime import init as init
from tipfem.case.beaches import Beach as Beach
from tipfem.case.body import Body as Body
from tipfem.case.case import Case as Case
from tipfem.case.fluid import Fluid as Fluid
from tipfem.case.grading import Grading as Grading
from tipfem.case.mesh_file import read_mesh as read_mesh
from tipfem.case.numerics import (
    FittedRule as FittedRule,
)
from tipfem.case.numerics import (
    Numerics as Numerics,
)
from tipfem.case.numerics import (
    RelocationRule as RelocationRule,
)
from tipfem.case.numerics import (
    SurfaceRule as SurfaceRule,
)
from tipfem.case.openings import Inlet as Inlet
from tipfem.case.openings import Outlet as Outlet
from tipfem.case.openings import Vent as Vent
from tipfem.case.particles import Particles as Particles
from tipfem.case.rheology import (
    Bingham as Bingham,
)
from tipfem.case.rheology import (
    Carreau as Carreau,
)
from tipfem.case.rheology import (
    Granular as Granular,
)
from tipfem.case.rheology import (
    HerschelBulkley as HerschelBulkley,
)
from tipfem.case.rheology import (
    PowerLaw as PowerLaw,
)
from tipfem.case.rheology import (
    Smagorinsky as Smagorinsky,
)
from tipfem.case.tank import Tank as Tank
from tipfem.case.tank import tank as tank
from tipfem.case.walls import Motion as Motion
from tipfem.case.walls import Wall as Wall
from tipfem.case.waves import IrregularWaves as IrregularWaves
from tipfem.case.waves import WavePiston as WavePiston
from tipfem.casefile.describing import describe as describe
from tipfem.casefile.describing import write_case as write_case
from tipfem.casefile.problems import CaseFileError as CaseFileError
from tipfem.errors import CheckpointError as CheckpointError
from tipfem.errors import SimulationError as SimulationError
from tipfem.geometry import solids as solids
from tipfem.geometry.plane import shapes as shapes
from tipfem.geometry.plane.drawings import read_drawing as read_drawing
from tipfem.logs import log_json as log_json
from tipfem.probes import (
    DropProbe as DropProbe,
)
from tipfem.probes import (
    EnergyProbe as EnergyProbe,
)
from tipfem.probes import (
    FilmProbe as FilmProbe,
)
from tipfem.probes import (
    FrontProbe as FrontProbe,
)
from tipfem.probes import (
    LineProbe as LineProbe,
)
from tipfem.probes import (
    OpeningProbe as OpeningProbe,
)
from tipfem.probes import (
    PointProbe as PointProbe,
)
from tipfem.probes import (
    Probe as Probe,
)
from tipfem.probes import (
    VolumeProbe as VolumeProbe,
)
from tipfem.probes import (
    WallForce as WallForce,
)
from tipfem.probes import (
    WallPressure as WallPressure,
)
from tipfem.probes import (
    WaveGauge as WaveGauge,
)
from tipfem.probes import (
    WaveProbe as WaveProbe,
)
from tipfem.render.viewer.widget import View as View
from tipfem.results.fields import FieldOutput as FieldOutput
from tipfem.results.fields import FieldState as FieldState
from tipfem.results.reader import RunResults as RunResults
from tipfem.results.reader import read_results as read_results
from tipfem.results.reader import to_vtkhdf as to_vtkhdf
from tipfem.results.tables import Table as Table
from tipfem.run.case_file import CaseFile as CaseFile
from tipfem.run.case_file import load_case as load_case
from tipfem.run.live import live as live
from tipfem.run.simulation import Simulation as Simulation
from tipfem.run.steering import (
    Discharge as Discharge,
)
from tipfem.run.steering import (
    Drop as Drop,
)
from tipfem.run.steering import (
    Gravity as Gravity,
)
from tipfem.run.steering import (
    MoveWall as MoveWall,
)
from tipfem.run.steering import (
    Poke as Poke,
)
from tipfem.run.steering import (
    Release as Release,
)
from tipfem.run.steering import (
    SurfaceTension as SurfaceTension,
)
from tipfem.run.steering import (
    Valve as Valve,
)
from tipfem.run.steering import (
    Viscosity as Viscosity,
)

__version__: str
__all__: list[str]
