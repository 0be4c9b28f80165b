"""No valid call ends the process: `python -m tests.trace_proof 200` differentiates and batches what is traced.

A combination is a public function, walls of a kind, a derivative, and for each number of the scene and the state
whether it is written in the program, an argument, or an argument with lanes, and whether the derivative is by it. They
are drawn in strata, each by its own index, and run in child processes, so that an abort is seen and counted. An index,
or several, in place of the count as in `... at 17 29` runs those alone, in this process.
"""

import os
import random
import subprocess
import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv

WAYS = {
    "value": None,
    "jvp": None,
    "jacfwd": jax.jacfwd,
    "jacrev": jax.jacrev,
    "grad": jax.grad,
    "hessian": jax.hessian,
}
CALLS = (
    *(("strobe", way) for way in WAYS),
    *(("strobe", way) for way in ("jacfwd", "jacrev")),
    *(("periods", way) for way in ("value", "jacfwd")),
    *(("monodromy", "value"),) * 2,
    *(("return_map", way) for way in ("value", "jvp", "jacrev")),
    *(("soften", way) for way in ("value", "grad")),
    *(("rebound", way) for way in ("jvp", "hessian")),
)
# of each wall: None, or its numbers beside the position
OWN, MOTION, SOFT = ("restitution",), ("amplitude", "phase"), ("stiffness", "damping")
RIGID = ((None, None), ((), None), ((), MOTION), (OWN, OWN + MOTION), (MOTION, MOTION), (None, OWN + MOTION))
KINDS = (*RIGID, (SOFT, ()), (None, SOFT + MOTION))
PLACES = ("constant", "argument", "lanes")
LANES, MOST, GROUP, LIMIT = 3, 4, 10, 3000  # of a batch; of a hessian's numbers; combinations, and seconds, of a child
VALUES = {"amplitude": 1.3, "frequency": 2.1, "damping": 0.05, "restitution": 0.7}
STATE = {"x": 0.1, "v": 0.2, "phase": 0.3, "contact": 0.0}
WALL = {"restitution": 0.8, "stiffness": 50.0, "damping": 0.4, "motion.amplitude": 0.1, "motion.phase": 0.5}


class Combination(NamedTuple):
    """function and way: of CALLS; kind: of KINDS; places: {number: of PLACES}; by: the numbers that the derivative is
    by; outer: whether jit goes round the vmap, else within, None: nowhere."""

    function: str
    way: str
    kind: tuple
    places: dict
    by: tuple
    outer: bool | None


def combination(index):
    """The combination of an index."""
    rng, (function, way), turn = random.Random(index), CALLS[index % len(CALLS)], index // len(CALLS)
    kinds = RIGID if way == "hessian" or function == "soften" else KINDS
    if function in ("return_map", "soften"):
        kinds = tuple(kind for kind in kinds if kind[1] is not None and "stiffness" not in kind[1])
    kind = kinds[(turn + index) % len(kinds)]
    names = list(_numbers(function, kind))
    lanes, free = ((turn + k) % 4 / 3.0 for k in (0, 1 + turn // 4))  # the share with lanes; of others, of arguments
    places = {name: PLACES[2 if rng.random() < lanes else int(rng.random() < free)] for name in names}
    known = [name for name in names if places[name] != "constant"] or [rng.choice(names)]
    if way == "value":
        by = ()
    else:
        many = max(1, round(len(known) * (1 + turn % 3) / 3.0))
        by = tuple(rng.sample(known, min(many, MOST) if way == "hessian" else many))
    places |= {name: "argument" for name in by if places[name] == "constant"}
    return Combination(function, way, kind, places, by, (True, False, None)[turn % 3])


def _numbers(function, kind):
    """{name: value} of the numbers that a function is called with."""
    if function == "rebound":
        return {"stiffness": 50.0, "damping": 0.4, "restitution": 0.7}
    found = dict(VALUES)
    for side, where, own in zip(("left", "right"), (-1.0, 1.0), kind, strict=True):
        if own is None:
            continue
        found[f"{side}.position"] = where
        moves = own[-2:] == MOTION
        for name in own[:-2] if moves else own:
            found[f"{side}.{name}"] = WALL[name]
        if moves:
            found |= {f"{side}.motion.{name}": WALL[f"motion.{name}"] for name in MOTION}
    return found | STATE | ({"stiffness": 80.0} if function == "soften" else {})


def _scene(numbers):
    """The scene of such numbers, made under whatever traces them."""

    def wall(side):
        own = {name.removeprefix(f"{side}."): each for name, each in numbers.items() if name.startswith(f"{side}.")}
        if not own:
            return None
        motion = jv.Motion(own.pop("motion.amplitude"), own.pop("motion.phase")) if "motion.phase" in own else None
        return jv.Wall(**own, motion=motion)

    return jv.make_scene(*(numbers[name] for name in VALUES), (wall("left"), wall("right")))


def called(function, numbers):
    """What the function gives, real arrays."""
    if function == "rebound":
        stiffness, damping, restitution = (numbers[name] for name in ("stiffness", "damping", "restitution"))
        return jv.effective_restitution(stiffness, damping), jv.contact_damping(stiffness, restitution)
    scene, state = _scene(numbers), jv.State(*(numbers[name] for name in STATE))
    if function == "monodromy":
        return jv.monodromy(scene, state)
    if function == "return_map":
        found = jv.return_map(scene, "right", state.phase, -1.0 - state.v)
        return found.velocity, found.time
    if function == "soften":
        scene = jv.soften(scene, numbers["stiffness"])
    end, impacts = jv.strobe(scene, state, periods=2 if function == "periods" else 1, slots=2)
    return end.x, end.v, impacts.speed


def run(index):
    """Compile and run a combination."""
    given = combination(index)
    values = _numbers(given.function, given.kind)
    place = {name: given.places[name] for name in values}
    constants = {name: value for name, value in values.items() if place[name] == "constant"}

    def lanes(name):
        return values[name] * (1.0 + 0.01 * np.arange(LANES)) if place[name] == "lanes" else np.float64(values[name])

    by = {name: lanes(name) for name in given.by}
    rest = {name: lanes(name) for name in values if name not in by and name not in constants}

    def function(by, rest):
        return called(given.function, constants | by | rest)

    def total(by, rest):
        return sum(jnp.sum(part) for part in jax.tree.leaves(function(by, rest)))

    def pushed(by, rest):
        return jax.jvp(lambda by: function(by, rest), (by,), (jax.tree.map(jnp.ones_like, by),))

    way = WAYS[given.way]
    plain = {"value": function, "jvp": pushed}.get(given.way)
    turned = plain or way(total if given.way in ("grad", "hessian") else function)
    axes = [{name: 0 if place[name] == "lanes" else None for name in each} for each in (by, rest)]
    turned = turned if given.outer is not False else jax.jit(turned)
    if any(axis == 0 for each in axes for axis in each.values()):
        turned = jax.vmap(turned, in_axes=tuple(axes))
    turned = jax.jit(turned) if given.outer else turned
    return jax.block_until_ready(turned(by, rest))


def child(indices):
    """(the indices done, what the child said of the one that it did not do, None if all)."""
    command = [sys.executable, "-m", "tests.trace_proof", "at", *map(str, indices)]
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False, env=os.environ)
    except subprocess.TimeoutExpired as late:
        return _done(late.stdout.decode() if late.stdout else ""), "the time is up"
    if told.returncode == 0:
        return indices, None
    reasons = [line for line in told.stderr.splitlines() if line.strip() and not line.startswith("    @")]
    reasons = [line for line in reasons if "Check failed" in line] or reasons[-1:]
    return _done(told.stdout), f"exit {told.returncode}: {' '.join(reasons)[:300]}"


def _done(out):
    return [int(line.split()[1]) for line in out.splitlines() if line.startswith("done ")]


def proof(count):
    """Run so many combinations in children; print those that ended one, and how many."""
    left, bad = list(range(count)), []
    while left:
        done, reason = child(left[:GROUP])
        left = left[len(done) :]
        if reason is not None:
            bad.append(left.pop(0))
            print(f"{bad[-1]} {combination(bad[-1])}: {reason}", flush=True)
        print(f"{count - len(left)} of {count}, {len(bad)} ended their process", flush=True)
    return bad


def main(what, *indices):
    """Run what the command line says."""
    jax.config.update("jax_enable_x64", True)
    if what != "at":
        sys.exit(bool(proof(int(what))))
    for index in map(int, indices):
        run(index)
        print(f"done {index}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
