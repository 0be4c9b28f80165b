"""Random compositions of JAX transformations around the map, compared with a loop of single calls.

The numbers of scene and state are named by their place in the pair (scene, state). A defect here may end the process in
XLA's compiler: a worker that dies is a failure.
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
from tests.kinds import KINDS, LANES, NUMBERS, TAME, draw_rows
from tests.tiers import of_numbers

from .motions import decided, strobe, take

CHECKED = 6  # lanes of a batch that are compared with single calls
FUNCTIONS = ("strobe", "strobe", "strobe", "clearance", "impacts", "sample", "monodromy")
DERIVATIVES = ("value", "jvp", "vjp", "jacfwd", "jacrev", "hessian", "linearize", "jvp of vjp")
SECOND = ("hessian", "jvp of vjp")
LOOPS = ("none", "scan", "while_loop", "fori_loop", "nested")
CONTROLS = (*LOOPS, "cond", "switch", "checkpoint", "shard_map", "custom_root", "equinox", "optax")
SIZES = (1, 2, 3, 7, 16, 64, 65, 210, 600, 2000)  # lanes
FEW = ("soft_wall", "soft_and_rigid", "soft_moving", "duffing", "gravity", "solver", "contact_law")  # slow to compile


def draw(kind, number):
    """Return the choices of one composition, reproducible from the number; strata take turns."""
    seed = list(KINDS).index(kind) + len(KINDS) * number
    rng = np.random.default_rng([17, seed])
    function = str(rng.choice(FUNCTIONS))
    derivative = "value" if function == "monodromy" else DERIVATIVES[seed % len(DERIVATIVES)]
    control = CONTROLS[(seed // 3) % len(CONTROLS)]
    largest = 6 if derivative in SECOND or kind in FEW else len(SIZES)
    scene, state = KINDS[kind].batch(draw_rows(seed, int(rng.choice(SIZES[:largest])), rng.choice([TAME, NUMBERS])))
    places, tree = jax.tree.flatten_with_path((scene, state))
    names = [jax.tree_util.keystr(path) for path, _ in places]
    values = {name: leaf for name, (_, leaf) in zip(names, places, strict=True)}
    scalars = [name for name in names if not np.ndim(values[name])]
    shared = [name for name in names if rng.random() < 0.3 and not name.endswith((".x", ".position"))]
    shared = [name for name in shared if name not in scalars]
    candidates = [name for name in names if not name.endswith(".contact")]
    return SimpleNamespace(
        seed=seed,
        kind=kind,
        tree=tree,
        function=function,
        derivative=derivative,
        control=control,
        inside=control in ("while_loop", "fori_loop") or bool(rng.random() < 0.5),  # the derivative, within the control
        count=len(state.x),
        values=values | {name: values[name][0] for name in shared},
        scalars=scalars,
        batched=[name for name in names if name not in (*shared, *scalars)],
        by=sorted(rng.choice(candidates, rng.integers(1, 5), replace=False).tolist()),
        zero=bool(rng.random() < 0.3),  # a tangent that is zero
        repeated=bool(rng.random() < 0.3),  # one array for two numbers
        jit=bool(rng.random() < 0.85),
        closed_over=bool(rng.random() < 0.5),  # numbers that have no lanes
        levels=int(rng.integers(1, 3)),
        slots=int(rng.choice([0, 1, 4, 9, 40])),
        periods=1 if kind in FEW else int(rng.choice([1, 1, 2])),
        check_vma=bool(rng.random() < 0.5),
    )


def of_one(one, p):
    """Return a vector of one state's results."""
    scene, state = one.tree.unflatten([p[name] for name in one.values])
    if one.function == "monodromy":
        return jnp.ravel(jv.monodromy(scene, state, one.periods))
    if one.function == "sample":
        end, _ = jv.sample(scene, state, 2.0 * jnp.pi / scene.frequency * jnp.array([0.3, 0.7, 1.4]))
        return jnp.concatenate([end.x, end.v])
    end, impacts = jv.strobe(scene, state, one.periods, one.slots, one.function == "clearance")
    if one.function == "impacts" and one.slots:
        return jnp.concatenate([jnp.where(jnp.isfinite(impacts.time), impacts.time, 0.0), impacts.speed])
    if one.function == "clearance" and one.derivative == "value":
        return jnp.stack([end.x, end.v, impacts.least_clearance])
    return jnp.stack([end.x, end.v])


def direction(one):
    """Return tangents by the numbers that derivatives are by."""
    tangents = np.random.default_rng([19, one.seed]).normal(size=len(one.by))
    return np.where(np.arange(len(tangents)) == 0, 0.0, tangents) if one.zero and len(tangents) > 1 else tangents


def weighted_sum(results):
    """Return a scalar function of a vector of results."""
    return jnp.sum(results * jnp.cos(jnp.arange(results.size, dtype=results.dtype)))


def derived(one, function):
    """Return the derivative of a function of all numbers, as one of (numbers that it is by, the others)."""

    def run(by, rest):
        def of(y):
            return function({**rest, **dict(zip(one.by, y, strict=True))})

        def weighed(y):
            return weighted_sum(of(y))

        tangents = [
            jnp.full_like(b, way) if way else jnp.zeros_like(b) for b, way in zip(by, direction(one), strict=True)
        ]
        if one.derivative == "value":
            return of(by)
        if one.derivative == "jvp":
            return jax.jvp(of, (by,), (tangents,))[1]
        if one.derivative == "linearize":
            return jax.linearize(of, by)[1](tangents)
        if one.derivative == "jvp of vjp":
            return jax.jvp(jax.grad(weighed), (by,), (tangents,))[1]
        if one.derivative in ("vjp", "hessian"):
            return {"vjp": jax.grad, "hessian": jax.hessian}[one.derivative](weighed)(by)
        return getattr(jax, one.derivative)(of)(by)

    return run


def controlled(control, function):
    """Return function(p) within control flow that leaves its value as it is."""

    def blank(p):
        return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(function, p))

    def run(p):
        if control == "scan":
            return jax.tree.map(lambda rows: rows[1], lax.scan(lambda c, _: (c + 1.0, function(p)), 0.0, None, 2)[1])
        if control == "while_loop":
            return lax.while_loop(lambda s: s[0] < 2, lambda s: (s[0] + 1, function(p)), (0, blank(p)))[1]
        if control == "fori_loop":
            return lax.fori_loop(0, 2, lambda _, s: function(p), blank(p))
        if control == "nested":
            return controlled("scan", controlled("cond", function))(p)
        if control == "cond":
            return lax.cond(jax.tree.leaves(p)[0].sum() < 1e9, function, blank, p)
        if control == "switch":
            return lax.switch(jnp.int32(jax.tree.leaves(p)[0].sum() < 1e9), [blank, function], p)
        if control == "custom_root":
            target = jax.tree.map(jnp.asarray, function(p))

            def residual(y):
                return jax.tree.map(lambda a, b: a - b, y, target)

            def solve(f, start):
                return jax.tree.map(lambda a, r: a - r, start, f(start))

            return lax.custom_root(residual, blank(p), solve, lambda g, y: y)
        wrapper = {"checkpoint": jax.checkpoint, "equinox": lambda f: eqx.filter_jit(eqx.filter_checkpoint(f))}
        return wrapper.get(control, lambda f: f)(function)(p)

    return run


def composed(one):
    """Return the composition, of (numbers with lanes, the other numbers): results with lanes first."""
    single = partial(of_one, one)
    derivative = derived(one, single if one.inside else controlled(one.control, single))

    def split(p):
        return derivative(
            [p[name] for name in one.by], {name: value for name, value in p.items() if name not in one.by}
        )

    inner = controlled(one.control, split) if one.inside else split

    def lanes(batch, rest):
        def run(some):
            return inner({**rest, **some})

        (count,) = {len(value) for value in batch.values()}
        if one.levels == 2 and count % 2 == 0:
            two = jax.tree.map(lambda value: value.reshape(2, -1), batch)
            return jax.tree.map(lambda a: a.reshape(count, *a.shape[2:]), jax.vmap(jax.vmap(run))(two))
        return jax.vmap(run)(batch)

    return lanes


def sharded(one, function):
    """Return a function of (batch, rest) with its lanes over two devices, or one."""
    mesh = Mesh(np.array(jax.devices()[:2]), ("lanes",))
    specs = PartitionSpec("lanes"), PartitionSpec()

    def of_a_device(batch, rest):
        if one.check_vma:  # the gradient by a number that all devices share is summed over them
            rest = jax.tree.map(lambda each: lax.pcast(jnp.asarray(each), "lanes", to="varying"), rest)
        return function(batch, rest)

    return jax.shard_map(of_a_device, mesh=mesh, in_specs=specs, out_specs=specs[0], check_vma=one.check_vma)


def descended(function, batch, rest):
    """Return the results after two steps of a fit that leave the numbers as they are: a loop of Adam, rate 0."""
    optimiser = optax.adam(0.0)

    def step(carry, _):
        values, moments = carry
        updates, moments = optimiser.update(jax.tree.map(jnp.ones_like, values), moments)
        return (optax.apply_updates(values, updates), moments), function(values, rest)

    _, rows = lax.scan(step, (batch, optimiser.init(batch)), None, 2)
    return jax.tree.map(lambda each: each[-1], rows)


def error_of(one):
    """Return the largest error of a value or derivative over its tolerance."""
    count, function = one.count, composed(one)
    if one.control == "shard_map":
        count -= count % len(jax.devices()[:2])
        function = sharded(one, function)
    if one.control == "optax":
        function = partial(descended, function)
    batch = {name: jnp.asarray(one.values[name][:count]) for name in one.batched}
    if one.repeated and "[1].v" in batch and "[1].phase" in batch:
        batch["[1].phase"] = batch["[1].v"]
    rest = {name: value for name, value in one.values.items() if name not in batch}
    if one.closed_over:
        found = (jax.jit(partial(function, rest=rest)) if one.jit else partial(function, rest=rest))(batch)
    else:
        found = (jax.jit(function) if one.jit else function)(batch, jax.tree.map(jnp.asarray, rest))
    return compared(one, rest | batch, jax.device_get(found), count)


def compared(one, values, found, count):
    """Return the largest error of some lanes over its tolerance; those that rounding decides are left out."""
    some = np.random.default_rng([20, one.seed]).integers(0, count, LANES)
    lanes = {
        name: value if name in one.scalars else np.broadcast_to(value, count)[some] for name, value in values.items()
    }
    kind, (scene, start) = KINDS[one.kind], one.tree.unflatten([lanes[name] for name in one.values])
    fair, bound = np.ones(LANES, bool), np.ones(LANES)
    for _ in range(2):
        end, impacts = strobe(scene, start)
        keep, grown = decided(kind, scene, start, end, impacts)
        start, fair, bound = end, fair & keep, bound * (1.0 + grown / kind.tolerance)
    bound *= kind.tolerance * (1e-2 if one.derivative == "value" else 1.0)
    worst = 0.0
    for lane in np.flatnonzero(fair)[:CHECKED]:
        expected, computed = reference(one, take(lanes, lane)), take(found, some[lane])
        for a, b in zip(jax.tree.leaves(computed), jax.tree.leaves(expected), strict=True):
            same = (np.isnan(a) & np.isnan(b)) | (a == b)
            error = np.nan_to_num(np.where(same, 0.0, np.abs(np.where(same, 0.0, a - b))), nan=np.inf)
            scale = max(1.0, float(np.max(np.abs(b), initial=0.0)))
            worst = max(worst, float(np.max(error, initial=0.0)) / (bound[lane] * scale))
    return worst


def reference(one, p):
    """Return the same derivative of one state by forward mode, a direction at a time, without control flow or batch."""
    order = 0 if one.derivative == "value" else 2 if one.derivative in SECOND else 1
    slots = one.slots if one.function == "impacts" else 0
    derivative = of_single(one.tree, tuple(one.values), one.function, one.periods, slots, order)
    if order == 0:
        return np.asarray(derivative(p))
    axes, way = [{name: float(name == by) for name in p} for by in one.by], direction(one)
    if order == 2:
        hessian = np.array([[derivative(p, a, b) for b in axes] for a in axes])
        return [list(row) for row in hessian] if one.derivative == "hessian" else list(hessian @ way)
    jacobian = np.stack([derivative(p, a) for a in axes], axis=-1)
    if one.derivative in ("jvp", "linearize"):
        return jacobian @ way
    if one.derivative == "vjp":
        return list(np.cos(np.arange(len(jacobian))) @ jacobian)
    return list(np.moveaxis(jacobian, -1, 0))


@cache
def of_single(tree, names, function, periods, slots, order):
    """Compile the value of one state, its directional derivative, or the second one of its weighted sum."""
    one = SimpleNamespace(tree=tree, values=names, function=function, periods=periods, slots=slots)
    one.derivative = "value" if order == 0 else "jvp"

    def once(p, along):
        return jax.jvp(partial(of_one, one), (p,), (along,))[1]

    def twice(p, along, then):
        return jax.jvp(lambda q: weighted_sum(once(q, along)), (p,), (then,))[1]

    return jax.jit((partial(of_one, one), once, twice)[order])


@of_numbers
def test_compositions(kind, number):
    """A composition of transformations, control flow and batches gives the values and derivatives of single calls."""
    assert error_of(draw(kind.name, number)) <= 1.0


def test_lanes_over_two_devices():
    """A composition with `shard_map`, in a process that has two devices."""
    drawn = [draw("two_walls", number) for number in range(100)]
    number = [one.jit and one.control == "shard_map" and 1 < one.count < 65 for one in drawn].index(True)
    line = "from tests.properties import test_transformations as t; import jax; assert len(jax.devices()) == 2; "
    line += f"assert t.error_of(t.draw('two_walls', {number})) <= 1.0"
    environment = {**os.environ, "JAX_ENABLE_X64": "1", "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", line], cwd=root, env=environment, check=True, timeout=1800)
