"""Make special points and orbits differentiable functions of their scenes: `located`."""

from ..branches.branch import Special
from ..orbits.orbit import Orbit
from ..scene import check
from .located_orbit import LocatedOrbit, make_located_orbit
from .located_point import Located, make_located_point


@check.host_only("use the function that it gives")
def located(point: Special | Orbit, name: str | None = None, wall: str | None = None) -> Located | LocatedOrbit:
    """Make the value of a special point, or a quantity of an orbit, a JAX function of its scene.

    Parameters
    ----------
    point : Special or Orbit
        Special point of a branch, of kind SN, PD, SB or GR, or an orbit with separate impacts or without impacts.
    name : str, optional
        For a special point, the parameter whose value is returned. By default the parameter of its branch. For an
        orbit, the quantity: ``"multipliers"``, ``"speeds"`` of its impacts, or ``"peak"``, the largest ``|x|``. This
        argument is required for an orbit.
    wall : {"left", "right"}, optional
        Wall of a GR that touches both walls at once. Required for such a point, and not allowed for an orbit.

    Returns
    -------
    Located or LocatedOrbit
        Function of a scene or of a batch of scenes.

    Raises
    ------
    ArgumentError
        If the point is of another kind, if its orbit sticks to a wall, if the scene or the orbit has no such name, if a
        GR touches both walls and no wall is given, or if a GR touches the same wall several times.
    OrbitError
        If `point` is an orbit that sticks to a wall or chatters.

    See Also
    --------
    sensitivity : Table of the first derivatives of a special point.
    place : Find the least change of a scene that moves special points to given values.

    Notes
    -----
    Newton's method on the defining equations (`special_point_equations`, `impact_equations`) continues the point or
    orbit along the straight path from the original scene to the given scene. Derivatives follow from the implicit
    function theorem. An SB is located in the symmetric part of the scene. If a wall inherits its restitution (or
    damping) from the scene, the derivative with respect to the restitution (or damping) of the scene includes the
    effect of this wall.

    Examples
    --------
    >>> value = jv.located(branch.points("SN")[0])
    >>> round(float(value(scene)), 6)
    0.508058
    >>> round(float(jax.grad(value)(scene).damping), 6)
    4.00908
    """
    if isinstance(point, Orbit):
        if wall is not None:
            raise check.ArgumentError("wall", "must be None for an orbit", wall)
        return make_located_orbit(point, name)
    return make_located_point(point, name, wall)
