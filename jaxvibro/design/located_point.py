"""Make the value of a special point a function of its whole scene, for `located.located`."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.array_type import Array
from continuation.implicit_function import FAILED, JUMPED, continue_root, make_implicit_root, make_lane_loop_function

from ..branches.branch import Special
from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..loci.locus_start import make_locus_start, problems_at_locus_start
from ..orbits import impact_equations
from ..orbits.flight_clearance import is_admissible
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.force import MAX_TOLERANCE
from ..scene.scene import SIDES, Scene
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
    locus_start = make_locus_start(special)
    if special.orbit.rests:
        raise check.ArgumentError(
            "point", "must belong to an orbit that does not stick; use `sensitivity` for its derivatives", special.label
        )
    name = special.name if name is None else name
    check.require_parameter(name, locus_start.scene.names, name)
    if wall not in (None, *SIDES):
        raise check.ArgumentError("wall", 'must be "left", "right" or None', wall)
    equations, unknowns = _select_touched_wall(locus_start, name, wall)
    if name == "hardness":
        unknowns[equations.n_orbit_unknowns] = 0.0
    return Located(special, name, wall, equations, unknowns)


def _select_touched_wall(locus_start, name, wall):
    """Return the `SpecialPointEquations` and unknowns of the point; at a GR those of its only contact with the wall."""
    contact_candidates = [
        equations_at_point(locus_start.kind, *problem_and_z)
        for problem_and_z in problems_at_locus_start(locus_start, (name,), use_whole_orbit=True)
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
