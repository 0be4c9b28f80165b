"""Pictures with matplotlib. Each takes Axes, a new figure's where none are given, and returns them; none is shown."""

from .diagram import diagram, mark
from .orbit import mark_orbits, orbit
from .portrait import portrait
from .trace import trace

__all__ = ["diagram", "mark", "mark_orbits", "orbit", "portrait", "trace"]
