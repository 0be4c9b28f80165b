"""Properties of calls: no valid one ends the process, however it is traced; invalid ones are refused."""

import random
import tempfile
from collections.abc import Callable
from contextlib import chdir
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from tests import invalid_calls
from tests.tiers import of_numbers

DERIVATIVES = {"jacfwd": jax.jacfwd, "jacrev": jax.jacrev, "grad": jax.grad, "hessian": jax.hessian}
# of each wall: None, or its numbers beside the position
OWN, MOTION, SOFT = ("restitution",), ("amplitude", "phase"), ("stiffness", "damping")
RIGID = ((None, None), ((), None), ((), MOTION), (OWN, OWN + MOTION), (MOTION, MOTION), (None, OWN + MOTION))
WALLS = (*RIGID, (SOFT, ()), (None, SOFT + MOTION))
LANES, MOST = 3, 4  # of a batch; numbers of a hessian
CALLS = 40  # of a draw of invalid calls
SCENE = {"amplitude": 1.3, "frequency": 2.1, "damping": 0.05, "restitution": 0.7}
STATE = {"x": 0.1, "v": 0.2, "phase": 0.3, "contact": 0.0}
WALL = {"restitution": 0.8, "stiffness": 50.0, "damping": 0.4, "motion.amplitude": 0.1, "motion.phase": 0.5}


@dataclass(frozen=True)
class TracedCall:
    """A function, from {name: number} to arrays, and how it is called: "value", "jvp" or one of DERIVATIVES."""

    name: str
    call: Callable
    ways: tuple
    walls: tuple = WALLS

    def numbers(self, walls):
        """Return {name: value} of the numbers that the function is called with."""
        if self.name == "rebound":
            return {"stiffness": 50.0, "damping": 0.4, "restitution": 0.7}
        numbers = dict(SCENE)
        for side, position, own in zip(("left", "right"), (-1.0, 1.0), walls, strict=True):
            if own is None:
                continue
            moves = own[-2:] == MOTION
            names = ["position", *(own[:-2] if moves else own), *(f"motion.{name}" for name in MOTION if moves)]
            numbers |= {f"{side}.{name}": WALL.get(name, position) for name in names}
        return numbers | STATE | ({"stiffness": 80.0} if self.name == "soften" else {})


def scene_of(numbers):
    """Return the scene of such numbers, made under whatever traces them."""

    def wall(side):
        own = {name.removeprefix(f"{side}."): each for name, each in numbers.items() if name.startswith(f"{side}.")}
        if not own:
            return None
        motion = jv.Motion(own.pop("motion.amplitude"), own.pop("motion.phase")) if "motion.phase" in own else None
        return jv.Wall(**own, motion=motion)

    return jv.make_scene(*(numbers[name] for name in SCENE), (wall("left"), wall("right")))


def state_of(numbers):
    return jv.State(*(numbers[name] for name in STATE))


def strobe(numbers, periods=1):
    end, impacts = jv.strobe(scene_of(numbers), state_of(numbers), periods=periods, slots=2)
    return end.x, end.v, impacts.speed


def two_periods(numbers):
    return strobe(numbers, 2)


def monodromy(numbers):
    return jv.monodromy(scene_of(numbers), state_of(numbers))


def return_map(numbers):
    record = jv.return_map(scene_of(numbers), "right", numbers["phase"], -1.0 - numbers["v"])
    return record.velocity, record.time


def soften(numbers):
    end, impacts = jv.strobe(jv.soften(scene_of(numbers), numbers["stiffness"]), state_of(numbers), slots=2)
    return end.x, end.v, impacts.speed


def rebound(numbers):
    restitution = jv.effective_restitution(numbers["stiffness"], numbers["damping"])
    return restitution, jv.contact_damping(numbers["stiffness"], numbers["restitution"])


BESIDE_RIGID = tuple(walls for walls in RIGID if walls[1] is not None)
TRACED = {
    kind.name: kind
    for kind in (
        TracedCall("strobe", strobe, ("jacfwd", "jacrev", "grad", "hessian", "value", "jvp")),
        TracedCall("two_periods", two_periods, ("value", "jacfwd")),
        TracedCall("monodromy", monodromy, ("value",)),
        TracedCall("return_map", return_map, ("value", "jacrev", "jvp"), BESIDE_RIGID),
        TracedCall("soften", soften, ("value", "grad"), BESIDE_RIGID),
        TracedCall("rebound", rebound, ("hessian", "jvp"), RIGID[:1]),
    )
}


@dataclass(frozen=True)
class InvalidCalls:
    """Calls of all public functions with one invalid argument."""

    name: str = "invalid_calls"


OWN_KINDS = TRACED | {"invalid_calls": InvalidCalls()}


@of_numbers
def test_transformations(kind, number):
    """Numbers may be constants, arguments or batches, differentiated or not, under vmap, jit or both.

    Nothing but the process itself is tested: XLA ends it where it cannot compile a program.
    """
    rng, way = random.Random(number), kind.ways[number % len(kind.ways)]
    walls = rng.choice([walls for walls in kind.walls if way != "hessian" or walls in RIGID])
    values = kind.numbers(walls)
    batched, free = rng.choice((0.0, 0.3, 0.6, 1.0)), rng.choice((0.0, 0.3, 0.6, 1.0))
    use = {name: "batch" if rng.random() < batched else rng.choice(("argument", "constant")) for name in values}
    use = {name: "argument" if use[name] == "constant" and rng.random() < free else use[name] for name in use}
    candidates = [name for name in values if use[name] != "constant"] or [rng.choice(list(values))]
    count = 0 if way == "value" else rng.randint(1, min(len(candidates), MOST if way == "hessian" else 99))
    by = rng.sample(candidates, count)
    use |= {name: "argument" for name in by if use[name] == "constant"}
    constants = {name: value for name, value in values.items() if use[name] == "constant"}

    def argument(name):
        return values[name] * (1.0 + 0.01 * np.arange(LANES)) if use[name] == "batch" else np.float64(values[name])

    arguments = [
        {name: argument(name) for name in values if name not in constants and (name in by) == k} for k in (1, 0)
    ]

    def function(by, rest):
        return kind.call(constants | by | rest)

    def total(by, rest):
        return sum(jnp.sum(part) for part in jax.tree.leaves(function(by, rest)))

    def pushed(by, rest):
        return jax.jvp(lambda by: function(by, rest), (by,), (jax.tree.map(jnp.ones_like, by),))

    transformed = {"value": function, "jvp": pushed}.get(way) or DERIVATIVES[way](
        total if way in ("grad", "hessian") else function
    )
    order = number // len(kind.ways) % 3  # 0: jit of vmap, 1: vmap of jit, 2: no jit
    transformed = jax.jit(transformed) if order == 1 else transformed
    axes = tuple({name: 0 if use[name] == "batch" else None for name in each} for each in arguments)
    has_batch = any(axis == 0 for each in axes for axis in each.values())
    transformed = jax.vmap(transformed, in_axes=axes) if has_batch else transformed
    transformed = jax.jit(transformed) if order == 0 else transformed
    results = jax.tree.leaves(jax.block_until_ready(transformed(*arguments)))
    assert results and all(len(result) == LANES for result in results if has_batch)


@of_numbers
def test_invalid_calls(kind, number):
    """Invalid arguments are refused with an error that names the argument, the rule and the value, within 30 s of its process."""
    calls = invalid_calls.drawn(CALLS * (number + 1))[CALLS * number :]
    with tempfile.TemporaryDirectory() as folder, chdir(folder):  # where some of them write
        faults = {str(call): invalid_calls.fault_of(call) for call in calls}
    assert not {call: fault for call, fault in faults.items() if fault}
