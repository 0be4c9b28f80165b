"""Explore the periodic orbits of a scene along a parameter.

Random starts at values over the whole range of the parameter settle on attractors. Each attractor that lies on no known
branch is followed through folds and grazings, together with all branches that emanate from its branch points and period
doublings. Then the next attractor is examined.
"""

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from continuation.branch_segment import EXPIRED_REASON, make_limits

from ..flight.wall_positions import adapt_to_moved_walls
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..problem.curve_ends import End
from ..problem.orbit_point import problem_of_orbit
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_parameters import check_parameter_bounds, parameter_domain, require_scene_units
from ..scene.scene_properties import stays_symmetric
from ..scene.state import State
from .branch_tree import BranchTree
from .diagram import Diagram
from .follow import branch_through, check_follow_settings
from .seed_orbits import correct_to_seed_orbit, find_seed_orbits, free_seed_orbits, is_on_branch
from .switch import FIRST_STEP

MAX_BRANCHES = 400  # if no budget is given
ROUNDING_TOLERANCE = 1e-12  # relative, for the parameters of soft walls
COMPLETE_REASON = "all that was found has been followed"
BUDGET_REASON = "the budget of {} branches is spent"


@check.host_only("use strobe or monodromy")
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
    """Explore the periodic orbits of a scene along a parameter.

    Parameters
    ----------
    scene : Scene
        A single scene. Its own value of the parameter is ignored.
    name : str
        Continuation parameter.
    bounds : tuple of float
        Lower and upper bound of the parameter.
    max_period : int, optional
        Largest number of drive periods of an orbit, at most 32. The limit applies to the search for attractors and to
        the orbits followed from period doublings.
    seed : int, optional
        Seed of the random starts.
    budget : int, optional
        Number of branches at which the exploration stops, after all branches of a special point. None means 400.
    resume : Diagram, optional
        Incomplete diagram to continue, of the same scene, parameter, bounds and settings.
    largest_step : float, optional
        Largest continuation step, as in `follow`.
    progress : callable, optional
        Called with the number of branches.
    max_points : int, optional
        Largest number of points of each branch. None is no limit.
    max_seconds : float, optional
        Wall-clock time in s after which the incomplete diagram is returned, which can be resumed. If the limit is
        reached during the continuation of the first branch, this branch ends early. Unfinished later branches are
        omitted. A resumed run follows unfinished branches again. None is no limit.

    Returns
    -------
    Diagram
        Branches and special points.

    Raises
    ------
    ArgumentError
        If an argument is invalid.

    See Also
    --------
    find_isolas : Find closed branches that `explore` misses.
    follow : Continue a periodic orbit in one parameter.

    Notes
    -----
    The branches of a complete diagram contain every periodic attractor on which one of 256 starts settles, and the
    motion without impacts if it exists. Two kinds of branches are missed if no start settles on them: isolated branches
    (see `find_isolas`), and branches that meet the others only at a grazing. At a grazing a branch continues along one
    other branch. ``Special.meets`` lists the orbits of all branches at the grazing, and `switch` follows these
    branches. In a symmetric scene each branch comes with its mirror image. Equal arguments give equal diagrams if no
    time limit is reached.

    Examples
    --------
    >>> diagram = jv.explore(scene, "amplitude", (1.8, 2.2), max_period=1, budget=1)
    >>> len(diagram), diagram.branches[0].segments[0].label
    (1, 'P111')
    """
    limits = make_limits(max_points, max_seconds, None, check.ArgumentError)
    request = make_exploration_request(scene, name, bounds, max_period, seed, budget, largest_step)
    request = request._replace(step_settings=request.step_settings | {"limits": limits})
    resumed_exploration = _resumed_exploration(resume, request)
    (seed_orbits,) = seed_orbits_of_requests([request])
    return run_exploration(request, seed_orbits, progress, *resumed_exploration)


class ExplorationRequest(NamedTuple):
    """Request for an exploration.

    Attributes
    ----------
    scene : Scene
        Scene at a parameter value within the bounds.
    name : str
        Continuation parameter.
    bounds : tuple of float
        Bounds of the parameter.
    max_branches : int
        Number of branches at which the exploration stops, after all branches of a special point.
    step_settings : dict
        Settings of the continuation.
    settings : dict
        Settings that the diagram records.
    """

    scene: Scene
    name: str
    bounds: tuple[float, float]
    max_branches: int
    step_settings: dict[str, Any]
    settings: dict[str, int | float]


def make_exploration_request(scene, name, bounds, max_period, seed, branch_budget, largest_step):
    """Check the arguments of `explore` and make an `ExplorationRequest`. Raises ArgumentError."""
    check.require_single_scene(scene)
    max_period, seed = check.check_whole_number("max_period", max_period, 1), check.check_whole_number("seed", seed, 0)
    if max_period > check.MAX_ORBIT_PERIODS:
        raise check.ArgumentError("max_period", f"must be at most {check.MAX_ORBIT_PERIODS}", max_period)
    max_branches = MAX_BRANCHES if branch_budget is None else check.check_whole_number("budget", branch_budget, 1)
    check.require_parameter(name, scene.names, name)
    if np.shape(bounds) == (2,):
        require_scene_units("bounds", scene, name, bounds)
    scene = scene.replace(**{name: _value_or_bounds_middle(scene, name, bounds)})
    bounds = check_parameter_bounds(scene, name, bounds)
    step_settings = check_follow_settings(FIRST_STEP, largest_step, 1e-10, (), ())
    settings = {"max_period": max_period, "seed": seed, "largest_step": largest_step}
    return ExplorationRequest(scene, name, bounds, max_branches, step_settings, settings)


def seed_orbits_of_requests(requests):
    """Return the `SeedOrbit` list of each request; the requests differ only in their scenes."""
    first_request = requests[0]
    return find_seed_orbits(
        [request.scene for request in requests],
        first_request.name,
        first_request.bounds,
        first_request.settings["max_period"],
        first_request.settings["seed"],
    )


def run_exploration(request, seed_orbits, progress=None, known_branches=(), processed_indices=()):
    """Run the exploration of a request and return its `Diagram`.

    `known_branches` and `processed_indices` are those of a diagram to continue.
    """
    scene, name, bounds, max_branches, step_settings, settings = request
    symmetric = stays_symmetric(scene, name)
    tree = BranchTree(
        bounds,
        settings["max_period"],
        max_branches,
        step_settings,
        list(known_branches),
        list(processed_indices),
        symmetric,
        progress,
    )
    tree.follow_special_points()
    for seed_orbit in chain(seed_orbits, free_seed_orbits(scene, name, bounds)):
        if tree.has_reached_limit:
            break
        if not any(is_on_branch(seed_orbit, branch) for branch in tree.branches):
            _follow_seed_orbit(tree, seed_orbit, scene, name, bounds, step_settings)
    reason = (
        BUDGET_REASON.format(max_branches)
        if len(tree.branches) >= max_branches
        else EXPIRED_REASON
        if tree.has_reached_limit
        else COMPLETE_REASON
    )
    return Diagram(
        name,
        bounds,
        scene,
        tuple(tree.branches),
        tuple(tree.processed_indices),
        not tree.has_reached_limit,
        reason,
        settings,
    )


def _follow_seed_orbit(tree, seed_orbit, scene, name, bounds, step_settings):
    """Follow a seed orbit and all branches that emanate from its branch."""
    if seed_orbit.may_stick:
        seed_orbit = _add_chatter_impacts(seed_orbit, scene, name)
    start = seed_orbit and correct_to_seed_orbit(seed_orbit, seed_orbit.point.problem, seed_orbit.point.z)
    if start is None:  # the start had not settled
        return
    branch = branch_through(scene.replace(**{name: seed_orbit.point.value}), name, bounds, start, "both", step_settings)
    if tree.branches and End.MAX_SECONDS in branch.ends:
        return  # the next run follows it again
    if not tree.contains(branch):
        tree.add(branch)
        tree.follow_special_points()


def _add_chatter_impacts(seed_orbit, scene, name):
    """Add impacts and releases to a seed orbit with chatter.

    Returns None if the simulation finds no periodic orbit with the number of periods of the
    seed orbit, or if the mass never leaves the
    wall.
    """
    point = seed_orbit.point
    scene_at_value = scene.replace(**{name: point.value})
    try:
        orbit = find_orbit(
            scene_at_value,
            adapt_to_moved_walls(scene_at_value, State(point.x, point.v)),
            periods=point.periods,
            settle=0,
        )
        if orbit.periods != point.periods:
            return None
        problem, z = problem_of_orbit(orbit, name)
        return seed_orbit._replace(point=point._replace(problem=problem, z=z))
    except OrbitError:
        return None


def _value_or_bounds_middle(scene, name, bounds):
    """Return the scene's value of the parameter if within bounds and domain, else the middle of their intersection."""
    value = float(scene.parameter(name))
    if np.shape(bounds) != (2,) or not np.isfinite(bounds).all() or not bounds[0] < bounds[1]:
        return value  # `check_parameter_bounds` raises the error
    lower, upper = np.clip(parameter_domain(scene, name), *bounds)
    return value if lower <= value <= upper else 0.5 * (lower + upper)


def _resumed_exploration(resume, request):
    """Return the branches and the processed points of a `Diagram` to continue."""
    if resume is None:
        return (), ()
    if not isinstance(resume, Diagram):
        raise check.ArgumentError("resume", "must be a Diagram", resume)
    has_same_settings = (resume.name, resume.bounds, resume.settings) == (
        request.name,
        request.bounds,
        request.settings,
    )
    if not has_same_settings or not _is_same_scene(request.scene, resume.scene, request.name):
        raise check.ArgumentError("resume", "must have the same scene, parameter, bounds and settings", resume)
    complete_branches = resume.branches
    while complete_branches and End.MAX_SECONDS in complete_branches[-1].ends:
        complete_branches = complete_branches[:-1]
    return complete_branches, tuple(
        (branch_index, point_index)
        for branch_index, point_index in resume.left
        if branch_index < len(complete_branches)
    )


def _is_same_scene(scene, other_scene, excluded_name):
    """Test whether two scenes are equal except for one parameter."""
    if scene.names != other_scene.names:
        return False
    tolerance = 0.0
    if excluded_name == "hardness":  # it determines the parameters of the walls up to rounding
        scene, tolerance = scene.replace(hardness=other_scene.parameter(excluded_name)), ROUNDING_TOLERANCE
    value_pairs = [
        (float(scene.parameter(key)), float(other_scene.parameter(key))) for key in scene.names if key != excluded_name
    ]
    return all(abs(value - other_value) <= tolerance * abs(other_value) for value, other_value in value_pairs)
