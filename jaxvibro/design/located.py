"""Make special points and orbits differentiable functions of their scenes: `located`."""

from dataclasses import dataclass, field, fields, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.array_type import Array
from continuation.implicit_function import (
    FAILED,
    JUMPED,
    continue_root,
    force_forward_mode,
    make_implicit_root,
    make_lane_loop_function,
)

from ..branches.branch import Special
from ..branches.largest_position import peak_of_flight, peak_of_sequence
from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..loci.locus_start import check_special_point, problems_at_locus_start
from ..orbits import impact_equations, solve
from ..orbits.flight_clearance import impact_free_flight, is_admissible
from ..orbits.orbit import Orbit, OrbitError
from ..orbits.solve import OrbitSolutions, OrbitStructure
from ..scene import check
from ..scene.force import MAX_TOLERANCE
from ..scene.scene import SIDES, Scene
from ..scene.state import SolutionStatus
from .special_point_equations import STATIC, SpecialPointEquations, complete_scene, equations_at_point, parameter_mask

TOLERANCE_RATIO = 100.0  # ratio of the tolerances that estimate the error of the flow


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LocatedPoint:
    """Special point in each scene of a batch.

    At an SB the record describes one half of the orbit and half of its periods. The other half is the mirror image.

    Attributes
    ----------
    value : jax.Array
        Parameter value of the point. Array of shape (...).
    times : jax.Array
        Times of the impacts since phase 0. A grazing impact comes first. Array of shape (..., impacts).
    speeds : jax.Array
        Speeds before the impacts, 0 for a grazing impact. Array of shape (..., impacts).
    residual : jax.Array
        Largest residual of the equations. Array of shape (...).
    status : jax.Array
        `SolutionStatus` of each point. Array of shape (...).
    sides : tuple of int
        Side of each impact, -1 left, 1 right.
    periods : float
        Number of drive periods.

    Examples
    --------
    >>> solution = jv.located(branch.points("SN")[0]).solve(scene)
    >>> round(float(solution.value), 6), solution.sides, solution.periods
    (0.508058, (1, -1), 1.0)
    """

    value: Float[Array, "..."]
    times: Float[Array, "... impacts"]
    speeds: Float[Array, "... impacts"]
    residual: Float[Array, "..."]
    status: Int[Array, "..."]
    sides: tuple[int, ...] = field(metadata=STATIC, default=())
    periods: float = field(metadata=STATIC, default=1.0)


@dataclass(frozen=True, eq=False)
class Located:
    """Value of a special point as a function of scenes.

    Made by `located`. A call with a scene returns the parameter value of the point. For a batch of scenes, the results
    have the shape of the batch. The walls of a scene must be of the same kinds as those of the point. The function can
    be transformed by jit, vmap and grad, in forward and reverse mode, at any order.

    Attributes
    ----------
    special : Special
        Special point that defines the function.
    name : str
        Parameter whose value is returned.
    wall : str or None
        Wall that a GR touches; None if no wall was given.

    Examples
    --------
    >>> value = jv.located(branch.points("SN")[0])
    >>> round(float(value(scene.replace(damping=0.06))), 6)
    0.548148
    """

    special: Special
    name: str
    wall: str | None
    _equations: SpecialPointEquations = field(repr=False)
    _start: Float[np.ndarray, " unknowns"] = field(repr=False)

    def __call__(self, scene: Scene) -> Float[Array, "..."]:
        """Return the parameter value of the point in a scene.

        The value of this parameter in the scene is ignored.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch, with walls of the same kinds as the scene of the point.

        Returns
        -------
        jax.Array
            Parameter value, of the shape of the scene; nan where there is no such point.

        Raises
        ------
        ArgumentError
            If the scene has other walls.
        """
        return self.solve(scene).value

    def solve(self, scene: Scene) -> LocatedPoint:
        """Solve for the point in a scene.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch, with walls of the same kinds as the scene of the point.

        Returns
        -------
        LocatedPoint
            Special point in each scene.

        Raises
        ------
        ArgumentError
            If the scene has other walls.
        """
        require_same_wall_kinds(scene, self.special.scene)
        start_scene, end_scene, batch_shape = complete_scene(self.special.scene), complete_scene(scene), scene.shape
        scene_vectors = jnp.stack(
            [jnp.broadcast_to(leaf, batch_shape).reshape(-1) for leaf in jax.tree.leaves(end_scene)], 1
        )
        start_parameter_mask, end_parameter_mask = (
            parameter_mask(start_or_end_scene, self.name) for start_or_end_scene in (self.special.scene, scene)
        )
        scene_arguments = (
            jnp.stack(jax.tree.leaves(start_scene)) * (1.0 - start_parameter_mask),
            scene_vectors * (1.0 - end_parameter_mask),
            end_parameter_mask,
        )
        located_points, _ = solve_points(self._equations, self._start, *scene_arguments)
        located_points = jax.tree.map(lambda leaf: leaf.reshape(*batch_shape, *leaf.shape[1:]), located_points)
        if self.name == "hardness":  # the equations measure it from the stiffness of the walls
            located_points = replace(located_points, value=located_points.value + scene.parameter("hardness"))
        sequence = self._equations.sequence
        sides = tuple(int(side) for side in np.asarray(sequence.sides))
        return replace(located_points, sides=sides, periods=float(sequence.periods))

    def flow_error(self) -> float:
        """Estimate the error of the value that the integration of the flow causes.

        The value is recomputed with `TOLERANCE_RATIO` times the tolerance of the `Force`. The change of the value is
        divided by the ratio of the tolerances.

        Returns
        -------
        float
            Estimated error; 0 for a linear spring and damper, whose flow is exact.
        """
        scene = self.special.scene
        if scene.force is None:
            return 0.0
        loose_tolerance = min(TOLERANCE_RATIO * scene.force.tolerance, MAX_TOLERANCE)
        loose_special = replace(
            self.special, scene=replace(scene, force=replace(scene.force, tolerance=loose_tolerance))
        )
        loose_point = make_located_point(loose_special, self.name, self.wall)
        value_change = abs(float(loose_point(loose_special.scene)) - float(self(scene)))
        return value_change * scene.force.tolerance / loose_tolerance


def make_located_point(special: Special, name: str | None = None, wall: str | None = None) -> Located:
    """Make the `Located` of a special point.

    Parameters
    ----------
    special : Special
        Special point, as in `located`.
    name : str, optional
        Parameter whose value is returned.
    wall : {"left", "right"}, optional
        Wall of a GR that touches both walls.

    Returns
    -------
    Located
        Value of the point as a function of scenes.

    Raises
    ------
    ArgumentError
        If the point, `name` or `wall` is invalid, or if the orbit of the point sticks.
    """
    check_special_point(special)
    if special.orbit.rests:
        raise check.ArgumentError(
            "point", "must belong to an orbit that does not stick; use `sensitivity` for its derivatives", special.label
        )
    name = special.name if name is None else name
    check.require_parameter(name, special.scene.names, name)
    if wall not in (None, *SIDES):
        raise check.ArgumentError("wall", 'must be "left", "right" or None', wall)
    equations, unknowns = _select_touched_wall(special, name, wall)
    if name == "hardness":
        unknowns[equations.n_orbit_unknowns] = 0.0
    return Located(special, name, wall, equations, unknowns)


def _select_touched_wall(special, name, wall):
    """Return the `SpecialPointEquations` and unknowns of the point; at a GR those of its only contact with the wall."""
    contact_candidates = [
        equations_at_point(special.kind, *problem_and_z)
        for problem_and_z in problems_at_locus_start(
            special.kind, special.scene, special.spot, (name,), use_whole_orbit=True
        )
    ]
    touched_walls = [
        SIDES[int(equations.sequence.sides[0] > 0)] if equations.is_grazing else None
        for equations, _ in contact_candidates
    ]
    wall_matches = [
        candidate
        for candidate, candidate_wall in zip(contact_candidates, touched_walls, strict=True)
        if wall in (None, candidate_wall)
    ]
    if len(wall_matches) != 1:
        touched_walls_text = ", ".join(candidate_wall for candidate_wall in touched_walls if candidate_wall) or "none"
        raise check.ArgumentError("wall", f"must be one of the touched walls, {touched_walls_text}", wall)
    return wall_matches[0]


def require_same_wall_kinds(scene: Scene, reference_scene: Scene) -> None:
    """Raise ArgumentError if `scene` is not a scene whose walls are of the same kinds as in the reference scene."""
    reference_text = _describe_walls(reference_scene)
    if not isinstance(scene, Scene) or _describe_walls(scene) != reference_text:
        raise check.ArgumentError(
            "scene",
            f"must be a Scene with walls of the same kinds as those of the point, {reference_text}",
            _describe_argument(scene),
        )


def _describe_walls(scene):
    """Describe the kinds of the walls of a scene."""
    wall_descriptions = []
    for side, wall in scene.walls.items():
        motion_text = "" if wall.motion is None else f", moving {wall.motion.harmonic} times a period"
        wall_descriptions.append(f"{side} {'soft' if wall.soft else 'rigid'}{motion_text}")
    return "; ".join(wall_descriptions)


def _describe_argument(argument):
    return _describe_walls(argument) if isinstance(argument, Scene) else argument


@jax.jit
def solve_points(equations, start_unknowns, start_scene_vector, scene_vectors, scene_direction):
    """Solve for special points in scenes given as vectors.

    Parameters
    ----------
    equations : SpecialPointEquations
        Defining equations of the point.
    start_unknowns : jax.Array
        Solution in the scene `start_scene_vector`.
    start_scene_vector : jax.Array
        Numbers of the start scene. Array of shape (numbers,).
    scene_vectors : jax.Array
        Numbers of the scenes. Array of shape (n, numbers).
    scene_direction : jax.Array
        Direction, in the space of the numbers of a scene, along which the point is located. Array of shape (numbers,).

    Returns
    -------
    points : LocatedPoint
        Special points. The attribute `value` is the distance from the scene along `scene_direction`.
    unknowns : jax.Array
        Unknowns of the equations. Array of shape (n, unknowns).
    """
    find_point_root, check_admissible = (
        make_implicit_root(_point_residual, _continue_to_scene, call_as_kernel),
        make_lane_loop_function(_is_admissible_point, call_as_kernel),
    )
    fixed_arguments = (
        equations,
        jnp.asarray(scene_direction),
        jnp.asarray(start_unknowns),
        jnp.asarray(start_scene_vector),
    )

    def solve_in_scene(scene_vector):
        unknowns, residual_and_outcome = find_point_root(scene_vector, fixed_arguments)
        is_admissible = check_admissible(equations, fixed_arguments[1], *lax.stop_gradient((scene_vector, unknowns)))
        return _located_point_of(equations, unknowns, *residual_and_outcome, is_admissible), unknowns

    return jax.vmap(solve_in_scene)(scene_vectors)


def _point_residual(unknowns, scene_vector, fixed_arguments):
    equations, scene_direction, *_ = fixed_arguments
    return equations.residual(unknowns, scene_vector, scene_direction)


def _continue_to_scene(scene_vector, fixed_arguments):
    """Continue the unknowns to a scene; return them and (residual, outcome)."""
    *_, start_unknowns, start_scene_vector = fixed_arguments
    solution = continue_root(_point_residual, start_unknowns, start_scene_vector, scene_vector, fixed_arguments)
    return solution.u, (solution.residual, solution.kind)


def _located_point_of(equations, unknowns, residual, outcome, is_admissible):
    value, sequence = unknowns[equations.n_orbit_unknowns], equations.sequence_at(unknowns)
    status = jnp.where(is_admissible, SolutionStatus.OK, SolutionStatus.VIRTUAL)
    status = jnp.where((status == SolutionStatus.OK) & (outcome == JUMPED), SolutionStatus.JUMPED, status)
    status = jnp.where(outcome == FAILED, SolutionStatus.NONE, status)
    nan_if_failed = jnp.where(outcome == FAILED, jnp.nan, 1.0)
    return LocatedPoint(
        value * nan_if_failed, sequence.times * nan_if_failed, sequence.speeds * nan_if_failed, residual, status
    )


def _is_admissible_point(equations, scene_direction, scene_vector, unknowns):
    """Check that no flight of the orbit passes through a wall, and that the impacts have positive speeds in order."""
    sequence = equations.sequence_at(unknowns)
    coeffs = flow_coefficients(
        equations.scene_at(scene_vector + unknowns[equations.n_orbit_unknowns] * scene_direction)
    )
    return is_admissible(
        coeffs, impact_equations.compute_flights(coeffs, sequence), sequence.speeds, equations.is_grazing
    )


QUANTITIES = ("multipliers", "speeds", "peak")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class OrbitOfScene(OrbitSolutions):
    """Orbit in each scene of a batch.

    Extends `OrbitSolutions`. Times are measured from the phase of the orbit. The status is ``SolutionStatus.JUMPED`` if
    the continuation from the scene of the orbit failed and Newton's method may have converged to another orbit.

    Attributes
    ----------
    state : State
        State at the phase of the orbit.
    times : jax.Array
        Times of the impacts since that phase. Array of shape (..., impacts).
    speeds : jax.Array
        Relative speeds before the impacts. Array of shape (..., impacts).
    multipliers : jax.Array
        Floquet multipliers, the larger first. Array of shape (..., 2), complex.
    residual : jax.Array
        Largest residual of the equations before the last step of Newton's method. Array of shape (...).
    status : jax.Array
        `SolutionStatus` of each orbit. Array of shape (...).
    itinerary : tuple of str
        Sequence of walls hit, a word for each drive period.
    peak : jax.Array
        Largest ``|x|`` on the orbit, in lengths of the scene. Array of shape (...).

    Examples
    --------
    >>> solution = jv.located(orbit, "peak").solve(scene)
    >>> solution.itinerary, round(float(solution.peak), 6), int(solution.status)
    (('RL',), 1.0, 0)
    """

    peak: Float[Array, "*shape"]


@dataclass(frozen=True, eq=False)
class LocatedOrbit:
    """Quantity of an orbit as a function of scenes.

    Made by `located`. A call with a scene returns the quantity. A batch of scenes adds its shape as leading dimensions.
    The function can be transformed by jit, vmap and grad, in forward and reverse mode.

    Attributes
    ----------
    orbit : Orbit
        Orbit that defines the function.
    quantity : str
        ``"multipliers"``, complex, of shape (..., 2); ``"speeds"`` of shape (..., impacts); or ``"peak"``, the largest
        ``|x|``, of shape (...).

    Examples
    --------
    >>> peak = jv.located(orbit, "peak")
    >>> round(float(peak(scene.replace(amplitude=2.1))), 6)
    1.0
    """

    orbit: Orbit
    quantity: str
    _asked: OrbitStructure = field(repr=False)
    _start: Float[np.ndarray, " unknowns"] = field(repr=False)

    def __call__(self, scene: Scene) -> Array:
        """Return the quantity in a scene.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch, with walls of the same kinds as the scene of the orbit.

        Returns
        -------
        jax.Array
            The quantity, nan where there is no such orbit.

        Raises
        ------
        ArgumentError
            If the scene has other walls.
        """
        return getattr(self.solve(scene), self.quantity)

    def solve(self, scene: Scene) -> OrbitOfScene:
        """Solve for the orbit in a scene.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch, with walls of the same kinds as the scene of the orbit.

        Returns
        -------
        OrbitOfScene
            Orbit in each scene.

        Raises
        ------
        ArgumentError
            If the scene has other walls.
        """
        orbits = self.along(jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., None], scene))
        return jax.tree.map(lambda leaf: jnp.take(leaf, 0, len(scene.shape)), orbits)

    def along(self, scenes: Scene) -> OrbitOfScene:
        """Solve for the orbit along a path of scenes.

        Parameters
        ----------
        scenes : Scene
            Scenes whose last axis is the path. The orbit is continued from each scene to the next, and to the first
            scene from the scene of the orbit.

        Returns
        -------
        OrbitOfScene
            Orbit in each scene.

        Raises
        ------
        ArgumentError
            If the scenes have other walls.
        """
        require_same_wall_kinds(scenes, self.orbit.scene)
        start_scene, path_scenes, scenes_shape = complete_scene(self.orbit.scene), complete_scene(scenes), scenes.shape
        scene_numbers = [
            jnp.broadcast_to(leaf, scenes_shape).reshape(-1, scenes_shape[-1]) for leaf in jax.tree.leaves(path_scenes)
        ]
        phase = jnp.asarray(self.orbit.state.phase, scenes.dtype)
        start_unknowns, start_scene_vector = jnp.asarray(self._start), jnp.stack(jax.tree.leaves(start_scene))
        orbits = _solve_orbits_on_paths(
            self._asked, start_unknowns, start_scene_vector, jnp.stack(scene_numbers, -1), phase
        )
        return jax.tree.map(lambda leaf: leaf.reshape(*scenes_shape, *leaf.shape[1:]), orbits)


@partial(jax.jit, static_argnums=0)
def _solve_orbits_on_paths(orbit_task, start_unknowns, start_scene_vector, scene_vectors, phase):
    """Solve for an orbit along paths of scenes; return an `OrbitOfScene`.

    `scene_vectors` holds the numbers of the scenes. Array of shape (paths, points, numbers).
    """
    phase_and_start = phase, start_unknowns
    follow_paths = jax.vmap(
        make_lane_loop_function(partial(_follow_orbit_along_path, orbit_task), call_as_kernel), (None, None, 0, None)
    )
    unknowns, continuation_outcomes = follow_paths(
        start_unknowns, start_scene_vector, lax.stop_gradient(scene_vectors), phase
    )
    unknowns, continuation_outcomes, scene_vectors = (
        unknowns.reshape(-1, len(start_unknowns)),
        continuation_outcomes.reshape(-1),
        scene_vectors.reshape(-1, scene_vectors.shape[-1]),
    )
    unknowns = jnp.where((continuation_outcomes == FAILED)[:, None], jnp.nan, unknowns)
    orbit_solutions = solve.solve_lanes(
        orbit_task, scene_vectors, jnp.broadcast_to(phase, continuation_outcomes.shape), unknowns
    )
    status = jnp.where(
        (continuation_outcomes == JUMPED) & (orbit_solutions.status == SolutionStatus.OK),
        SolutionStatus.JUMPED,
        orbit_solutions.status,
    )
    orbit_columns = (
        (orbit_solutions.times, orbit_solutions.speeds)
        if len(orbit_task.sides)
        else (orbit_solutions.state.x[:, None], orbit_solutions.state.v[:, None])
    )
    differentiable_peak = force_forward_mode(partial(_largest_position, orbit_task), call_as_kernel)
    peaks = jax.vmap(differentiable_peak, (0, None))(
        jnp.concatenate([*orbit_columns, scene_vectors], 1), phase_and_start
    )
    peaks = peaks * jnp.where(orbit_solutions.status == SolutionStatus.NONE, jnp.nan, 1.0)
    result_fields = {
        field_definition.name: getattr(orbit_solutions, field_definition.name)
        for field_definition in fields(orbit_solutions)
    } | {
        "status": status,
        "peak": peaks,
    }
    return OrbitOfScene(**result_fields)


def _follow_orbit_along_path(orbit_task, start_unknowns, start_scene_vector, scene_vectors, phase):
    """Continue an orbit from scene to scene; return its unknowns and the worst outcome up to each scene."""

    def continue_to_scene(carry, scene_vector):
        unknowns, previous_scene_vector, worst_outcome = carry
        solution = continue_root(
            partial(solve.orbit_residual, orbit_task),
            unknowns,
            previous_scene_vector,
            scene_vector,
            (phase, start_unknowns),
        )
        worst_outcome = jnp.maximum(worst_outcome, solution.kind)
        return (solution.u, scene_vector, worst_outcome), (solution.u, worst_outcome)

    initial_carry = start_unknowns, start_scene_vector, jnp.zeros((), start_unknowns.dtype)
    return lax.scan(continue_to_scene, initial_carry, scene_vectors)[1]


def _largest_position(orbit_task, unknowns_and_vector, phase_and_start):
    """Return the largest ``|x|`` on an orbit, from one vector of its unknowns and the numbers of its scene."""
    phase, start_unknowns = phase_and_start
    unknowns, scene = (
        unknowns_and_vector[: len(start_unknowns)],
        orbit_task.tree.unflatten(list(unknowns_and_vector[len(start_unknowns) :])),
    )
    coeffs = flow_coefficients(scene)
    if len(orbit_task.sides):
        return peak_of_sequence(coeffs, solve.sequence_of(orbit_task, unknowns, phase))
    return peak_of_flight(coeffs, impact_free_flight(coeffs, phase, orbit_task.periods, *unknowns))


def make_located_orbit(orbit: Orbit, quantity: str | None) -> LocatedOrbit:
    """Make the `LocatedOrbit` of a quantity of an orbit.

    Raises ArgumentError for an unknown quantity, OrbitError if the orbit sticks or chatters.
    """
    if quantity not in QUANTITIES:
        raise check.ArgumentError("name", f"must be one of an orbit's {', '.join(QUANTITIES)}", quantity)
    impacts, state, n_impacts = orbit.impacts, orbit.state, int(orbit.impacts.count)
    if orbit.unknowns == "state" and n_impacts:
        raise OrbitError("the orbit sticks to a wall or chatters", orbit.residual, "separate impacts are required")
    orbit_columns = (impacts.time[:n_impacts], impacts.speed[:n_impacts]) if n_impacts else ([state.x], [state.v])
    orbit_task = OrbitStructure(jax.tree.structure(complete_scene(orbit.scene)), tuple(orbit.itinerary))
    return LocatedOrbit(
        orbit, quantity, orbit_task, np.concatenate([np.asarray(column, float) for column in orbit_columns])
    )


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
