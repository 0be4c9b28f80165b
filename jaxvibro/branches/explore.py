"""`explore`: the periodic orbits of a scene along a parameter, unattended: followed both ways and from point to point.

What many starts at values all over the parameter's range settle on is looked at in turn. What lies on no branch so far
is followed, through folds and grazings, and so is all that leaves the branch points and period doublings met; then the
next is looked at.
"""

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from continuation.limits import EXPIRED, limits_of

from ..flight.wall_positions import fit
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..problem.end import End
from ..problem.orbit_on_branch import place_orbit
from ..problem.orbit_start import point_of
from ..scene import check
from ..scene.parameters import bounds_of, domain
from ..scene.scene import Scene
from ..scene.state import State
from ..scene.symmetry import stays_symmetric
from ..scene.unit_slips import require_scene_units
from .branch_tree import Tree
from .diagram import Diagram
from .follow import check_settings, through
from .on_branch import is_on, settled_at
from .seed_orbits import free_probes, probes
from .switch import FIRST

MOST = 400  # branches, where no budget is given
SAME = 1e-12  # of a soft wall's numbers: as near is rounding
DONE = "all that was found has been followed"
SPENT = "the budget of {} branches is spent"


@check.host("use strobe or monodromy")
def explore(
    scene: Scene,
    name: str,
    bounds: tuple[float, float],
    max_period: int = 8,
    seed: int = 0,
    budget: int | None = None,
    resume: Diagram | None = None,
    largest_step: float = 0.1,
    progress: Callable[[int], object] | None = None,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
) -> Diagram:
    """The periodic orbits of a scene along a parameter: a `Diagram`.

    scene: a single one; name, bounds: as in `follow`; the scene's own value of the parameter does not matter.
    max_period: drive periods of the longest orbits that are looked for and that a period doubling is followed to;
    seed: of the random starts. budget: it stops when there are as many branches, those of one point being found
    together; None is 400. resume: a `Diagram` that stopped at its budget, of the same scene, parameter and settings, to
    go on from. progress: called with the number of branches so far. max_points: largest number of points of each
    branch; max_seconds: wall-clock time, s, after which the diagram is returned as far as it is known; it can be
    resumed. None is no limit. The last branch may then end where the time was over; a resumed run follows it anew.

    Every attractor that one of 256 starts settles on is on a branch, and the motion that meets no wall, where there is
    one. What lies on no branch that leaves these is not found: an isolated unstable orbit (`find_isolas` looks for
    closed branches of these), or one that only meets them at a grazing, where a branch goes on with one other;
    `Special.meets` has all, and `switch` follows them. In a symmetric scene a branch comes with its mirror image. The
    same arguments give the same diagram.

    Raises ArgumentError for arguments that cannot be.
    """
    limits = limits_of(max_points, max_seconds, None, check.ArgumentError)
    task = check_arguments(scene, name, bounds, max_period, seed, budget, largest_step)
    task = task._replace(steps=task.steps | {"limits": limits})
    before = _resumed(resume, task)
    (some,) = settled_on([task])
    return explore_on(task, some, progress, *before)


class Search(NamedTuple):
    """What is to be explored. scene: at a value within the bounds; most: branches; steps, settings: by name."""

    scene: Scene
    name: str
    bounds: tuple[float, float]
    most: int
    steps: dict[str, Any]
    settings: dict[str, int | float]


def check_arguments(scene, name, bounds, max_period, seed, budget, largest_step):
    """The `Search` of these arguments. Raises ArgumentError."""
    check.require_single(scene)
    max_period, seed = check.whole("max_period", max_period, 1), check.whole("seed", seed, 0)
    if max_period > check.MOST_PERIODS:
        raise check.ArgumentError("max_period", f"must be at most {check.MOST_PERIODS}", max_period)
    most = MOST if budget is None else check.whole("budget", budget, 1)
    check.require_known(name, scene.names, name)
    if np.shape(bounds) == (2,):
        require_scene_units("bounds", scene, name, bounds)
    scene = scene.replace(**{name: _inside(scene, name, bounds)})
    bounds = bounds_of(scene, name, bounds)
    steps = check_settings(FIRST, largest_step, 1e-10, (), ())
    settings = {"max_period": max_period, "seed": seed, "largest_step": largest_step}
    return Search(scene, name, bounds, most, steps, settings)


def settled_on(tasks):
    """What the starts of `Search`s that differ in their scenes settle on, the `Probe`s of each."""
    one = tasks[0]
    return probes(
        [each.scene for each in tasks], one.name, one.bounds, one.settings["max_period"], one.settings["seed"]
    )


def explore_on(task, some, progress=None, found=(), done=()):
    """The `Diagram` of a task and what its starts settle on; found, done: its branches so far, and points left."""
    scene, name, bounds, most, steps, settings = task
    symmetric = stays_symmetric(scene, name)
    tree = Tree(bounds, settings["max_period"], most, steps, list(found), list(done), symmetric, progress)
    tree.grow()
    for probe in chain(some, free_probes(scene, name, bounds)):
        if tree.is_spent:
            break
        if not any(is_on(probe, branch) for branch in tree.found):
            _begin(tree, probe, scene, name, bounds, steps)
    told = SPENT.format(most) if len(tree.found) >= most else EXPIRED if tree.is_spent else DONE
    return Diagram(name, bounds, scene, tuple(tree.found), tuple(tree.done), not tree.is_spent, told, settings)


def _begin(tree, probe, scene, name, bounds, steps):
    """Follows the orbit that a probe settled on, and all that leaves it."""
    if probe.endless:
        probe = _with_hops(probe, scene, name)
    found = probe and settled_at(probe, *place_orbit(scene, name, probe.spot))
    if found is None:  # it had not settled
        return
    branch = through(scene.replace(**{name: probe.spot.value}), name, bounds, found, "both", steps)
    if tree.found and End.MAX_SECONDS in branch.ends:
        return  # the next run follows it anew
    if not tree.has(branch):
        tree.add(branch)
        tree.grow()


def _with_hops(probe, scene, name):
    """An endless probe with the impacts and releases of its orbit, None where it is none, or never leaves its wall."""
    spot = probe.spot
    there = scene.replace(**{name: spot.value})
    try:
        orbit = find_orbit(there, fit(there, State(spot.x, spot.v)), periods=spot.periods, settle=0)
        return probe._replace(spot=point_of(orbit, spot.value)) if orbit.periods == spot.periods else None
    except OrbitError:
        return None


def _inside(scene, name, bounds):
    """A value within the bounds and the parameter's domain."""
    value = float(scene.parameter(name))
    if np.shape(bounds) != (2,) or not np.isfinite(bounds).all() or not bounds[0] < bounds[1]:
        return value  # `bounds_of` tells
    low, high = np.clip(domain(scene, name), *bounds)
    return value if low <= value <= high else 0.5 * (low + high)


def _resumed(resume, task):
    """(branches, points left) of a `Diagram` to go on from, empty where there is none."""
    if resume is None:
        return (), ()
    if not isinstance(resume, Diagram):
        raise check.ArgumentError("resume", "must be a Diagram", resume)
    same = (resume.name, resume.bounds, resume.settings) == (task.name, task.bounds, task.settings)
    if not same or not _is_alike(task.scene, resume.scene, task.name):
        raise check.ArgumentError("resume", "must be of the same scene, parameter, bounds and settings", resume)
    whole = resume.branches
    while whole and End.MAX_SECONDS in whole[-1].ends:
        whole = whole[:-1]
    return whole, tuple((k, j) for k, j in resume.left if k < len(whole))


def _is_alike(scene, other, name):
    """Whether two scenes differ in nothing but a parameter."""
    if scene.names != other.names:
        return False
    near = 0.0
    if name == "hardness":  # the walls' numbers follow from it, but for rounding
        scene, near = scene.replace(hardness=other.parameter(name)), SAME
    pairs = [(float(scene.parameter(key)), float(other.parameter(key))) for key in scene.names if key != name]
    return all(abs(one - two) <= near * abs(two) for one, two in pairs)
