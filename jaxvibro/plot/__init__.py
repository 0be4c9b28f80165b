"""Pictures with matplotlib. Each takes Axes, a new figure's where none are given, and returns them; none is shown."""

from .branch import branch, mark_points
from .diagram import diagram, mark
from .locus import locus, region
from .orbit import mark_orbits, orbit
from .portrait import portrait
from .trace import trace

__all__ = ["branch", "diagram", "locus", "mark", "mark_orbits", "mark_points", "orbit", "portrait", "region", "trace"]
