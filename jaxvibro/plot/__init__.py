"""Draw results with matplotlib.

Each function draws into given Axes, or into the Axes of a new figure, and returns the Axes. No function shows a figure.
"""

from .basins import basins
from .branch import branch, mark_points
from .diagram import diagram, mark
from .fit import fit
from .fractions import fractions
from .held import held
from .locus import locus, region
from .manifolds import manifold
from .map import map
from .margin import margin
from .orbit import mark_orbits, orbit
from .portrait import portrait
from .section import section
from .spectrum import spectrum
from .trace import trace

__all__ = [
    "basins",
    "branch",
    "diagram",
    "fit",
    "fractions",
    "held",
    "locus",
    "manifold",
    "map",
    "margin",
    "mark",
    "mark_orbits",
    "mark_points",
    "orbit",
    "portrait",
    "region",
    "section",
    "spectrum",
    "trace",
]
