"""What derivatives and orbits cost: derivatives over the plain strobe, in turn with it, and orbits on their own."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro
from benchmarks import harness, ours, page
from jaxvibro.compiled.compiler_hints import one_kernel
from jaxvibro.orbits import impact_equations
from jaxvibro.orbits.by_impacts import padded

ORBITS, REPEATS = 10_000, 501
OTHERS = ("restitution", "damping", "frequency")  # besides x, v and A


def compare(states, rounds):
    """Lines (what, asked, measured): derivatives of a batch of (n, 3) states x, x', A over its strobe, and orbits."""
    x, v, amplitude = given = tuple(jnp.asarray(states.T))
    base, many, start = ours.scene(1.0), ours.scene(amplitude), jaxvibro.State(x, v)

    def end(x, v, amplitude, **numbers):
        done, _ = jaxvibro.strobe(base.replace(amplitude=amplitude, **numbers), jaxvibro.State(x, v))
        return jnp.stack([done.x, done.v], -1)

    def weighed(x, v, amplitude):
        return jnp.sum(end(x, v, amplitude) @ jnp.array([1.0, 0.3]))

    def slopes(x, v, amplitude):
        of = jax.jacfwd(lambda six: end(*six[:3], **dict(zip(OTHERS, six[3:], strict=True))))
        return of(jnp.stack([x, v, amplitude, *(getattr(base, name) for name in OTHERS)]))

    def curves(x, v, amplitude):
        return jax.hessian(lambda z: end(*z, amplitude)[0])(jnp.stack([x, v]))

    def plain():
        jax.block_until_ready(jaxvibro.strobe(many, start))

    plain()
    return [
        *over(plain, rounds, "M = P Q, its strobe included", "at most 1.6", jaxvibro.monodromy, many, start),
        *over(plain, rounds, "2x2 by jacfwd under vmap", "at most 4", jax.vmap(jax.jacfwd(end, (0, 1))), *given),
        *over(plain, rounds, "gradient in x, v, A by reverse mode", "at most 3", jax.grad(weighed, (0, 1, 2)), *given),
        *orbits(rounds),
    ]


def over(plain, rounds, what, bound, function, *given):
    """Two lines: a function of a batch over the plain strobe of it, timed in turn; and its compile time."""
    seconds, call = harness.clock(lambda: jax.jit(function).lower(*given).compile())
    jax.block_until_ready(call(*given))
    ratios = []
    for _ in range(rounds):
        spent, _ = harness.clock(plain)
        ratios.append(harness.clock(lambda: jax.block_until_ready(call(*given)))[0] / spent)
    return [
        (f"{what}, over the strobe", bound, page.spread(harness.spread(np.array(ratios)))),
        (f"{what}: tracing and compiling, s", "at most 2", f"{seconds:.2f}"),
    ]


def orbits(rounds):
    """Lines for one orbit from a start that is 0.01 off, for all of `find_orbit`, and for many orbits under vmap."""
    scene = ours.scene(2.0)
    orbit = jaxvibro.find_orbit(scene, jaxvibro.State(0.9, -1.1))
    guess = padded(scene, orbit.impacts.time + 0.01, orbit.impacts.speed, orbit.impacts.side, 0.0, 1)
    late = 0.01 * np.random.default_rng(0).normal(size=(ORBITS, 2))
    guesses = jax.tree.map(lambda each: np.broadcast_to(each, (ORBITS, *np.shape(each))).copy(), guess)
    guesses = guesses._replace(times=guesses.times + late)
    kernel = jax.jit(lambda scene, guess: one_kernel(impact_equations.solved, scene, guess))
    seconds, one = harness.clock(lambda: kernel.lower(scene, guess).compile())
    batch = jax.vmap(impact_equations.solved, in_axes=(None, 0))
    more, many = harness.clock(lambda: jax.jit(batch).lower(scene, guesses).compile())
    spent = [harness.clock(lambda: jax.block_until_ready(many(scene, guesses)))[0] for _ in range(rounds + 1)][1:]
    newton = harness.latency(lambda: jax.block_until_ready(one(scene, guess)), REPEATS)
    whole = harness.latency(lambda: jaxvibro.find_orbit(scene, orbit.state, 1, settle=0), 101)
    per = 1e6 / ORBITS * np.array(spent)
    return [
        ("one orbit by Newton's method, microseconds", "at most 200", page.spread(newton)),
        ("find_orbit, settled, its checks included, microseconds", "(to be printed)", page.spread(whole)),
        (f"{ORBITS:,} orbits under vmap, microseconds each", "at most 5", page.spread(harness.spread(per))),
        ("one orbit; many: tracing and compiling, s", "at most 2", f"{seconds:.2f}; {more:.2f}"),
    ]
