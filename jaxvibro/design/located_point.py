"""A special point's value as a function of its whole scene: what `located_orbit.located` gives of it."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.array_type import Array
from continuation.implicit_function import FAILED, JUMPED, continue_root, implicit_root, loop_over_lanes

from ..branches.branch import Special
from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import flow_coefficients
from ..loci.locus_start import locus_problems, make_locus_start
from ..orbits import impact_equations
from ..orbits.flight_clearance import is_admissible
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.force import MAX_TOLERANCE
from ..scene.scene import SIDES, Scene
from .point_equations import STATIC, PointEquations, complete_scene, equations_at_point, parameter_mask

TOLERANCE_RATIO = 100.0  # the steps by which the flow's error is estimated


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LocatedPoint:
    """A special point of each scene. value: of the parameter; times: of the impacts, since the drive was at phase 0,
    that which grazes first; speeds: before them, 0 of that one; residual: the largest number left in the equations;
    status: a `SolutionStatus`; sides: -1 left, 1 right, of an impact; periods: of the drive. At an SB half of the
    orbit, with half of its periods: the other half is its mirror image."""

    value: Float[Array, "..."]
    times: Float[Array, "... impacts"]
    speeds: Float[Array, "... impacts"]
    residual: Float[Array, "..."]
    status: Int[Array, "..."]
    sides: tuple[int, ...] = field(metadata=STATIC, default=())
    periods: float = field(metadata=STATIC, default=1.0)


@dataclass(frozen=True, eq=False)
class Located:
    """A special point as a function of scenes, made by `located`: `value(scene)` is the parameter's value there,
    `value.solve(scene)` a `LocatedPoint`.

    special: the point that it was made of; name: of the parameter; wall: that is touched, where it was given. A scene
    has the walls of the point's; a batch of scenes gives arrays of its shape. Under jit, vmap and grad, forward and
    reverse, at any order.
    """

    special: Special
    name: str
    wall: str | None
    _equations: PointEquations = field(repr=False)
    _start: Float[np.ndarray, " unknowns"] = field(repr=False)

    def __call__(self, scene: Scene) -> Float[Array, "..."]:
        """The parameter's value at the point, of the scene's shape; nan where there is none.

        What the scene itself says of the parameter does not matter. Raises ArgumentError for a scene with other walls.
        """
        return self.solve(scene).value

    def solve(self, scene: Scene) -> LocatedPoint:
        """The `LocatedPoint` of the scene. Raises ArgumentError for a scene with other walls."""
        require_same_walls(scene, self.special.scene)
        start_scene, end_scene, shape = complete_scene(self.special.scene), complete_scene(scene), scene.shape
        scene_vectors = jnp.stack([jnp.broadcast_to(leaf, shape).reshape(-1) for leaf in jax.tree.leaves(end_scene)], 1)
        start_mask, end_mask = (parameter_mask(marked_scene, self.name) for marked_scene in (self.special.scene, scene))
        arguments = (
            jnp.stack(jax.tree.leaves(start_scene)) * (1.0 - start_mask),
            scene_vectors * (1.0 - end_mask),
            end_mask,
        )
        located_points, _ = solve_points(self._equations, self._start, *arguments)
        located_points = jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), located_points)
        if self.name == "hardness":  # it is counted from the walls' stiffness
            located_points = replace(located_points, value=located_points.value + scene.parameter("hardness"))
        sequence = self._equations.sequence
        sides = tuple(int(side) for side in np.asarray(sequence.sides))
        return replace(located_points, sides=sides, periods=float(sequence.periods))

    def flow_error(self) -> float:
        """How far the flow's own error has the value off, as two tolerances tell: what it changes by where steps under
        a `Force` are to be `TOLERANCE_RATIO` times as loose, over that. 0 under spring and damper, whose flow is
        exact."""
        scene = self.special.scene
        if scene.force is None:
            return 0.0
        loose_tolerance = min(TOLERANCE_RATIO * scene.force.tolerance, MAX_TOLERANCE)
        special = replace(self.special, scene=replace(scene, force=replace(scene.force, tolerance=loose_tolerance)))
        loose_point = make_located_point(special, self.name, self.wall)
        value_change = abs(float(loose_point(special.scene)) - float(self(scene)))
        return value_change * scene.force.tolerance / loose_tolerance


def make_located_point(special: Special, name: str | None = None, wall: str | None = None) -> Located:
    """The `Located` of a special point, as `located_orbit.located` tells."""
    locus_start = make_locus_start(special)
    if special.orbit.rests:
        raise check.ArgumentError(
            "point", "must be of an orbit that does not rest: `sensitivity` has its derivatives", special.label
        )
    name = special.name if name is None else name
    check.require_parameter(name, locus_start.scene.names, name)
    if wall not in (None, *SIDES):
        raise check.ArgumentError("wall", 'must be "left", "right" or None', wall)
    equations, unknowns = _select_contact(locus_start, name, wall)
    if name == "hardness":
        unknowns[equations.n_orbit_unknowns] = 0.0
    return Located(special, name, wall, equations, unknowns)


def _select_contact(locus_start, name, wall):
    """(`PointEquations`, unknowns) of the one touch of a wall."""
    candidates = [
        equations_at_point(locus_start.kind, *problem_and_z)
        for problem_and_z in locus_problems(locus_start, (name,), whole_orbit=True)
    ]
    sides = [
        SIDES[int(equations.sequence.sides[0] > 0)] if equations.is_grazing else None for equations, _ in candidates
    ]
    matches = [candidate for candidate, side in zip(candidates, sides, strict=True) if wall in (None, side)]
    if len(matches) != 1:
        sides_text = ", ".join(side for side in sides if side) or "none"
        raise check.ArgumentError("wall", f"must be one of those that are touched, {sides_text}", wall)
    return matches[0]


def require_same_walls(scene: Scene, reference_scene: Scene) -> None:
    """Raise ArgumentError where what is no scene, or has walls of other kinds than one that is known."""
    walls_text = _describe_walls(reference_scene)
    if not isinstance(scene, Scene) or _describe_walls(scene) != walls_text:
        raise check.ArgumentError(
            "scene", f"must be a Scene with the walls of the point's, {walls_text}", _describe_scene(scene)
        )


def _describe_walls(scene):
    """What is static of a scene, in words."""
    descriptions = []
    for side, wall in scene.walls.items():
        motion_text = "" if wall.motion is None else f", moving {wall.motion.harmonic} times a period"
        descriptions.append(f"{side} {'soft' if wall.soft else 'rigid'}{motion_text}")
    return "; ".join(descriptions)


def _describe_scene(scene):
    return _describe_walls(scene) if isinstance(scene, Scene) else scene


@jax.jit
def solve_points(equations, start_unknowns, start_vector, scene_vectors, direction):
    """(the `LocatedPoint`s from scenes whose numbers are in rows, along a direction of them, value: how far; the
    unknowns).

    equations: the `PointEquations`; start_unknowns: their unknowns where the numbers are those of begin.
    """
    find_root, check_admissible = (
        implicit_root(_residual, _follow_point, call_as_kernel),
        loop_over_lanes(_is_admissible, call_as_kernel),
    )
    fixed_arguments = equations, jnp.asarray(direction), jnp.asarray(start_unknowns), jnp.asarray(start_vector)

    def solve_at(scene_vector):
        unknowns, outcome = find_root(scene_vector, fixed_arguments)
        is_admissible = check_admissible(equations, fixed_arguments[1], *lax.stop_gradient((scene_vector, unknowns)))
        return _make_point(equations, unknowns, *outcome, is_admissible), unknowns

    return jax.vmap(solve_at)(scene_vectors)


def _residual(unknowns, scene_vector, fixed_arguments):
    equations, direction, *_ = fixed_arguments
    return equations.residual(unknowns, scene_vector, direction)


def _follow_point(scene_vector, fixed_arguments):
    """(unknowns, (the residual, how they were found))."""
    *_, start_unknowns, start_vector = fixed_arguments
    solution = continue_root(_residual, start_unknowns, start_vector, scene_vector, fixed_arguments)
    return solution.u, (solution.residual, solution.kind)


def _make_point(equations, unknowns, residual, outcome, is_admissible):
    value, sequence = unknowns[equations.n_orbit_unknowns], equations.sequence_at(unknowns)
    status = jnp.where(is_admissible, SolutionStatus.OK, SolutionStatus.VIRTUAL)
    status = jnp.where((status == SolutionStatus.OK) & (outcome == JUMPED), SolutionStatus.JUMPED, status)
    status = jnp.where(outcome == FAILED, SolutionStatus.NONE, status)
    nan_factor = jnp.where(outcome == FAILED, jnp.nan, 1.0)
    return LocatedPoint(value * nan_factor, sequence.times * nan_factor, sequence.speeds * nan_factor, residual, status)


def _is_admissible(equations, direction, scene_vector, unknowns):
    """Whether the orbit keeps to its walls and hits them with positive speed, one after the other."""
    sequence = equations.sequence_at(unknowns)
    coeffs = flow_coefficients(equations.scene_at(scene_vector + unknowns[equations.n_orbit_unknowns] * direction))
    return is_admissible(
        coeffs, impact_equations.compute_flights(coeffs, sequence), sequence.speeds, equations.is_grazing
    )
