"""Random compositions of JAX transformations around the map, compared with a loop of single calls.

A defect here may end the process in XLA's compiler: a worker that dies is a failure.
"""

import os
import subprocess
import sys
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jax.sharding import Mesh, PartitionSpec

import jaxvibro as jv
from tests.tiers import of_numbers

SLOW = 1e-4  # an impact slower than this: derivatives are large, and counted by themselves
CHECKED = 6  # lanes of a batch that are compared with single calls
NAMES = ("x", "v", "phase", "amplitude", "frequency", "damping", "left", "right", "restitution", "extra")
RANGES = {"x": (-0.8, 0.8), "v": (-2.0, 2.0), "phase": (-3.0, 3.0), "amplitude": (1.0, 5.0), "frequency": (1.0, 3.0)}
RANGES |= {"damping": (0.01, 0.2), "left": (-1.2, -1.0), "right": (1.0, 1.2), "restitution": (0.3, 0.9)}
RANGES |= {"extra": (0.0, 0.1)}
PLAIN_SCENES = ("rigid", "one-sided", "zero", "moving", "harmonics", "clearance", "inelastic", "elastic", "overdamped")
SLOW_SCENES = ("soft", "soft-moving", "duffing", "springless", "contact-law")  # slower to compile
SCENES = (*PLAIN_SCENES, "undriven", *SLOW_SCENES)
FUNCTIONS = ("strobe", "strobe", "strobe", "impacts", "sample", "monodromy")
DERIVATIVES = ("value", "jvp", "vjp", "jacfwd", "jacrev", "hessian", "linearize", "jvp of vjp")
LOOPS = ("none", "scan", "while_loop", "fori_loop", "nested")
CONTROLS = (*LOOPS, "cond", "switch", "checkpoint", "shard_map", "custom_root", "equinox", "optax")
FORWARD_ONLY = ("while_loop", "fori_loop")
PASSING = ("closed over", "argument")
LANES = (1, 2, 3, 7, 16, 64, 65, 210, 600, 2000)
NOT_DIFFERENTIABLE = ("monodromy",)


OWN_KINDS = {name: SimpleNamespace(name=name) for name in SCENES}


def draw(scene, number):
    """The choices of one composition, reproducible from the number; strata take turns."""
    seed = SCENES.index(scene) + len(SCENES) * number
    rng = np.random.default_rng([17, seed])

    def pick(options):
        return str(rng.choice(options))

    one = {"seed": seed, "scene": scene, "derivative": DERIVATIVES[seed % len(DERIVATIVES)]}
    one |= {"control": CONTROLS[(seed // 3) % len(CONTROLS)], "function": pick(FUNCTIONS), "passing": pick(PASSING)}
    if one["function"] in NOT_DIFFERENTIABLE:
        one["derivative"] = "value"
    if one["control"] in FORWARD_ONLY:
        one["inside"] = True
    else:
        one["inside"] = bool(rng.random() < 0.5)  # the derivative is taken within the control flow, else of it
    one["lanes"] = (
        int(rng.choice(LANES)) if one["derivative"] not in ("hessian", "jvp of vjp") else int(rng.choice(LANES[:6]))
    )
    one["batched"] = sorted(rng.choice(NAMES, rng.integers(1, len(NAMES) + 1), replace=False).tolist(), key=NAMES.index)
    one["by"] = sorted(rng.choice(NAMES[:9], rng.integers(1, 5), replace=False).tolist(), key=NAMES.index)
    one["zero"] = bool(rng.random() < 0.3)  # a tangent that is zero
    one["repeated"] = bool(rng.random() < 0.3)  # one array for two numbers
    one["jit"] = bool(rng.random() < 0.85)
    one["levels"] = int(rng.integers(1, 3))
    one["slots"], one["periods"] = int(rng.choice([0, 1, 4, 9, 40])), int(rng.choice([1, 1, 1, 2, 3]))
    one["check_vma"] = bool(rng.random() < 0.5)
    one["clearance"] = one["scene"] == "clearance"
    if one["scene"] in SLOW_SCENES:
        one["periods"], one["lanes"] = 1, min(one["lanes"], 65)
    return one


def numbers(one):
    """Values of the numbers: arrays of lanes, or one number."""
    rng = np.random.default_rng([18, one["seed"]])
    ranges = dict(RANGES)
    if one["scene"] == "zero":
        ranges |= {"x": (0.05, 0.8), "left": (0.0, 0.0)}
    if one["scene"] == "overdamped":
        ranges["damping"] = (1.0, 2.5)
    if one["scene"] in ("inelastic", "elastic"):
        ranges["restitution"] = (float(one["scene"] == "elastic"),) * 2
    if one["scene"] == "undriven":
        ranges["amplitude"] = (0.0, 0.0)
    shape = {name: one["lanes"] if name in one["batched"] else None for name in NAMES}
    values = {name: rng.uniform(*ranges[name], shape[name]) for name in NAMES}
    if one["repeated"] and ("phase" in one["batched"]) == ("v" in one["batched"]):
        values["phase"] = values["v"]
    return {name: np.asarray(value, np.float64) for name, value in values.items()}


def scene_of(kind, p):
    """The scene of a kind with these numbers."""
    left, right, e = p["left"], p["right"], p["extra"]
    common = (p["amplitude"], p["frequency"], p["damping"], p["restitution"])
    if kind in ("one-sided", "zero"):
        return jv.make_scene(*common, (left, None))
    if kind == "moving":
        walls = (jv.Wall(left, motion=jv.Motion(e, 0.3, 2)), jv.Wall(right, motion=jv.Motion(0.05, e, 1)))
        return jv.make_scene(*common, walls)
    if kind in ("harmonics", "clearance"):
        return jv.make_scene(*common, (left, right), drive=((e, 3, 0.4), (0.2, 2, e)))
    if kind in ("soft", "soft-moving"):
        motion = jv.Motion(e, 0.1, 1) if kind == "soft-moving" else None
        soft = jv.Wall(left, stiffness=50.0 + e, damping=0.1, motion=motion)
        return jv.make_scene(*common[:3], None, (soft, jv.Wall(right, restitution=p["restitution"])))
    if kind == "duffing":
        force = jv.Force("duffing", {"cubic": 0.2 + e, "damping": 0.05})
        return jv.make_scene(common[0], common[1], restitution=p["restitution"], walls=(left, right), force=force)
    if kind == "springless":
        force = jv.Force("polynomial", {"c0": 0.5 + e, "damping": 0.02})
        return jv.make_scene(common[0], common[1], restitution=p["restitution"], walls=(left, right), force=force)
    if kind == "contact-law":
        force = jv.Force("duffing", {"cubic": 0.1, "damping": 0.02})
        soft = jv.Wall(right, stiffness=30.0 + e, damping=0.1)
        return jv.make_scene(common[0], common[1], walls=(jv.Wall(left, restitution=0.7), soft), force=force)
    return jv.make_scene(*common, (left, right))


def of_one(one, p):
    """A vector of one state's results."""
    scene, state = scene_of(one["scene"], p), jv.State(p["x"], p["v"], p["phase"])
    if one["function"] == "monodromy":
        return jnp.ravel(jv.monodromy(scene, state, one["periods"]))
    if one["function"] == "sample":
        end, _ = jv.sample(scene, state, jnp.linspace(0.0, 3.0, 4)[1:] + 0.1 * p["extra"])
        return jnp.concatenate([end.x, end.v])
    end, impacts = jv.strobe(scene, state, one["periods"], one["slots"], one["clearance"])
    if one["function"] == "impacts" and one["slots"]:
        known = jnp.isfinite(impacts.time)
        return jnp.concatenate([jnp.where(known, impacts.time, 0.0), impacts.speed])
    if one["clearance"] and one["derivative"] == "value":
        return jnp.stack([end.x, end.v, impacts.least_clearance])
    return jnp.stack([end.x, end.v])


def direction(one):
    """Tangents by the numbers that derivatives are by."""
    rng = np.random.default_rng([19, one["seed"]])
    tangents = rng.normal(size=len(one["by"]))
    return np.where(np.arange(len(tangents)) == 0, 0.0, tangents) if one["zero"] and len(tangents) > 1 else tangents


def weighted_sum(results):
    """Return a scalar function of a vector of results."""
    return jnp.sum(results * jnp.cos(jnp.arange(results.size, dtype=results.dtype)))


def derived(one, function):
    """The derivative that is asked for of a function of (numbers that it is by, the others)."""
    kind, way = one["derivative"], direction(one)

    def run(by, rest):
        def of(y):
            return function({**rest, **dict(zip(one["by"], y, strict=True))})

        tangents = [jnp.full_like(b, w) if w else jnp.zeros_like(b) for b, w in zip(by, way, strict=True)]

        def weighed(y):
            return weighted_sum(of(y))

        if kind == "value":
            return of(by)
        if kind == "jvp":
            return jax.jvp(of, (by,), (tangents,))[1]
        if kind == "linearize":
            return jax.linearize(of, by)[1](tangents)
        if kind == "vjp":
            return jax.grad(weighed)(by)
        if kind == "jacfwd":
            return jax.jacfwd(of)(by)
        if kind == "jacrev":
            return jax.jacrev(of)(by)
        if kind == "hessian":
            return jax.hessian(weighed)(by)
        return jax.jvp(jax.grad(weighed), (by,), (tangents,))[1]

    return run


def controlled(one, function):
    """function(p) within control flow that leaves its value as it is."""
    control = one["control"]
    same = jax.tree_util.Partial(function)

    def blank(p):
        return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(function, p))

    def run(p):
        if control == "scan":
            return jax.tree.map(lambda rows: rows[1], lax.scan(lambda c, _: (c + 1.0, same(p)), 0.0, None, 2)[1])
        if control == "while_loop":
            return lax.while_loop(lambda s: s[0] < 2, lambda s: (s[0] + 1, function(p)), (0, blank(p)))[1]
        if control == "fori_loop":
            return lax.fori_loop(0, 2, lambda _, s: function(p), blank(p))
        if control == "cond":
            return lax.cond(jax.tree.leaves(p)[0].sum() < 1e9, function, blank, p)
        if control == "switch":
            return lax.switch(jnp.int32(jax.tree.leaves(p)[0].sum() < 1e9), [blank, function], p)
        if control == "checkpoint":
            return jax.checkpoint(function)(p)
        if control == "custom_root":
            target = jax.tree.map(jnp.asarray, function(p))

            def residual(y):
                return jax.tree.map(lambda a, b: a - b, y, target)

            solve = lambda f, start: jax.tree.map(lambda a, r: a - r, start, f(start))  # noqa: E731
            return lax.custom_root(residual, blank(p), solve, lambda g, y: y)
        if control == "equinox":
            return eqx.filter_jit(eqx.filter_checkpoint(function))(p)
        return function(p)

    return run


def composed(one):
    """The composition, of (lanes that are batched, the other numbers): results with lanes first."""
    single = partial(of_one, one)
    single = single if one["inside"] else controlled(one, single)
    derivative = derived(one, single)

    def split(p):
        return derivative([p[name] for name in one["by"]], {name: p[name] for name in NAMES if name not in one["by"]})

    inner = controlled(one, split) if one["inside"] else split

    def lanes(batch, rest):
        run = lambda some: inner({**rest, **some})  # noqa: E731
        count = one["lanes"]
        if one["levels"] == 2 and count % 2 == 0:
            two = {name: value.reshape(2, -1) for name, value in batch.items()}
            out = jax.vmap(jax.vmap(run))(two)
            return jax.tree.map(lambda a: a.reshape(count, *a.shape[2:]), out)
        return jax.vmap(run)(batch)

    return lanes


def sharded(one, function):
    """function of (batch, rest), its lanes over two devices."""
    mesh = Mesh(np.array(jax.devices()[:2]), ("lanes",))  # the test with two devices is the last one here
    specs = PartitionSpec("lanes"), PartitionSpec()

    def of_a_device(batch, rest):
        if one["check_vma"]:  # the gradient by a number that all devices share is summed over them
            rest = jax.tree.map(lambda each: lax.pcast(jnp.asarray(each), "lanes", to="varying"), rest)
        return function(batch, rest)

    return jax.shard_map(of_a_device, mesh=mesh, in_specs=specs, out_specs=specs[0], check_vma=one["check_vma"])


def descended(one, function, batch, rest):
    """The results after two steps of a fit that leave the numbers as they are: a loop of Adam with a rate of 0."""
    state = optax.adam(0.0)

    def step(carry, _):
        values, moments = carry
        slopes = jax.tree.map(jnp.ones_like, values)
        updates, moments = state.update(slopes, moments)
        return (optax.apply_updates(values, updates), moments), function(values, rest)

    _, rows = lax.scan(step, (batch, state.init(batch)), None, 2)
    return jax.tree.map(lambda each: each[-1], rows)


def run(one):
    """(largest error of a value or derivative over its tolerance, lanes compared, lanes with a slow impact)."""
    values = numbers(one)
    if one["control"] == "shard_map":
        one = {**one, "lanes": max(2, one["lanes"] // 2 * 2)}
        values = numbers(one)
        inner = composed({**one, "levels": 1, "lanes": one["lanes"] // len(jax.devices()[:2])})
        function = sharded(one, inner)
    else:
        function = composed(one)
    batch = {name: jnp.asarray(values[name]) for name in one["batched"]}
    rest = {name: values[name] for name in NAMES if name not in one["batched"]}
    if one["control"] == "optax":
        inner = function
        function = lambda batch, rest: descended(one, inner, batch, rest)  # noqa: E731
    if one["passing"] == "closed over":
        closed = lambda batch: function(batch, rest)  # noqa: E731
        found = jax.jit(closed)(batch) if one["jit"] else closed(batch)
    else:
        rest = jax.tree.map(jnp.asarray, rest)
        found = jax.jit(function)(batch, rest) if one["jit"] else function(batch, rest)
    return compared(one, values, jax.device_get(found))


def compared(one, values, found):
    """As `run`, of what was found."""
    rng = np.random.default_rng([20, one["seed"]])
    some = rng.choice(one["lanes"], min(CHECKED, one["lanes"]), replace=False)
    worst, slow, bound = 0.0, 0, 1e-12 if one["derivative"] == "value" else 1e-9
    for k in some:
        p = {name: float(value[k]) if value.ndim else float(value) for name, value in values.items()}
        expected = reference(one, p)
        impacts = looked_at(one["scene"])(p)
        if float(impacts.least_speed) < SLOW or int(impacts.status):
            slow += 1
            continue
        got = jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], found)
        for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
            scale = max(1.0, float(np.max(np.abs(b), initial=0.0)))
            same = (np.isnan(a) & np.isnan(b)) | (a == b)
            error = np.where(same, 0.0, np.abs(np.where(same, 0.0, a - b)))
            worst = max(worst, float(np.max(np.nan_to_num(error, nan=np.inf), initial=0.0)) / (bound * scale))
    return {"error": worst, "compared": len(some), "slow": slow}


@cache
def looked_at(kind):
    """The impacts of one state in three periods, of a scene of this kind."""
    return jax.jit(lambda p: jv.strobe(scene_of(kind, p), jv.State(p["x"], p["v"], p["phase"]), 3, 40)[1])


def reference(one, p):
    """The same derivative of one state by forward mode, a direction at a time, without control flow or a batch."""
    kind, way = one["derivative"], direction(one)
    order = 0 if kind == "value" else 2 if kind in ("hessian", "jvp of vjp") else 1
    slots = one["slots"] if one["function"] == "impacts" else 0
    derivative = of_single(one["scene"], one["function"], one["periods"], slots, one["clearance"], order)
    if kind == "value":
        return np.asarray(derivative(p))
    axes = [{name: float(name == by) for name in NAMES} for by in one["by"]]
    if order == 2:
        hessian = np.array([[derivative(p, a, b) for b in axes] for a in axes])
        return [list(row) for row in hessian] if kind == "hessian" else list(hessian @ way)
    jacobian = np.stack([derivative(p, a) for a in axes], axis=-1)
    if kind in ("jvp", "linearize"):
        return jacobian @ way
    if kind == "vjp":
        return list(np.cos(np.arange(len(jacobian))) @ jacobian)
    return list(np.moveaxis(jacobian, -1, 0))


@cache
def of_single(kind, function, periods, slots, clearance, order):
    """Compile the value of one state, its directional derivative, or the second one of its weighted sum."""
    one = {"scene": kind, "function": function, "periods": periods, "slots": slots, "clearance": clearance}
    one["derivative"] = "value" if order == 0 else "jvp"

    def once(p, along):
        return jax.jvp(lambda q: of_one(one, q), (p,), (along,))[1]

    def twice(p, along, then):
        return jax.jvp(lambda q: weighted_sum(once(q, along)), (p,), (then,))[1]

    return jax.jit((lambda p: of_one(one, p), once, twice)[order])


@of_numbers
def test_compositions(kind, number):
    """A composition of transformations, control flow and batches gives the values and derivatives of single calls."""
    one = draw(kind.name, number)
    assert run(one)["error"] <= 1, one


def test_lanes_over_two_devices():
    """Compositions with `shard_map`, in a process that has two devices."""
    drawn = [draw("rigid", number) for number in range(300)]
    small = [one["jit"] and one["lanes"] < 65 and one["control"] == "shard_map" for one in drawn]
    number = small.index(True)
    line = "from tests.properties import test_transformations as t; import jax; assert len(jax.devices()) == 2; "
    line += f"assert t.run(t.draw('rigid', {number}))['error'] <= 1"
    environment = {**os.environ, "JAX_ENABLE_X64": "1", "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", line], cwd=root, env=environment, check=True, timeout=1800)
