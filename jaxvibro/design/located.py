"""Special points and orbits as functions of their scenes: `located`."""

from ..branches.branch import Special
from ..orbits.orbit import Orbit
from ..scene import check
from .located_orbit import LocatedOrbit, make_located_orbit
from .located_point import Located, make_located_point


@check.host_only("use the function that it gives")
def located(point: Special | Orbit, name: str | None = None, wall: str | None = None) -> Located | LocatedOrbit:
    """A special point's value, or what an orbit has, as a JAX function of its scene: a `Located`, a `LocatedOrbit`.

    point: a `Special` of a branch, SN, PD, SB or GR, and name: of the parameter whose value is asked for, by default
    the point's own; or an `Orbit` of separate impacts or none, and name: "multipliers", "speeds" of its impacts, or
    "peak", its largest abs x. wall: "left" or "right" for a GR that touches both at once: which of them is meant.

    The point or orbit is followed on the straight way from its own scene to the one given, by Newton's method on its
    defining equations (`point_equations`, `impact_equations`), and differentiated by the implicit function theorem. An
    SB is that of the scene's symmetric part. Where a wall has no restitution (or damping) of its own, the scene's
    derivative holds the wall's.

    Raises ArgumentError for a point of another kind, a name that the scene or the orbit lacks, and a GR that touches
    more than one wall, or one more than once, where no wall is given; OrbitError for an orbit that rests on a wall.
    """
    if isinstance(point, Orbit):
        if wall is not None:
            raise check.ArgumentError("wall", "must be None for an orbit", wall)
        return make_located_orbit(point, name)
    return make_located_point(point, name, wall)
