"""Define the equations of a special point as a regular root problem, as smooth as the equations of the orbit.

Unknowns are the times and speeds of the impacts, and the distance of the point from a scene along a direction in the
space of all its numbers: one of its parameters, or any other. At a GR one speed is zero and is not an unknown. At an
SN, PD or SB a matrix J is singular, and its null vector v is unknown too: ``F = 0``, ``J v = 0``, ``v v = 1``. (Moore
and Spence 1980, SIAM J. Numer. Anal. 17, 567, use ``l v = 1``, which fails once v has turned perpendicular to l.) J is
the derivative of F with respect to times and speeds, with the closure of the kind: at a PD the perturbation after the
last impact is the opposite of that before. At an SB the orbit is represented by one half, and the other is its mirror
image. The scene is then replaced by its symmetric part, because no other scene has an SB.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from continuation import augmented_systems
from continuation.implicit_function import Parameters, Unknowns

from ..flight.coefficients import flow_coefficients
from ..loci.extended_system import GrazingEquations
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import ImpactSequence
from ..problem.equations import scene_at
from ..scene.scene import Scene, replace_unchecked
from ..scene.symmetry import symmetrise_scene

CLOSURE_MULTIPLIER = {"SN": 1.0, "PD": -1.0, "SB": -1.0}
STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PointEquations:
    """Equations of a special point, a pytree.

    `is_grazing` states whether the first impact has zero speed, as at a GR. `tree` is the tree structure of the scene.
    `sequence` holds the impacts, at an SB of one half of the orbit.
    """

    kind: str = field(metadata=STATIC)
    is_grazing: bool = field(metadata=STATIC)
    tree: jax.tree_util.PyTreeDef = field(metadata=STATIC)
    sequence: ImpactSequence

    @property
    def n_orbit_unknowns(self) -> int:
        """Number of unknown times and speeds; the distance follows them."""
        return 2 * len(self.sequence.sides) - self.is_grazing

    def scene_at(self, scene_vector: Parameters) -> Scene:
        """Return the scene with these numbers, (numbers,), at an SB its symmetric part."""
        scene = self.tree.unflatten(list(scene_vector))
        return symmetrise_scene(scene) if self.kind == "SB" else scene

    def sequence_at(self, unknowns: Unknowns) -> ImpactSequence:
        """Return the `ImpactSequence` with these unknowns."""
        n_rows = len(self.sequence.sides)
        times, speeds = unknowns[:n_rows], unknowns[n_rows : self.n_orbit_unknowns]
        if self.is_grazing:
            speeds = jnp.concatenate([jnp.zeros_like(times[:1]), speeds])
        return self.sequence._replace(times=times, speeds=speeds)

    def residual(self, unknowns: Unknowns, scene_vector: Parameters, direction: Parameters) -> Unknowns:
        """Return the residual of the point at its unknown distance from the scene along a direction."""
        coeffs = flow_coefficients(self.scene_at(scene_vector + unknowns[self.n_orbit_unknowns] * direction))
        residual, derivatives = impact_equations.residual_and_jacobian(coeffs, self.sequence_at(unknowns))
        if self.is_grazing:
            return residual
        null_vector = unknowns[self.n_orbit_unknowns + 1 :]
        # The kernels of many lanes take no matrix products.
        norm_defect = sum(component * component for component in null_vector) - 1.0
        return jnp.concatenate(
            [residual, _jacobian_product(derivatives, null_vector, CLOSURE_MULTIPLIER[self.kind]), norm_defect[None]]
        )


def _jacobian_product(derivatives, null_vector, multiplier):
    """Return J times a change of times and speeds, row by row.

    The kernels of many lanes take no matrix products.
    """
    ((a, b), (c, d)), (e, f) = derivatives.diagonal, derivatives.coupling
    times, speeds = jnp.split(null_vector, 2)
    next_times, next_speeds = (
        jnp.concatenate([component[1:], multiplier * component[:1]]) for component in (times, speeds)
    )
    return jnp.concatenate(
        [a * times + b * speeds + e * next_times, c * times + d * speeds + f * next_times - next_speeds]
    )


def equations_at_point(kind, problem, z):
    """Return the `PointEquations` and their unknowns at the start of a locus (`locus_start.locus_problems`).

    The unknowns are times and speeds, the distance from a scene whose parameter is zero, and the null vector, in one
    row.
    """
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    times, speeds, sides = z[:n_impacts], z[n_rows : n_rows + n_impacts], problem.sequence.sides[:n_impacts]
    row_data = {
        name: _select_rows(getattr(problem.sequence, name), slice(n_impacts)) for name in ("grazing", "releases")
    }
    sequence = problem.sequence._replace(times=times, speeds=speeds, sides=sides, **row_data)
    scene = complete_scene(scene_at(problem, z))
    treedef = jax.tree.structure(scene)
    if isinstance(problem, GrazingEquations):
        return grazing_equations(
            treedef, sequence, int(np.argmax(problem.row_mask)), z[-1], float(scene_at(problem, z).frequency)
        )
    equations = PointEquations(kind, False, treedef, sequence)
    null_vector = null_vector_at(equations, jnp.stack(jax.tree.leaves(scene)))
    return equations, np.concatenate([times, speeds, z[-1:], null_vector])


def grazing_equations(treedef, sequence, grazing_row, value, frequency):
    """Return the `PointEquations` and unknowns of a GR; the impact with zero speed becomes the first."""
    period_shift = np.where(
        np.arange(len(sequence.sides)) < grazing_row, float(sequence.periods) * 2.0 * np.pi / frequency, 0.0
    )
    times, speeds, sides = (
        np.roll(column, -grazing_row) for column in (sequence.times + period_shift, sequence.speeds, sequence.sides)
    )
    row_order = np.roll(np.arange(len(sides)), -grazing_row)
    row_data = {name: _select_rows(getattr(sequence, name), row_order) for name in ("grazing", "releases")}
    sequence = sequence._replace(times=times, speeds=speeds, sides=sides, **row_data)
    return PointEquations("GR", True, treedef, sequence), np.concatenate([times, speeds[1:], [value]])


def _select_rows(row_data, rows):
    """Select rows of an optional per-row array of a sequence."""
    return None if row_data is None else row_data[rows]


def null_vector_at(equations, scene_vector):
    """Return the null vector of J, or the closest to one, in a scene with these numbers."""
    return augmented_systems.null_vector(np.asarray(closed_jacobian(equations, jnp.asarray(scene_vector))))


@jax.jit
def closed_jacobian(equations, scene_vector):
    """Return J for the impacts of the equations in a scene with these numbers."""
    derivatives = impact_equations.residual_and_jacobian(
        flow_coefficients(equations.scene_at(scene_vector)), equations.sequence
    )[1]
    return cyclic_system.dense_matrix(cyclic_system.assemble_matrix(derivatives), CLOSURE_MULTIPLIER[equations.kind])


def complete_scene(scene):
    """Return the scene with explicit numbers for all walls, and a hardness for soft walls.

    The tree of arrays is the same for all scenes with walls of these kinds.
    """
    wall_values = {f"{side}.{name}": scene.parameter(name) for side, wall in scene.walls.items() for name in wall.taken}
    scene = replace_unchecked(scene, wall_values)
    if scene.hardens and scene.harder is None:
        scene = replace(scene, harder=jnp.zeros_like(scene.amplitude))
    return jax.tree.map(partial(jnp.asarray, dtype=scene.dtype), scene)


def parameter_mask(scene, name):
    """Return 1 at the numbers of the complete scene that a parameter sets, else 0; (numbers,).

    Walls that inherit the parameter from the scene are included.
    """
    inherited_names = [f"{side}.{name}" for side, wall in scene.walls.items() if name in wall.taken]
    zero_scene = jax.tree.map(lambda leaf: 0.0, complete_scene(scene))
    if name == "hardness":
        return np.array(jax.tree.leaves(replace(zero_scene, harder=1.0)))
    return np.array(jax.tree.leaves(replace_unchecked(zero_scene, dict.fromkeys([name, *inherited_names], 1.0))))
