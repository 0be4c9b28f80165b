"""Many periodic orbits at once, as functions of their scenes: `solve_orbits`."""

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Complex, Float, Int

from continuation import newton
from continuation.arrays import Array
from continuation.implicit import in_turn, root, smooth

from ..compiled.kernels import one_kernel
from ..flight import response
from ..flight.coefficients import framed
from ..maps import itinerary as words
from ..maps.strobe import strobe
from ..scene import check
from ..scene.codes import SolutionStatus, Status
from ..scene.scene import Scene
from ..scene.state import State, real_state
from . import impact_equations
from .flight_clearance import is_real, without_impacts
from .impact_equations import Cycle

STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class OrbitSolutions:
    """Periodic orbits, one of each scene. state: at the section's phase; times: of the impacts, since that phase, of
    the itinerary's order; speeds: abs(y- - v_b) before them; multipliers: Floquet's, the larger first; residual: the
    largest number left in the equations, before Newton's last step; status: a `SolutionStatus`, NONE where Newton's
    method does not converge, or where the guess is a state that hits other walls; itinerary: a word a period."""

    state: State
    times: Float[Array, "*shape impacts"]
    speeds: Float[Array, "*shape impacts"]
    multipliers: Complex[Array, "*shape 2"]
    residual: Float[Array, "*shape"]
    status: Int[Array, "*shape"]
    itinerary: tuple[str, ...] = field(metadata=STATIC)


@check.typed
def solve_orbits(
    scenes: Scene,
    guesses: State | tuple[Array, Array],
    itinerary: tuple[str, ...] | list[str],
    periods: int | None = None,
) -> OrbitSolutions:
    """The periodic orbits near guesses that hit given walls in turn: `OrbitSolutions` of the shape of both together.

    scenes: a `Scene`, single or a batch. guesses: a `State`, numbers or arrays, whose flight hits these walls, counted
    from any of its impacts; or (times, speeds) of the impacts, (..., impacts) each, since phase 0. itinerary: a word of
    "L" and "R" a period, as ("LR",) or ("LRL", "R"); all words empty: the motion that meets no wall. periods: their
    number, may be left out.

    Newton's method on the equations of the impacts; stable or not. Under jit, vmap and grad: derivatives by every
    number of the scenes are those of the orbit as a root of its equations (implicit function theorem), of any order,
    forward and reverse; by the guesses they are zero. A status of each lane says what was found; `find_orbit` confirms
    an orbit by certified flights, which is not done here: clearances are those at the turning points of its flights.

    Raises ArgumentError for arguments that cannot be.
    """
    walls = words.checked(itinerary, periods)
    if not isinstance(scenes, Scene):
        raise check.ArgumentError("scenes", "must be a Scene", scenes)
    leaves, tree = jax.tree.flatten(scenes)
    asked = Itinerary(tree, walls)
    sides = asked.sides
    if isinstance(guesses, State):
        phase, start = _met(scenes, real_state(scenes, guesses), sides, len(walls))
    else:
        phase, start = jnp.zeros((), scenes.dtype), _given(guesses, len(sides), scenes.dtype)
    shape = jnp.broadcast_shapes(scenes.shape, jnp.shape(phase), start.shape[:-1])
    rows = jnp.stack([jnp.broadcast_to(leaf, shape).reshape(-1) for leaf in leaves], 1)
    phase = jnp.broadcast_to(phase, shape).reshape(-1)
    start = jnp.broadcast_to(start, (*shape, start.shape[-1])).reshape(-1, start.shape[-1])
    found = solved(asked, rows, phase, start)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), found)


class Itinerary(NamedTuple):
    """What is static of an orbit: the tree of its scene's numbers, and the walls that it hits, a word a period."""

    tree: jax.tree_util.PyTreeDef
    words: tuple[str, ...]

    @property
    def sides(self) -> Float[np.ndarray, " impacts"]:
        """-1 left, 1 right."""
        return words.sides(self.words)

    @property
    def periods(self) -> int:
        """Of the drive."""
        return len(self.words)


def _given(guesses, count, dtype):
    """Times and speeds in rows. Raises ArgumentError."""
    if not isinstance(guesses, tuple | list) or len(guesses) != 2:
        raise check.ArgumentError("guesses", "must be a State, or (times, speeds)", guesses)
    rows = [check.real(f"guesses.{name}", each, dtype) for name, each in zip(("times", "speeds"), guesses, strict=True)]
    for name, row in zip(("times", "speeds"), rows, strict=True):
        if np.ndim(row) == 0 or np.shape(row)[-1] != count:
            rule = f"must have an entry for each of the itinerary's {count} impacts, last"
            raise check.ArgumentError(f"guesses.{name}", rule, f"shape {np.shape(row)}")
    shape = jnp.broadcast_shapes(*map(np.shape, rows))
    if not count:
        return jnp.zeros((*shape[:-1], 2), dtype)
    return jnp.concatenate([jnp.broadcast_to(row, shape) for row in rows], -1)


def _met(scenes, guesses, sides, periods):
    """(the section's phase, times and speeds of the impacts after states, begun with one that makes them those asked
    for, nan where none does); without impacts x and v."""
    scenes, guesses = lax.stop_gradient((scenes, guesses))
    if not len(sides):
        shape = jnp.broadcast_shapes(guesses.x.shape, guesses.v.shape)
        return guesses.phase, jnp.stack([jnp.broadcast_to(each, shape) for each in (guesses.x, guesses.v)], -1)
    _, impacts = strobe(scenes, guesses, periods, len(sides))
    whole = (impacts.count == len(sides)) & (impacts.status < Status.CAP)
    later = impacts.time + (2.0 * jnp.pi * periods / scenes.frequency)[..., None]
    twice = (jnp.concatenate([impacts.time, later], -1), *(jnp.tile(each, 2) for each in (impacts.speed, impacts.side)))
    start = jnp.full((*impacts.time.shape[:-1], 2 * len(sides)), jnp.nan, scenes.dtype)
    for turn in reversed(range(len(sides))):
        times, speeds, hit = (each[..., turn : turn + len(sides)] for each in twice)
        alike = whole & (hit == sides.astype(np.int8)).all(-1)
        start = jnp.where(alike[..., None], jnp.concatenate([times, speeds], -1), start)
    return guesses.phase, start


@partial(jax.jit, static_argnums=0)
def solved(asked, rows, phases, starts):
    """The `OrbitSolutions` of lanes in one axis."""
    zero, find, look = (partial(each, asked) for each in (left, _found, _is_real))
    find, look, measure = (
        root(zero, find, one_kernel),
        in_turn(look, one_kernel),
        smooth(partial(_measured, asked), one_kernel),
    )

    def lane(row, phase, start):
        fixed = phase, start
        unknowns, (residual, status) = find(row, fixed)
        x, v, trace, determinant = measure(jnp.concatenate([unknowns, row]), fixed)
        real = look(*lax.stop_gradient((row, phase, unknowns)))
        status = jnp.where(
            status == newton.OK, jnp.where(real, SolutionStatus.OK, SolutionStatus.VIRTUAL), SolutionStatus.NONE
        )
        blank = jnp.where(status == SolutionStatus.NONE, jnp.nan, 1.0)
        times, speeds = jnp.split(unknowns * blank, 2) if len(asked.sides) else (unknowns[:0], unknowns[:0])
        state = State(x * blank, v * blank, phase, 0.0 * phase)
        roots = _multipliers(trace, determinant) * blank
        return OrbitSolutions(state, times, speeds, roots, residual, status, asked.words)

    return jax.vmap(lane)(rows, phases, starts)


def cycle_of(asked, unknowns, phase):
    """The `Cycle` with these times and speeds."""
    times, speeds = jnp.split(unknowns, 2)
    return Cycle(times, speeds, jnp.asarray(asked.sides), phase, jnp.asarray(float(asked.periods)))


def left(asked, unknowns, numbers, fixed):
    """What is to be zero."""
    scene, (phase, _) = asked.tree.unflatten(list(numbers)), fixed
    if len(asked.sides):
        return impact_equations.equations(framed(scene), cycle_of(asked, unknowns, phase))[0]
    return jnp.stack(_flown(asked, scene, phase, unknowns)[0]) - unknowns


def _flown(asked, scene, phase, state):
    """((x, v), the flight's matrix) after the periods, without walls."""
    return response.of_scene(scene, state[0], state[1], phase, asked.periods * 2.0 * jnp.pi / scene.frequency)


def _found(asked, numbers, fixed):
    phase, start = fixed
    if len(asked.sides):
        scene = asked.tree.unflatten(list(numbers))
        found = impact_equations.solved(scene, cycle_of(asked, start, phase))
    else:
        function = partial(left, asked)
        found = newton.newton(lambda u: (function(u, numbers, fixed), jax.jacfwd(function)(u, numbers, fixed)), start)
    return found.unknowns, (found.residual, found.status.astype(numbers.dtype))


def _is_real(asked, numbers, phase, unknowns):
    scene = asked.tree.unflatten(list(numbers))
    built = framed(scene)
    if len(asked.sides):
        cycle = cycle_of(asked, unknowns, phase)
        return is_real(built, impact_equations.flights(built, cycle), cycle.speeds)
    return is_real(built, without_impacts(built, phase, asked.periods, *unknowns), jnp.ones_like(unknowns[:1]))


def _measured(asked, joined, fixed):
    """x and v at the section, trace and determinant of the monodromy matrix, of unknowns and numbers in one row."""
    phase, start = fixed
    unknowns, scene = joined[: len(start)], asked.tree.unflatten(list(joined[len(start) :]))
    if not len(asked.sides):
        _, matrix = _flown(asked, scene, phase, unknowns)
        p00, _, _, p11 = response.by_rows(matrix)
        return jnp.stack([*unknowns, p00 + p11, response.determinant(matrix)])
    built, cycle = framed(scene), cycle_of(asked, unknowns, phase)
    found = impact_equations.flights(built, cycle)
    x, v = impact_equations.at(built, cycle, found, jnp.zeros(1, unknowns.dtype))
    return jnp.stack([x[0], v[0], *impact_equations.invariants(built, found, cycle.sides)])


def _multipliers(trace, determinant):
    """The roots of a monodromy matrix, the larger first: (2,) complex; smooth but where they are one."""
    half = 0.5 * trace
    inside = half * half - determinant
    size = jnp.sqrt(jnp.where(inside == 0, 1.0, abs(inside))) * jnp.where(inside == 0, 0.0, 1.0)
    larger = half + jnp.where(half < 0, -size, size)
    smaller = determinant / jnp.where(larger == 0, 1.0, larger)
    real = jnp.stack([larger, smaller]) + 0j
    return jnp.where(inside < 0, half + 1j * size * jnp.array([1.0, -1.0]), real)
