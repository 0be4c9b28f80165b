"""Find isolas: closed branches that are not connected to other branches.

At values over the whole range of the parameter the equations of the impacts are solved for each order of walls, by
Newton's method from random guesses, with deflation of known solutions (`orbits/solve.py`). Each solution that lies
on no known branch is followed. The branches that return to their start are isolas.
"""

from collections.abc import Callable
from itertools import product

import jax
import numpy as np

from continuation.branch_segment import EXPIRED_REASON, Results, make_limits

from ..maps.initial_conditions import initial_box
from ..orbits.impact_equations import ImpactSequence
from ..orbits.orbit import repetition_count
from ..orbits.solve import solve_with_deflation
from ..problem.curve_ends import End
from ..problem.orbit_equations import diagnose
from ..problem.orbit_point import comparison_points, make_orbit_point
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from ..scene.scene_parameters import parameter_domain
from ..scene.scene_properties import stays_symmetric
from .branch import Branch
from .branch_tree import MAX_BRANCHES, BranchTree
from .diagram import Diagram
from .follow import branch_through, check_follow_settings
from .seed_orbits import SeedOrbit, correct_to_seed_orbit, is_on_branch
from .switch import FIRST_STEP

N_VALUES, N_GUESSES = 256, 2  # values of the parameter; guesses at each value
IMPACT_TOLERANCE = 1e-6  # relative to the largest speed; closer impacts are identical
MAX_IMPACTS = 32


@check.host_only("use strobe or monodromy")
def find_isolas(
    diagram: Diagram,
    max_period: int = 4,
    max_impacts: int = 4,
    seed: int = 0,
    progress: Callable[[int], object] | None = None,
    *,
    max_seconds: float | None = None,
) -> Results[Branch]:
    """Find closed branches of a scene that are not in a diagram.

    Parameters
    ----------
    diagram : Diagram
        Diagram from `explore`. Its scene, parameter and bounds are used.
    max_period : int, optional
        Largest number of drive periods of the orbits, at most 32.
    max_impacts : int, optional
        Largest number of impacts of the orbits, at most 32.
    seed : int, optional
        Seed of the guesses.
    progress : callable, optional
        Called with the number of completed orders of walls.
    max_seconds : float, optional
        Wall-clock time in s after which the isolas located by then are returned. None is no limit.

    Returns
    -------
    tuple of Branch
        The isolas. The attribute ``stopped`` of the tuple is empty, or states that the time limit was reached.

    Raises
    ------
    ArgumentError
        If an argument is invalid.

    See Also
    --------
    explore : Explore the periodic orbits of a scene along a parameter.
    switch : Follow the branches that emanate from a special point.

    Notes
    -----
    The equations of each order of walls are solved at 256 values of the parameter, from two random guesses at each
    value. An isola is usually found if its width is at least a few hundredths of the distance between the bounds;
    narrower isolas may be missed. Orbits that stick are not searched for. A branch that returns to its first orbit
    through grazings is closed as well. In a symmetric scene the mirror image of each isola is included. `switch`
    follows the branches that emanate from an isola.

    Examples
    --------
    >>> diagram = jv.explore(scene, "amplitude", (1.8, 2.2), max_period=1, budget=1)
    >>> isolas = jv.find_isolas(diagram, max_period=1, max_impacts=1)
    >>> isolas, isolas.stopped
    ((), '')
    """
    limits = make_limits(None, max_seconds, None, check.ArgumentError)
    if not isinstance(diagram, Diagram):
        raise check.ArgumentError("diagram", "must be a Diagram, as explore returns", diagram)
    period_limit, impact_limit = (
        check.check_whole_number("max_period", max_period, 1),
        check.check_whole_number("max_impacts", max_impacts, 1),
    )
    for argument_name, argument, allowed_max in (
        ("max_period", period_limit, check.MAX_ORBIT_PERIODS),
        ("max_impacts", impact_limit, MAX_IMPACTS),
    ):
        if argument > allowed_max:
            raise check.ArgumentError(argument_name, f"must be at most {allowed_max}", argument)
    rng = np.random.default_rng(check.check_whole_number("seed", seed, 0))
    scene, name, bounds = diagram.scene, diagram.name, diagram.bounds
    step_settings = check_follow_settings(FIRST_STEP, diagram.settings["largest_step"], 1e-10, (), ()) | {
        "limits": limits
    }
    known_branches = list(diagram.branches)
    tree = BranchTree(
        bounds,
        period_limit,
        len(known_branches) + MAX_BRANCHES,
        step_settings,
        known_branches,
        [],
        stays_symmetric(scene, name),
        None,
    )
    isolas: list[Branch] = []
    for n_orders, (periods, sides) in enumerate(_wall_orders(scene, period_limit, impact_limit), 1):
        if limits.expired:
            return Results(isolas, f"{EXPIRED_REASON}: {n_orders - 1} orders of walls done")
        for seed_orbit in _solve_wall_order(scene, name, bounds, periods, sides, rng):
            if not tree.has_reached_limit and not any(is_on_branch(seed_orbit, branch) for branch in tree.branches):
                isolas += _isolas_of_seed_orbit(tree, seed_orbit, scene, name, bounds, step_settings)
        if progress is not None:
            progress(n_orders)
    return Results(isolas)


def _isolas_of_seed_orbit(tree, seed_orbit, scene, name, bounds, step_settings):
    """Follow a seed orbit and add its branch to the tree.

    Returns the branch and its mirror image if they are closed, else an empty list.
    """
    start = correct_to_seed_orbit(seed_orbit, seed_orbit.point.problem, seed_orbit.point.z)
    if start is None:
        return []
    branch = branch_through(scene.replace(**{name: seed_orbit.point.value}), name, bounds, start, "both", step_settings)
    if tree.contains(branch):
        return []
    n_branches_before = len(tree.branches)
    tree.add(branch)
    return tree.branches[n_branches_before:] if branch.ends[1] is End.CLOSED else []


def _wall_orders(scene, period_limit, impact_limit):
    """Yield periods and sides of each order of walls, up to cyclic shifts, sorted by periods and number of impacts."""
    available_sides = [side for side, wall in ((-1.0, scene.left), (1.0, scene.right)) if wall is not None]
    for periods in range(1, period_limit + 1):
        for n_impacts in range(1, impact_limit + 1):
            for sides in product(available_sides, repeat=n_impacts):
                if sides == min(sides[k:] + sides[:k] for k in range(n_impacts)):
                    yield periods, np.array(sides)


def _solve_wall_order(scene, name, bounds, periods, sides, rng):
    """Yield the `SeedOrbit` of each orbit with a given order of walls, over the range of the parameter."""
    lower, upper = np.clip(parameter_domain(scene, name), *bounds)
    n_lanes, n_impacts, n_rows = N_VALUES * N_GUESSES, len(sides), max(2, 1 << (len(sides) - 1).bit_length())
    values = np.repeat(lower + (upper - lower) * (np.arange(N_VALUES) + rng.random(N_VALUES)) / N_VALUES, N_GUESSES)
    scenes = scene.replace(**{name: values})
    drive_periods = 2.0 * np.pi / np.broadcast_to(scenes.frequency, n_lanes)
    max_speeds = np.broadcast_to(initial_box(scenes)[2], n_lanes)
    times, speeds, row_sides = np.zeros((3, n_lanes, n_rows))
    times[:, :n_impacts] = np.sort(rng.random((n_lanes, n_impacts)) * periods, axis=1) * drive_periods[:, None]
    speeds[:, :n_impacts], row_sides[:, :n_impacts] = rng.random((n_lanes, n_impacts)) * max_speeds[:, None], sides
    scenes = jax.tree.map(lambda leaf: np.broadcast_to(np.asarray(leaf), n_lanes), scenes)
    sequences = ImpactSequence(times, speeds, row_sides, np.zeros(n_lanes), np.full(n_lanes, float(periods)))
    solved_times, solved_speeds, is_admissible = solve_with_deflation(scenes, sequences, max_speeds)
    template = make_orbit_problem(scene, name, periods=periods)
    for lane, solution_index in zip(*np.nonzero(is_admissible.T), strict=True):
        impact_columns = (
            solved_times[solution_index, lane, :n_impacts],
            solved_speeds[solution_index, lane, :n_impacts],
            sides,
        )
        point = make_orbit_point(template, float(values[lane]), list(zip(*impact_columns, strict=True)), periods)
        if repetition_count(comparison_points(point.problem, point.z), periods, IMPACT_TOLERANCE) == 1:
            diagnostics = diagnose(point.problem, point.z[None])
            x, v = diagnostics.x[0], diagnostics.v[0]
            yield SeedOrbit(point._replace(x=float(x[0]), v=float(v[0])), np.stack([x, v], axis=1))
