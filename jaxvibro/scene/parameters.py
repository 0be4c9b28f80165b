"""What a parameter of a scene may be, and along which leaf of the scene it lies."""

from dataclasses import replace

import jax
import numpy as np

from . import check
from .scene import changed
from .unit_slips import hint, in_units, require_scene_units

ROUNDING = 8.0 * np.finfo(float).eps  # of a value: as near are two equal


def domain(scene, name):
    """(low, high): between them, ends left out where the walls would meet or the drive stand, the scene is one."""
    inf = np.inf
    if name.startswith("force."):
        return -inf, inf
    if name == "frequency" or name.endswith("stiffness"):
        return np.finfo(float).tiny, inf
    if name.endswith("damping"):
        return 0.0, inf
    if name.endswith("restitution"):
        return 0.0, 1.0
    if name.endswith("position") and len(scene.walls) == 2:
        room = sum(abs(float(wall.motion.amplitude)) for wall in scene.walls.values() if wall.motion is not None)
        low = -inf if name.startswith("left") else float(scene.left.position) + room
        high = inf if name.startswith("right") else float(scene.right.position) - room
        return low, high
    return -inf, inf


def bounds_of(scene, name, bounds):
    """(low, high) as plain numbers, checked: two finite numbers, the first smaller, with the scene's value between."""
    check.require_known(name, scene.names, name)
    given = np.asarray(bounds, float) if np.shape(bounds) == (2,) else np.array([np.nan, np.nan])
    if not (np.isfinite(given).all() and given[0] < given[1]):
        raise check.ArgumentError("bounds", "must be (low, high), two finite numbers, the first smaller", bounds)
    value = float(scene.parameter(name))
    if not given[0] <= value <= given[1]:
        rule = f"must hold the start's {name}, {in_units(scene, name)}{hint(scene, name, *given)}"
        raise check.ArgumentError("bounds", rule, bounds)
    return float(given[0]), float(given[1])


def values_of(scene, name, values):
    """Values of a parameter as an array, checked: a row of one at least, with each of which the scene is one."""
    check.require_known(name, scene.names, values)
    found = check.real("values", values, np.float64)
    if found.ndim != 1 or not len(found):
        raise check.ArgumentError("values", f"must be a row of values of {name}, one at least", values)
    require_scene_units("values", scene, name, found)
    scene.replace(**{name: found})
    return found


def marked(scene, *names):
    """(the scene with numbers of its own at the parameters, the same tree with 1 at the first, 2 at the second, else
    0). A parameter may be several that have one value, a tuple of their names.

    The hardness of soft walls gets a leaf, whatever the parameters are: what is compiled is then the same for all. The
    numbers are NumPy's, as the host asks for each of them again and again.
    """
    scene = jax.tree.map(np.asarray, scene)
    for name in flat(names):
        scene = changed(scene, {name: 0.0 if name == "hardness" else scene.parameter(name)})
    if scene.hardens:
        scene = replace(scene, harder=np.zeros(()))
    marks = jax.tree.map(lambda leaf: np.int32(0), scene)
    for k, given in enumerate(names, 1):
        for name in flat([given]):
            mark = np.int32(k)
            marks = replace(marks, harder=mark) if name == "hardness" else changed(marks, {name: mark})
    return scene, marks


def flat(names):
    """Names of parameters, those in tuples too, in a row."""
    return [one for given in names for one in check.sequence("names", given)]


def tied(scene, name):
    """The value of a parameter, or of several that are one, a tuple of names.

    Raises ArgumentError where their values differ: no number is then that of all.
    """
    values = {one: float(scene.parameter(one)) for one in check.sequence("names", name)}
    low, high = min(values.values()), max(values.values())
    if high - low > ROUNDING * max(abs(low), abs(high)):
        rule = "in one tuple must have one value; for a common shift take the sum of what each gives alone"
        raise check.ArgumentError("names", rule, values)
    return low
