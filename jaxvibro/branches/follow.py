"""`follow`, `follow_all`: branches of periodic orbits along a parameter, through folds and grazings."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, overload

import numpy as np

from continuation import augmented_systems
from continuation.arclength import StepControl
from continuation.event_search import unit_tangent
from continuation.intermediate_points import start_point
from continuation.limits import UNLIMITED, limits_of

from ..orbits.orbit import Orbit, OrbitError
from ..problem.end import End
from ..problem.equations import continuation_problem
from ..problem.grazing_contact import arclength_weights
from ..problem.orbit_conversion import correct_to_value, orbit_row_of
from ..problem.orbit_point import set_up_problem
from ..scene import check
from ..scene.parameters import check_bounds, parameter_domain
from ..scene.typical_scales import scene_length
from . import held_continuation as holding
from .assemble import START_REASON, assemble_branch
from .branch import KIND_NAMES, Branch
from .held_branch import HeldBranch
from .segment import BranchSettings
from .through_grazings import continue_through_grazings
from .user_monitors import MonitoredPoint

DIRECTIONS = ("both", "forward", "backward")
MIN_STEP = 1e-8  # step
MAX_START_RESIDUAL = 1e-6  # of the scene's length: a start with as large a residual is no orbit
Monitors = Mapping[str, Callable[[MonitoredPoint], Any]] | tuple[()]  # by their labels


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
    """The branch of periodic orbits through an orbit, along one parameter of its scene: a `Branch`.

    orbit: an `Orbit`, stable or not; name: of the parameter ("amplitude", "right.restitution", ...); bounds: (low,
    high) of it. direction: "forward" begins towards greater values, "backward" towards smaller, "both" does both.
    first_step, largest_step: along the branch, as the length of (times, speeds, parameter), the root mean square over
    the impacts, in the scene's units (1/w0; the distance of the farther wall). tolerance: of Newton's method, such a
    length; special points are always located to rounding. monitors: {label: function}, a special point of that label
    where the function changes its sign; it takes a record with value, times, speeds, sides (an entry an impact, none
    at all on P100, 2 or -2 for a release), x, v (an entry a period), multipliers and clearance. stop: a label or labels
    that end the branch.

    hold: {"peak": value} or {"least_speed": value}, the largest abs x or the slowest impact's speed: the orbits that
    share it, along two parameters, in place of a branch: name is then a pair of names, bounds {name: (low, high)},
    direction of the second. It begins with the orbit of that number nearest to the given one along the first parameter,
    the second being the scene's; it gives a `HeldBranch`, whose data have the same columns, and no special points. It
    ends at a grazing, and takes no monitors and stops.

    max_points, max_seconds: largest number of points of the branch, and wall-clock time, s; None is no limit. The
    points are shared by the two directions: the first takes half of them at most. The time is checked between chunks of
    steps, so that a compilation under way is completed. A limit that is reached ends the branch there: its `reason`
    says so, and `extend` continues it. progress: called with the number of points computed so far. Many points at
    nearly one value of the parameter give a `SlowProgress` warning.

    Unknowns are the impacts' times and speeds, and the parameter, by pseudo-arclength. Located are saddle-nodes (SN),
    symmetry breakings and other branch points (SB, BP), period doublings (PD) from the Jacobian of those equations, and
    grazings (GR): at one the impact is put in or left out and the branch goes on, if orbits do. Under a force that is
    not proved to be dissipative so are Neimark-Sacker points (NS) and neutral saddles (NSA); where areas are kept, as
    without damping at R = 1, the resonances 1:3 and 1:4 (R3, R4). Orbits that rest are followed from release to
    release, past the points where a chatter just ends in rest (CH) or a wall lets go within one (RL). Every point is
    checked to keep to its walls.

    The branch's `data` has a row a point: the parameter, time, speed and side of each impact, x and v at phase 0 of
    each period, multiplier_real and multiplier_imag, stable, least_speed, least_clearance, residual, segment.

    Raises ArgumentError for arguments that cannot be, OrbitError where the start is no orbit, never leaves its wall
    or is singular, ArithmeticError where a special point was found that the scene cannot have (`impossible`). What ends
    a branch is told by its `reason`.
    """
    settings = _check_branch_settings(direction, first_step, largest_step, tolerance, monitors, stop)
    settings["limits"] = limits_of(max_points, max_seconds, progress, check.ArgumentError)
    if hold is not None:
        return _follow_held(orbit, name, bounds, direction, settings, hold)
    bounds, start = _check_start("orbit", orbit, name, bounds)
    return branch_through(orbit.scene, name, bounds, start, direction, settings)


def _follow_held(orbit, names, bounds, direction, settings, hold):
    """The `HeldBranch` of an orbit. Raises ArgumentError, OrbitError."""
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError("orbit", "must be an Orbit, as find_orbit gives it", orbit)
    if settings["monitors"] or settings["stop"]:
        raise check.ArgumentError("monitors", "must be none, and no stops, where a number is held", "both")
    names, bounds, quantity_name, value = holding.check_hold(orbit.scene, names, bounds, hold)
    problem_and_z, scene = polish_orbit(orbit, names[0]), orbit.scene
    start = holding.locate_start(scene, names, quantity_name, value, *problem_and_z)
    if start is None:
        branch = branch_through(scene, names[0], bounds[names[0]], problem_and_z, "both", settings)
        candidate_starts = (
            holding.locate_start(scene, names, quantity_name, value, *candidate)
            for candidate in holding.nearby_orbits(branch, quantity_name, value)
        )
        start = next((candidate for candidate in candidate_starts if candidate is not None), None)
        if start is None:
            raise holding.unreachable_value_error(branch, quantity_name, value)
    return holding.follow_held_branch(scene, names, bounds, quantity_name, value, start, direction, settings)


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
    """The branch through each of some orbits, of one scene or of many, along one parameter: a tuple of `Branch`.

    orbits: a list or tuple of `Orbit`, one at least; the other arguments, and each branch, are as of `follow`. An
    orbit on the branch of another gives that branch once more. max_points holds for each branch, max_seconds for all of
    them: branches not begun by then are left out, and the tuple is shorter.

    Raises what `follow` raises; for an orbit that is none before anything is followed, with its place.
    """
    settings = _check_branch_settings(direction, first_step, largest_step, tolerance, monitors, stop)
    settings["limits"] = limits_of(max_points, max_seconds, progress, check.ArgumentError)
    if not isinstance(orbits, Sequence) or not orbits:
        raise check.ArgumentError("orbits", "must be a list or tuple of Orbits, one at least", orbits)
    starts = []
    for k, orbit in enumerate(orbits):
        try:
            starts.append(_check_start(f"orbits[{k}]", orbit, name, bounds))
        except OrbitError as error:
            error.add_note(f"it is orbits[{k}]")
            raise
    orbits_and_starts, branches = zip(orbits, starts, strict=True), []
    for start_orbit, (bounds, start) in orbits_and_starts:
        branches.append(branch_through(start_orbit.scene, name, bounds, start, direction, settings))
        if settings["limits"].expired:
            break
    return tuple(branches)


def _check_branch_settings(direction, *settings):
    """The settings of a branch by name, checked with its direction. Raises ArgumentError."""
    if direction not in DIRECTIONS:
        raise check.ArgumentError("direction", f"must be one of {', '.join(DIRECTIONS)}", direction)
    return check_settings(*settings)


def _check_start(label, orbit, name, bounds):
    """(the bounds, the start) for `branch_through`, of an orbit that is called label. Raises ArgumentError,
    OrbitError."""
    if not isinstance(orbit, Orbit):
        raise check.ArgumentError(label, "must be an Orbit, as find_orbit gives it", orbit)
    bounds = check_bounds(orbit.scene, name, bounds)
    return bounds, polish_orbit(orbit, name)


def branch_through(scene, name, bounds, start, direction, settings):
    """The `Branch` through (`OrbitEquations`, z) at the scene's value of the parameter; settings: those that are
    `check_settings`."""
    (problem, z), length_scale = start, scene_length(scene)
    branch_settings = make_branch_settings(scene, name, bounds, length_scale, start, **settings)
    forward_tangent, start, limits = (
        unit_tangent(continuation_problem(problem), z, arclength_weights(problem, length_scale), problem),
        START_REASON,
        branch_settings.limits,
    )
    first_limits = limits.halved() if direction == "both" else limits
    forward = (
        continue_through_grazings(
            problem, start_point(z, forward_tangent), branch_settings._replace(limits=first_limits)
        )
        if direction != "backward"
        else None
    )
    is_closed = forward is not None and forward.reason.end is End.CLOSED
    if forward is not None and direction == "both" and not is_closed:
        limits = limits.after(sum(len(segment.points.z) for segment in forward.segments) - 1)  # both have the start
        if limits.reached(1):
            is_closed, end = True, End.MAX_SECONDS if limits.expired else End.MAX_POINTS
            start = end.reason(z[-1])
    branch_settings = branch_settings._replace(limits=limits)
    backward = (
        continue_through_grazings(problem, start_point(z, -forward_tangent), branch_settings)
        if direction != "forward" and not is_closed
        else None
    )
    return assemble_branch(scene, name, bounds, settings, backward, forward, start)


def make_branch_settings(
    scene, name, bounds, length_scale, start, first_step, largest_step, tolerance, monitors, stop, limits=UNLIMITED
):
    """The `BranchSettings` of these arguments; start: (along, z) that ends the branch where it comes back."""
    domain_bounds = parameter_domain(scene, name)
    lower, upper = max(bounds[0], domain_bounds[0]), min(bounds[1], domain_bounds[1])
    control_values = (
        np.float64(number) for number in (min(MIN_STEP, first_step), largest_step, tolerance, lower, upper)
    )
    problem, z = start
    n_rows = len(problem.sequence.sides)
    closure_targets = (
        ((problem.sequence._replace(times=z[:n_rows], speeds=z[n_rows : 2 * n_rows]), z[-1]),) if n_rows else ()
    )
    domain_ends = tuple(
        number for number in domain_bounds if not bounds[0] <= number <= bounds[1] or number not in bounds
    )
    return BranchSettings(
        StepControl(np.ones(1), *control_values),
        min(first_step, largest_step),
        domain_ends,
        monitors,
        stop,
        length_scale,
        closure_targets,
        limits,
    )


def polish_orbit(orbit, name):
    """(`OrbitEquations`, z) of an orbit, polished at its value of the parameter. Raises OrbitError."""
    value = float(orbit.scene.parameter(name))
    problem, z = set_up_problem(orbit.scene, name, orbit_row_of(orbit, value))
    residual = float(abs(np.asarray(augmented_systems.evaluate(continuation_problem(problem), z, problem)[0])).max())
    if not residual < MAX_START_RESIDUAL * scene_length(orbit.scene):
        raise OrbitError("the start is no orbit", residual, "give an Orbit of find_orbit, with its own scene")
    point = correct_to_value(problem, z, value)
    return problem, point.z if point.converged else z


def check_settings(first_step, largest_step, tolerance, monitors, stop):
    """The settings of a branch by name, checked. Raises ArgumentError."""
    settings = {"first_step": first_step, "largest_step": largest_step, "tolerance": tolerance}
    for key, value in settings.items():
        if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0):
            raise check.ArgumentError(key, "must be a positive number", value)
    try:
        monitors = dict(monitors)
    except (TypeError, ValueError):
        raise check.ArgumentError(
            "monitors", "must be functions by their labels, {label: function}", monitors
        ) from None
    for label, function in monitors.items():
        if not callable(function):
            raise check.ArgumentError(f"monitors.{label}", "must be a function of a point", function)
    stop = check.name_tuple("stop", () if stop is None else stop)
    for label in stop:
        if label not in (known_kinds := (*KIND_NAMES, *monitors)):
            raise check.ArgumentError(
                "stop", f"must be special points or monitors{check.describe_choices(label, known_kinds)}", label
            )
    return settings | {"monitors": monitors, "stop": stop}
