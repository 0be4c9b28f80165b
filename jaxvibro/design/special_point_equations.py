"""Define the equations of a special point as a regular root problem, as smooth as the equations of the orbit.

The unknowns are the times and speeds of the impacts, and the distance of the point from a scene. The distance is
measured along a direction in the space of all numbers of the scene: that of a parameter, or any other direction.

- GR: one speed is zero and is not an unknown.
- SN, PD, SB: a matrix J is singular, and its null vector v is an additional unknown. The equations are ``F = 0``,
  ``J v = 0`` and ``v v = 1``. (Moore and Spence 1980, SIAM J. Numer. Anal. 17, 567, use ``l v = 1`` with a fixed vector
  l, which fails if v becomes perpendicular to l.) J is the derivative of F with respect to times and speeds. At an SN
  the perturbation v returns unchanged after a cycle. At a PD it returns with the opposite sign.
- SB: one half represents the orbit. The other half is its mirror image. v returns with the opposite sign after the
  half. The scene is replaced by its symmetric part, because only a symmetric scene has an SB.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from continuation import augmented_systems
from continuation.implicit_function import Parameters, Unknowns

from ..contact.kinds import flow_coefficients
from ..loci.locus_equations import GrazingCondition
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import ImpactSequence
from ..problem.orbit_equations import scene_at
from ..scene.scene import Scene, replace_unchecked
from ..scene.scene_properties import symmetrise_scene

CLOSURE_MULTIPLIER = {"SN": 1.0, "PD": -1.0, "SB": -1.0}
STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SpecialPointEquations:
    """Equations of a special point, a pytree.

    Attributes
    ----------
    kind : str
        Kind of the point.
    is_grazing : bool
        True if the first impact has zero speed, as at a GR.
    tree : jax.tree_util.PyTreeDef
        Tree structure of the scene.
    sequence : ImpactSequence
        Impacts of the orbit; at an SB the impacts of one half of the orbit.
    """

    kind: str = field(metadata=STATIC)
    is_grazing: bool = field(metadata=STATIC)
    tree: jax.tree_util.PyTreeDef = field(metadata=STATIC)
    sequence: ImpactSequence

    @property
    def n_orbit_unknowns(self) -> int:
        """Number of unknown times and speeds. They precede the unknown distance."""
        return 2 * len(self.sequence.sides) - self.is_grazing

    def scene_at(self, scene_vector: Parameters) -> Scene:
        """Return the scene with these numbers, (numbers,). At an SB, return the symmetric part of this scene."""
        scene = self.tree.unflatten(list(scene_vector))
        return symmetrise_scene(scene) if self.kind == "SB" else scene

    def sequence_at(self, unknowns: Unknowns) -> ImpactSequence:
        """Return the `ImpactSequence` with the times and speeds in these unknowns."""
        n_rows = len(self.sequence.sides)
        times, speeds = unknowns[:n_rows], unknowns[n_rows : self.n_orbit_unknowns]
        if self.is_grazing:
            speeds = jnp.concatenate([jnp.zeros_like(times[:1]), speeds])
        return self.sequence._replace(times=times, speeds=speeds)

    def residual(self, unknowns: Unknowns, scene_vector: Parameters, scene_direction: Parameters) -> Unknowns:
        """Return the residual of the equations; one of the unknowns is the distance of the point from the scene."""
        coeffs = flow_coefficients(self.scene_at(scene_vector + unknowns[self.n_orbit_unknowns] * scene_direction))
        residual, residual_derivatives = impact_equations.residual_and_jacobian(coeffs, self.sequence_at(unknowns))
        if self.is_grazing:
            return residual
        null_vector = unknowns[self.n_orbit_unknowns + 1 :]
        # The kernels of many lanes take no matrix products.
        null_norm_defect = sum(component * component for component in null_vector) - 1.0
        return jnp.concatenate(
            [
                residual,
                _jacobian_times_vector(residual_derivatives, null_vector, CLOSURE_MULTIPLIER[self.kind]),
                null_norm_defect[None],
            ]
        )


def _jacobian_times_vector(residual_derivatives, null_vector, closure_multiplier):
    """Return J times a change of times and speeds.

    The product is written out by components, because the kernels of many lanes support no matrix products.
    """
    (
        ((position_by_time, position_by_speed), (speed_by_time, speed_by_speed)),
        (position_by_next_time, speed_by_next_time),
    ) = residual_derivatives.diagonal, residual_derivatives.coupling
    time_changes, speed_changes = jnp.split(null_vector, 2)
    next_time_changes, next_speed_changes = (
        jnp.concatenate([component[1:], closure_multiplier * component[:1]])
        for component in (time_changes, speed_changes)
    )
    return jnp.concatenate(
        [
            position_by_time * time_changes
            + position_by_speed * speed_changes
            + position_by_next_time * next_time_changes,
            speed_by_time * time_changes
            + speed_by_speed * speed_changes
            + speed_by_next_time * next_time_changes
            - next_speed_changes,
        ]
    )


def equations_at_point(kind, problem, z):
    """Return the `SpecialPointEquations` and their unknowns at a solution z of `locus_start.problems_at_locus_start`.

    The unknowns form one vector: the times and speeds, the distance from the scene in which the parameter is zero, and
    the null vector.
    """
    n_impacts = problem.n_used_rows
    (times, speeds, _), sides = problem.impacts(z), problem.sequence.sides[:n_impacts]
    optional_columns = {
        column_name: _select_rows(getattr(problem.sequence, column_name), slice(n_impacts))
        for column_name in ("grazing", "releases")
    }
    sequence = problem.sequence._replace(times=times, speeds=speeds, sides=sides, **optional_columns)
    scene = complete_scene(scene_at(problem, z))
    scene_treedef = jax.tree.structure(scene)
    if isinstance(problem.condition, GrazingCondition):
        return grazing_equations(
            scene_treedef,
            sequence,
            int(np.argmax(problem.condition.row_mask)),
            z[-1],
            float(scene_at(problem, z).frequency),
        )
    equations = SpecialPointEquations(kind, False, scene_treedef, sequence)
    null_vector = null_vector_at(equations, jnp.stack(jax.tree.leaves(scene)))
    return equations, np.concatenate([times, speeds, z[-1:], null_vector])


def grazing_equations(scene_treedef, sequence, grazing_row, parameter_value, drive_frequency):
    """Return the `SpecialPointEquations` and unknowns of a GR; the impact with zero speed is in the first row."""
    time_shifts = np.where(
        np.arange(len(sequence.sides)) < grazing_row, float(sequence.periods) * 2.0 * np.pi / drive_frequency, 0.0
    )
    times, speeds, sides = (
        np.roll(column, -grazing_row) for column in (sequence.times + time_shifts, sequence.speeds, sequence.sides)
    )
    row_order = np.roll(np.arange(len(sides)), -grazing_row)
    optional_columns = {
        column_name: _select_rows(getattr(sequence, column_name), row_order) for column_name in ("grazing", "releases")
    }
    sequence = sequence._replace(times=times, speeds=speeds, sides=sides, **optional_columns)
    return SpecialPointEquations("GR", True, scene_treedef, sequence), np.concatenate(
        [times, speeds[1:], [parameter_value]]
    )


def _select_rows(optional_column, rows):
    """Return the given rows of an array with one entry per row of a sequence, or None if there is no array."""
    return None if optional_column is None else optional_column[rows]


def null_vector_at(equations, scene_vector):
    """Return the null vector of J, or of the nearest singular matrix, in a scene with these numbers."""
    return augmented_systems.null_vector(np.asarray(closed_jacobian(equations, jnp.asarray(scene_vector))))


@jax.jit
def closed_jacobian(equations, scene_vector):
    """Return J as a dense matrix, for the impacts of the equations in a scene with these numbers."""
    derivatives = impact_equations.residual_and_jacobian(
        flow_coefficients(equations.scene_at(scene_vector)), equations.sequence
    )[1]
    return cyclic_system.dense_matrix(
        cyclic_system.assemble_block_matrix(derivatives), CLOSURE_MULTIPLIER[equations.kind]
    )


def complete_scene(scene):
    """Return the scene with explicit values of all inherited wall parameters, and a hardness if it has soft walls.

    All scenes with walls of the same kinds then have the same tree structure.
    """
    inherited_values = {
        f"{side}.{name}": scene.parameter(name) for side, wall in scene.walls.items() for name in wall.taken
    }
    scene = replace_unchecked(scene, inherited_values)
    if scene.hardens and scene.harder is None:
        scene = replace(scene, harder=jnp.zeros_like(scene.amplitude))
    return jax.tree.map(partial(jnp.asarray, dtype=scene.dtype), scene)


def parameter_mask(scene, name):
    """Return a mask of the numbers of the complete scene that a parameter sets. Array of shape (numbers,).

    The numbers of walls that inherit the parameter from the scene are included.
    """
    inherited_wall_names = [f"{side}.{name}" for side, wall in scene.walls.items() if name in wall.taken]
    zero_scene = jax.tree.map(lambda leaf: 0.0, complete_scene(scene))
    if name == "hardness":
        return np.array(jax.tree.leaves(replace(zero_scene, harder=1.0)))
    return np.array(jax.tree.leaves(replace_unchecked(zero_scene, dict.fromkeys([name, *inherited_wall_names], 1.0))))
