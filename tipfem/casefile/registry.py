"""All objects that stand in lists of tables of case files."""

from tipfem.casefile.beaches import Beaches
from tipfem.casefile.bodies import Bodies
from tipfem.casefile.lists import Listed
from tipfem.casefile.openings import Openings
from tipfem.casefile.walls import Walls

LISTED: tuple[Listed, ...] = (Walls(), Bodies(), Openings(), Beaches())
