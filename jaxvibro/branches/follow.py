"""Continue periodic orbits along one parameter, through folds and grazings."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, overload

import numpy as np

from continuation.arclength import make_control, make_start_point
from continuation.branch_segment import UNLIMITED, make_limits
from continuation.continuation_loop import ContinuationTask

from ..orbits.orbit import Orbit, OrbitError
from ..problem.curve_ends import End
from ..problem.orbit_point import problem_of_orbit
from ..scene import check
from ..scene.scene_parameters import check_parameter_bounds, limit_bounds_to_domains
from . import held_continuation as holding
from .assemble import START_REASON, assemble_branch
from .branch import KIND_NAMES, Branch
from .held_branch import HeldBranch
from .itinerary_segment import BranchEventDetector, continue_through_grazings
from .user_monitors import MonitoredPoint

DIRECTIONS = ("both", "forward", "backward")
MAX_START_RESIDUAL = 1e-6  # relative to the scene's length; a start with a larger residual is rejected
Monitors = Mapping[str, Callable[[MonitoredPoint], Any]] | tuple[()]  # keys are labels


@overload
def follow(
    orbit: Orbit,
    name: str,
    bounds: tuple[float, float],
    direction: str = ...,
    first_step: float = ...,
    largest_step: float = ...,
    tolerance: float = ...,
    monitors: Monitors = ...,
    stop: str | Sequence[str] = ...,
    *,
    max_points: int | None = ...,
    max_seconds: float | None = ...,
    progress: Callable[[int], object] | None = ...,
) -> Branch: ...
@overload
def follow(
    orbit: Orbit,
    name: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    direction: str = ...,
    first_step: float = ...,
    largest_step: float = ...,
    tolerance: float = ...,
    *,
    hold: Mapping[str, float],
    max_points: int | None = ...,
    max_seconds: float | None = ...,
    progress: Callable[[int], object] | None = ...,
) -> HeldBranch: ...
@check.host_only("use strobe or monodromy; located has derivatives of special points")
def follow(
    orbit: Orbit,
    name: str | Sequence[str],
    bounds: tuple[float, float] | Mapping[str, tuple[float, float]],
    direction: str = "both",
    first_step: float = 0.05,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    hold: Mapping[str, float] | None = None,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Branch | HeldBranch:
    """Continue a periodic orbit in one parameter.

    The branch of periodic orbits through `orbit` is followed by pseudo-arclength continuation, through folds and
    grazings. Special points are located to rounding.

    Parameters
    ----------
    orbit : Orbit
        Starting orbit, stable or unstable.
    name : str or sequence of str
        Continuation parameter, for example ``"amplitude"`` or ``"right.restitution"``. A pair of names with `hold`.
    bounds : tuple of float or dict
        Lower and upper bound of the parameter. With `hold`, bounds of both parameters, ``{name: (low, high)}``.
    direction : {"both", "forward", "backward"}, optional
        ``"forward"`` starts towards greater values, ``"backward"`` towards smaller values. With `hold` the direction
        is that of the second parameter.
    first_step : float, optional
        First step along the branch. Step lengths combine times, speeds and parameter as a root mean square over the
        impacts, in the units of the scene (``1/w0``; the distance of the farther wall).
    largest_step : float, optional
        Largest step, in the same units.
    tolerance : float, optional
        Tolerance of Newton's method, in the same units. Special points are always located to rounding.
    monitors : dict of str to callable, optional
        User-defined test functions by label. A special point with this label is located where the value of the function
        changes sign. The function takes a record with ``value``, ``times``, ``speeds`` and ``sides`` (one entry per
        impact, none on P100; the magnitude of the side is 1 for an impact, and 2 or 3 for a release), ``x`` and ``v``
        (one entry per drive period), ``multipliers`` and ``clearance``.
    stop : str or sequence of str, optional
        Kinds of special point, or labels of monitors, at which the branch ends.
    hold : dict of str to float, optional
        ``{"peak": value}`` (largest ``|x|``) or ``{"least_speed": value}`` (speed of the slowest impact). Follows the
        orbits that share this value along two parameters. The start is the orbit with this value that is nearest to
        `orbit` along the first parameter, at the scene's value of the second parameter.
    max_points : int, optional
        Largest number of points. The two directions share it: the first takes at most half. None is no limit.
    max_seconds : float, optional
        Largest wall-clock time in s, checked between groups of steps. A compilation in progress is completed. None is
        no limit.
    progress : callable, optional
        Called with the number of points computed.

    Returns
    -------
    Branch or HeldBranch
        The branch with its special points, or a `HeldBranch` if `hold` is given.

    Raises
    ------
    ArgumentError
        If an argument is invalid.
    OrbitError
        If the start is not an orbit, if its mass never leaves the wall, or if its equations are singular.
    ArithmeticError
        If a special point is found that the scene cannot have.

    Warns
    -----
    SlowProgressWarning
        If many grazings lie at nearly one value of the parameter.

    See Also
    --------
    follow_all : Continue several periodic orbits.
    extend : Continue a branch beyond its ends.
    switch : Follow the branches that emanate from a special point.

    Notes
    -----
    The unknowns are the times and speeds of the impacts, and the parameter. The Jacobian of their equations locates
    saddle-nodes (SN), symmetry breakings and other branch points (SB, BP), and period doublings (PD). At a grazing (GR)
    an impact is added or removed and the branch continues if orbits exist. Under a force that is not proved to be
    dissipative, Neimark-Sacker points (NS) and neutral saddles (NSA) are located too. If areas are preserved, as
    without damping at restitution 1, the resonances 1:3 and 1:4 (R3, R4) are located. Orbits that stick are followed
    from release to release, past complete chatter (CH) and releases inside a sticking phase (RL). Every point is
    checked against the walls.

    The columns of ``Branch.data`` are the parameter; ``time``, ``speed`` and ``side`` of each impact; ``x`` and ``v``
    at phase 0 of each period; ``multiplier_real`` and ``multiplier_imag``; ``stable``; ``least_speed``;
    ``least_clearance``; ``residual``; ``time_slope``, ``speed_slope`` and ``value_slope``, the entries of the unit
    tangent; ``segment``.

    ``Branch.reason`` gives the reasons for the ends. A limit that is reached ends the branch, and `extend` resumes it.

    A `HeldBranch` has the same columns and no special points. It ends at a grazing, and has no monitors and stops.

    Examples
    --------
    >>> branch = jv.follow(orbit, "amplitude", bounds=(0.0, 6.0))
    >>> branch.name, branch.special[1].kind
    ('amplitude', 'GR')
    >>> held = jv.follow(
    ...     orbit, ("amplitude", "frequency"), {"amplitude": (1.5, 2.5), "frequency": (2.05, 2.15)},
    ...     hold={"least_speed": 1.9},
    ... )
    >>> held.held, held.value
    ('least_speed', 1.9)
    """
    settings = _check_branch_settings(direction, first_step, largest_step, tolerance, monitors, stop)
    settings["limits"] = make_limits(max_points, max_seconds, progress, check.ArgumentError)
    if hold is not None:
        return _follow_held_branch(orbit, name, bounds, direction, settings, hold)
    bounds, start = _check_bounds_and_start("orbit", orbit, name, bounds)
    return branch_through(orbit.scene, name, bounds, start, direction, settings)


def _follow_held_branch(orbit, names, bounds, direction, settings, hold):
    """Follow the `HeldBranch` of an orbit. Raises ArgumentError, OrbitError."""
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError("orbit", "must be an Orbit, as find_orbit returns", orbit)
    if settings["monitors"] or settings["stop"]:
        raise check.ArgumentError("monitors", "must be empty if `hold` is given, and so must `stop`", "both")
    names, bounds, quantity_name, value = holding.check_held_arguments(orbit.scene, names, bounds, hold)
    problem_and_z, scene = polish_orbit(orbit, names[0]), orbit.scene
    held_start = holding.locate_held_start(scene, names, quantity_name, value, *problem_and_z)
    if held_start is None:
        branch = branch_through(scene, names[0], bounds[names[0]], problem_and_z, "both", settings)
        candidate_starts = (
            holding.locate_held_start(scene, names, quantity_name, value, *candidate)
            for candidate in holding.orbits_near_value(branch, quantity_name, value)
        )
        held_start = next((candidate for candidate in candidate_starts if candidate is not None), None)
        if held_start is None:
            raise holding.unreachable_value_error(branch, quantity_name, value)
    return holding.follow_held_branch(scene, names, bounds, quantity_name, value, held_start, direction, settings)


@check.host_only("use strobe or monodromy; located has derivatives of special points")
def follow_all(
    orbits: Sequence[Orbit],
    name: str,
    bounds: tuple[float, float],
    direction: str = "both",
    first_step: float = 0.05,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Branch, ...]:
    """Continue several periodic orbits in one parameter.

    Parameters
    ----------
    orbits : sequence of Orbit
        Starting orbits, at least one, of one scene or of several. Two orbits on one branch give this branch twice.
    name : str
        Continuation parameter.
    bounds : tuple of float
        Lower and upper bound of the parameter.
    direction : {"both", "forward", "backward"}, optional
        Direction of the start, as in `follow`.
    first_step : float, optional
        First step along each branch.
    largest_step : float, optional
        Largest step.
    tolerance : float, optional
        Tolerance of Newton's method.
    monitors : dict of str to callable, optional
        User-defined test functions, as in `follow`.
    stop : str or sequence of str, optional
        Kinds of special point at which a branch ends.
    max_points : int, optional
        Largest number of points of each branch.
    max_seconds : float, optional
        Largest wall-clock time of all branches, in s. Branches not started by then are omitted, and the tuple is
        shorter.
    progress : callable, optional
        Called with the number of points computed.

    Returns
    -------
    tuple of Branch
        One branch per orbit.

    Raises
    ------
    ArgumentError
        If an argument is invalid.
    OrbitError
        If a start is not an orbit. All orbits are checked before any is followed; a note gives the index.
    ArithmeticError
        If a special point is found that the scene cannot have.

    See Also
    --------
    follow : Continue one periodic orbit.

    Examples
    --------
    >>> branches = jv.follow_all([orbit], "amplitude", bounds=(0.0, 6.0))
    >>> len(branches), branches[0].special[1].kind
    (1, 'GR')
    """
    settings = _check_branch_settings(direction, first_step, largest_step, tolerance, monitors, stop)
    settings["limits"] = make_limits(max_points, max_seconds, progress, check.ArgumentError)
    if not isinstance(orbits, Sequence) or not orbits:
        raise check.ArgumentError("orbits", "must be a list or tuple of at least one Orbit", orbits)
    bounds_and_starts = []
    for k, orbit in enumerate(orbits):
        try:
            bounds_and_starts.append(_check_bounds_and_start(f"orbits[{k}]", orbit, name, bounds))
        except OrbitError as error:
            error.add_note(f"raised for orbits[{k}]")
            raise
    orbits_and_starts, branches = zip(orbits, bounds_and_starts, strict=True), []
    for start_orbit, (bounds, start) in orbits_and_starts:
        branches.append(branch_through(start_orbit.scene, name, bounds, start, direction, settings))
        if settings["limits"].expired:
            break
    return tuple(branches)


def _check_branch_settings(direction, *settings):
    """Return the settings of a branch by name, checked together with its direction. Raises ArgumentError."""
    if direction not in DIRECTIONS:
        raise check.ArgumentError("direction", f"must be one of {', '.join(DIRECTIONS)}", direction)
    return check_follow_settings(*settings)


def _check_bounds_and_start(argument_name, orbit, name, bounds):
    """Return the bounds and the start for `branch_through`. Raises ArgumentError, OrbitError."""
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError(argument_name, "must be an Orbit, as find_orbit returns", orbit)
    bounds = check_parameter_bounds(orbit.scene, name, bounds)
    return bounds, polish_orbit(orbit, name)


def branch_through(scene, name, bounds, start, direction, settings):
    """Follow the branch through a start at the scene's value of the parameter.

    Parameters
    ----------
    scene : Scene
        Scene at the start.
    name : str
        Continuation parameter.
    bounds : tuple of float
        Lower and upper bound.
    start : tuple
        `OrbitProblem` and unknowns z of the start.
    direction : {"both", "forward", "backward"}
        Direction of the start.
    settings : dict
        Settings from `check_follow_settings`, optionally with ``limits``.

    Returns
    -------
    Branch
        The branch.
    """
    problem, z = start
    task = make_branch_task(scene, name, bounds, problem, start, **settings)
    forward_tangent, start_reason, limits = problem.tangent(z), START_REASON, task.limits
    forward_limits = limits.half_points() if direction == "both" else limits
    forward = (
        continue_through_grazings(task._replace(limits=forward_limits), make_start_point(z, forward_tangent))
        if direction != "backward"
        else None
    )
    is_closed = forward is not None and forward[1].end is End.CLOSED
    if forward is not None and direction == "both" and not is_closed:
        limits = limits.after_points(sum(len(segment.points.z) for segment in forward[0]) - 1)  # the start counts once
        if limits.is_reached(1):
            is_closed, end_kind = True, End.MAX_SECONDS if limits.expired else End.MAX_POINTS
            start_reason = end_kind.reason(z[-1])
    backward = (
        continue_through_grazings(task._replace(limits=limits), make_start_point(z, -forward_tangent))
        if direction != "forward" and not is_closed
        else None
    )
    return assemble_branch(scene, name, bounds, settings, backward, forward, start_reason)


def make_branch_task(
    scene,
    name,
    bounds,
    problem,
    closing_orbit,
    first_step,
    largest_step,
    tolerance,
    monitors,
    stop,
    limits=UNLIMITED,
):
    """Make the `ContinuationTask` of a branch.

    Parameters
    ----------
    scene : Scene
        Scene.
    name : str
        Parameter of the branch.
    bounds : tuple of float
        Bounds of the parameter.
    problem : OrbitProblem
        Problem of the first orbits; `continue_through_grazings` replaces it at each grazing.
    closing_orbit : tuple
        Problem and unknowns of an orbit. The branch is closed if it reaches this orbit again.
    first_step, largest_step, tolerance, monitors, stop
        As `check_follow_settings` returns them.
    limits : Limits, optional
        Limits of points and time.

    Returns
    -------
    ContinuationTask
        The task.
    """
    bounds_in_domain, domain_ends = limit_bounds_to_domains(scene, [name], [bounds])
    return ContinuationTask(
        problem.equations,
        problem,
        make_control(problem.weights(), first_step, largest_step, tolerance, bounds_in_domain[0]),
        min(first_step, largest_step),
        bounds_in_domain,
        domain_ends,
        BranchEventDetector(problem, monitors),
        stop,
        (closing_orbit,) if closing_orbit[0].n_rows else (),
        limits,
    )


def polish_orbit(orbit, name):
    """Return the equations and the corrected unknowns of an orbit at its own parameter value.

    Parameters
    ----------
    orbit : Orbit
        Orbit.
    name : str
        Continuation parameter.

    Returns
    -------
    problem : OrbitProblem
        Problem of the orbit.
    z : ndarray
        Unknowns, corrected by Newton's method if it converges.

    Raises
    ------
    OrbitError
        If the residual is too large.
    """
    value = float(orbit.scene.parameter(name))
    problem, z = problem_of_orbit(orbit, name)
    residual = float(abs(problem.evaluate(z)[0]).max())
    if not residual < MAX_START_RESIDUAL * problem.length_scale:
        raise OrbitError("the start is not an orbit", residual, "use an Orbit from find_orbit with its own scene")
    point = problem.solve_at(z, -1, value, 1.0)
    return problem, point.z if point.converged else z


def check_follow_settings(first_step, largest_step, tolerance, monitors, stop):
    """Check the settings of a branch.

    Parameters
    ----------
    first_step, largest_step, tolerance : float
        Steps and tolerance. Must be positive.
    monitors : dict of str to callable
        User-defined test functions.
    stop : str or sequence of str
        Kinds of special point at which the branch ends.

    Returns
    -------
    dict
        Settings by name.

    Raises
    ------
    ArgumentError
        If a setting is invalid.
    """
    settings = {"first_step": first_step, "largest_step": largest_step, "tolerance": tolerance}
    for key, value in settings.items():
        if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0):
            raise check.ArgumentError(key, "must be a positive number", value)
    try:
        monitors = dict(monitors)
    except (TypeError, ValueError):
        raise check.ArgumentError("monitors", "must map labels to functions, {label: function}", monitors) from None
    for label, monitor in monitors.items():
        if not callable(monitor):
            raise check.ArgumentError(f"monitors.{label}", "must be a function of a point", monitor)
    stop = check.make_name_tuple("stop", () if stop is None else stop)
    for label in stop:
        if label not in (known_kinds := (*KIND_NAMES, *monitors)):
            raise check.ArgumentError(
                "stop",
                f"must be kinds of special point or labels of monitors{check.describe_choices(label, known_kinds)}",
                label,
            )
    return settings | {"monitors": monitors, "stop": stop}
