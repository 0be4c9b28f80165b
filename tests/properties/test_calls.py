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
from tests.kinds import KINDS
from tests.tiers import of_numbers

DERIVATIVES = {"jacfwd": jax.jacfwd, "jacrev": jax.jacrev, "grad": jax.grad, "hessian": jax.hessian}
RIGID = ("one_wall", "two_walls", "moving_walls", "drive_terms", "inelastic")
SOFT, BESIDE_RIGID = ("soft_wall", "soft_and_rigid", "soft_moving"), RIGID[1:]
DERIVED = {"restitution", "hardness"}  # names of a scene that stand for several numbers
LANES, MOST = 3, 4  # of a batch; numbers of a hessian
CALLS = 40  # of a draw of invalid calls


def strobe(scene, state, periods=1):
    end, impacts = jv.strobe(scene, state, periods=periods, slots=2)
    return end.x, end.v, impacts.speed


def two_periods(scene, state):
    return strobe(scene, state, 2)


def return_map(scene, state):
    record = jv.return_map(scene, "right", state.phase, -1.0 - abs(state.v))
    return record.velocity, record.time


def soften(scene, state):
    return strobe(jv.soften(scene, 40.0 * scene.frequency), state)


def rebound(scene, state):
    stiffness = 25.0 * scene.frequency
    return jv.effective_restitution(stiffness, scene.damping), jv.contact_damping(stiffness, scene.left.restitution)


@dataclass(frozen=True)
class TracedCall:
    """A function of a scene and a state, and how it is called: "value", "jvp" or one of DERIVATIVES."""

    name: str
    call: Callable
    ways: tuple
    scenes: tuple = RIGID + SOFT


TRACED = {
    kind.name: kind
    for kind in (
        TracedCall("strobe", strobe, ("value", "jacfwd", "jacrev", "grad", "hessian", "jvp")),
        TracedCall("two_periods", two_periods, ("value", "jacfwd")),
        TracedCall("monodromy", jv.monodromy, ("value",)),
        TracedCall("return_map", return_map, ("value", "jacrev", "jvp"), BESIDE_RIGID),
        TracedCall("soften", soften, ("value", "grad"), BESIDE_RIGID),
        TracedCall("rebound", rebound, ("hessian", "jvp"), ("one_wall",)),
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
    names = kind.scenes if way != "hessian" else [name for name in kind.scenes if name in RIGID]
    scene, state = KINDS[rng.choice(names)].draw_single(number)
    values = {name: float(scene.parameter(name)) for name in scene.names if name not in DERIVED}
    values |= {field: getattr(state, field) for field in ("x", "v", "phase", "contact")}
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
        numbers = constants | by | rest
        own = jv.State(*(numbers.pop(field) for field in ("x", "v", "phase", "contact")))
        return kind.call(scene.replace(**numbers), own)

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
    """Invalid arguments are refused with an error that names the argument, the rule and the value, in 30 s."""
    calls = invalid_calls.drawn(CALLS * (number + 1))[CALLS * number :]
    with tempfile.TemporaryDirectory() as folder, chdir(folder):  # where some of them write
        faults = {str(call): invalid_calls.fault_of(call) for call in calls}
    assert not {call: fault for call, fault in faults.items() if fault}
