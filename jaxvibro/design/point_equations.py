"""The defining equations of a special point: a regular root, as smooth as the orbit's own equations are.

Unknowns are the impacts' times and speeds, and how far the point is from a scene along a direction in the space of all
its numbers: along one of its parameters, or any other. At a GR one speed is zero, and no unknown. At an
SN, PD or SB a matrix J is singular, and its null vector is unknown too: F = 0, J v = 0, v v = 1 (Moore and Spence 1980,
SIAM J. Numer. Anal. 17, 567, have l v = 1, which fails where v has turned until it is across l). J is the derivative of
F by times and speeds, closed as the kind asks: at a PD what comes after the last impact is the opposite of what came
before. An SB is one of half the orbit, whose other half is its mirror image; the scene is then taken by its symmetric
part, as no other has an SB.
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
    """What is zero at a special point, a pytree. kind; is_grazing: whether the first impact is one without speed, as at
    a GR; tree: of the scene's numbers; sequence: the impacts, of half the orbit at an SB."""

    kind: str = field(metadata=STATIC)
    is_grazing: bool = field(metadata=STATIC)
    tree: jax.tree_util.PyTreeDef = field(metadata=STATIC)
    sequence: ImpactSequence

    @property
    def n_orbit_unknowns(self) -> int:
        """How many times and speeds are unknown: how far comes after them."""
        return 2 * len(self.sequence.sides) - self.is_grazing

    def scene_at(self, scene_vector: Parameters) -> Scene:
        """The scene with these numbers, (numbers,), of which an SB takes the symmetric part."""
        scene = self.tree.unflatten(list(scene_vector))
        return symmetrise_scene(scene) if self.kind == "SB" else scene

    def sequence_at(self, unknowns: Unknowns) -> ImpactSequence:
        """The `ImpactSequence` with these unknowns."""
        n_rows = len(self.sequence.sides)
        times, speeds = unknowns[:n_rows], unknowns[n_rows : self.n_orbit_unknowns]
        if self.is_grazing:
            speeds = jnp.concatenate([jnp.zeros_like(times[:1]), speeds])
        return self.sequence._replace(times=times, speeds=speeds)

    def residual(self, unknowns: Unknowns, scene_vector: Parameters, direction: Parameters) -> Unknowns:
        """What is to be zero: the point is to lie so far from a scene with these numbers, along a direction of them."""
        coeffs = flow_coefficients(self.scene_at(scene_vector + unknowns[self.n_orbit_unknowns] * direction))
        residual, derivatives = impact_equations.residual_and_jacobian(coeffs, self.sequence_at(unknowns))
        if self.is_grazing:
            return residual
        null_vector = unknowns[self.n_orbit_unknowns + 1 :]
        norm_defect = (
            sum(component * component for component in null_vector) - 1.0
        )  # a sum of products would be one of matrices
        return jnp.concatenate(
            [residual, _jacobian_product(derivatives, null_vector, CLOSURE_MULTIPLIER[self.kind]), norm_defect[None]]
        )


def _jacobian_product(derivatives, null_vector, multiplier):
    """J times a change of times and speeds, row by row: the kernels of many lanes take no products of matrices."""
    ((a, b), (c, d)), (e, f) = derivatives.diagonal, derivatives.coupling
    times, speeds = jnp.split(null_vector, 2)
    next_times, next_speeds = (
        jnp.concatenate([component[1:], multiplier * component[:1]]) for component in (times, speeds)
    )
    return jnp.concatenate(
        [a * times + b * speeds + e * next_times, c * times + d * speeds + f * next_times - next_speeds]
    )


def equations_at_point(kind, problem, z):
    """(`PointEquations`, times and speeds, how far from a scene whose parameter is zero, null vector) at a point of a
    curve, as a locus begins with it (`loci.first_point`), in one row."""
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
    """(`PointEquations`, unknowns) of a GR at which the impact in a row has no speed: it becomes the first."""
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
    """Some rows of what a cycle marks them by, None: of nothing."""
    return None if row_data is None else row_data[rows]


def null_vector_at(equations, scene_vector):
    """The null vector of J, or what comes nearest to one, where its own impacts are in a scene with these numbers."""
    return augmented_systems.null_vector(np.asarray(closed_jacobian(equations, jnp.asarray(scene_vector))))


@jax.jit
def closed_jacobian(equations, scene_vector):
    """J, where the point's own impacts are in a scene with these numbers."""
    derivatives = impact_equations.residual_and_jacobian(
        flow_coefficients(equations.scene_at(scene_vector)), equations.sequence
    )[1]
    return cyclic_system.dense_matrix(cyclic_system.assemble_matrix(derivatives), CLOSURE_MULTIPLIER[equations.kind])


def complete_scene(scene):
    """The scene with all numbers of its walls their own, and a hardness of soft walls to be added: a tree of arrays
    that is the same for all scenes with walls of these kinds."""
    wall_values = {f"{side}.{name}": scene.parameter(name) for side, wall in scene.walls.items() for name in wall.taken}
    scene = replace_unchecked(scene, wall_values)
    if scene.hardens and scene.harder is None:
        scene = replace(scene, harder=jnp.zeros_like(scene.amplitude))
    return jax.tree.map(partial(jnp.asarray, dtype=scene.dtype), scene)


def parameter_mask(scene, name):
    """1 at the numbers of the `complete_scene` scene that a parameter stands for, walls that take it from the scene
    among them, else 0: (numbers,)."""
    inherited_names = [f"{side}.{name}" for side, wall in scene.walls.items() if name in wall.taken]
    zero_scene = jax.tree.map(lambda leaf: 0.0, complete_scene(scene))
    if name == "hardness":
        return np.array(jax.tree.leaves(replace(zero_scene, harder=1.0)))
    return np.array(jax.tree.leaves(replace_unchecked(zero_scene, dict.fromkeys([name, *inherited_names], 1.0))))
