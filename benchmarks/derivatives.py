"""Measure the cost of derivatives relative to the plain stroboscopic map of the same batch, timed in turn."""

from functools import partial

import jax
import jax.numpy as jnp

import jaxvibro
from benchmarks import harness, ours, pictures
from benchmarks.rows import Row, Topic
from benchmarks.work import draw

STATES, ROUNDS = 32_768, 9
OTHERS = ("restitution", "damping", "frequency")  # besides x, v and A
OVER, COMPILING = "relative to the strobe", "seconds for tracing and compilation"
NOTES = (
    f"{STATES:,} random states like those of figure 4, without recorded impacts. Each derivative runs under vmap and "
    "jit and is timed between two calls of the strobe from the host.",
    "2x2: derivatives of x and v with respect to x and v. 2x6: also with respect to A, R, gamma and omega. Gradient: "
    "of x + 0.3 v with respect to x, v and A, in reverse mode. Hessian: of x with respect to x, v, A and R.",
)


def measure(size):
    """Measure this part and return its `Topic`."""
    states = draw(size.states(STATES))
    x, v, amplitude = (jnp.asarray(each) for each in states.T)
    base = ours.scene(1.0)
    numbers = jnp.stack([x, v, amplitude], -1)

    def end(given, names=OTHERS):
        scene = base.replace(amplitude=given[2], **dict(zip(names, given[3:], strict=False)))
        done, _ = jaxvibro.strobe(scene, jaxvibro.State(given[0], given[1]), slots=0)
        return jnp.stack([done.x, done.v])

    def of_state(given):
        return jax.jacfwd(lambda z: end(jnp.append(z, given[2])))(given[:2])

    def weighed(given):
        return jax.grad(lambda z: end(z) @ jnp.array([1.0, 0.3]))(given)

    def bent(given):
        return jax.hessian(lambda z: end(z)[0])(given)

    def widened(names):
        more = jnp.array([getattr(base, name) for name in names])
        return jnp.concatenate([numbers, jnp.broadcast_to(more, (len(numbers), len(names)))], 1)

    def matrix(given):
        return jaxvibro.monodromy(base.replace(amplitude=given[2]), jaxvibro.State(given[0], given[1]))

    asked = {
        Row("2x2 by jacfwd", OVER, 1.6): (of_state, numbers),
        Row("gradient in 3 numbers, reverse mode", OVER, 2.2): (weighed, numbers),
        Row("2x6 by jacfwd", OVER, 3): (jax.jacfwd(end), widened(OTHERS)),
        Row("Hessian in 4 numbers", OVER, 6): (bent, widened(OTHERS[:1])),
        Row("monodromy matrix as a product of P and Q", OVER): (matrix, numbers),
    }
    plain = ours.prepare_batch(states, slots=0)
    over, compiling = [], []
    for row, (function, given) in size.few(tuple(asked.items())):
        ratios, seconds = compared(jax.vmap(function), given, plain, size.rounds(ROUNDS))
        over.append(row.of(ratios))
        compiling.append(Row(row.what, COMPILING).of(seconds))
        print(f"  {row.what}: {over[-1].found[0]:.2f}, {seconds:.1f} s")
    title = f"Derivatives of the strobe of {STATES:,} states"
    drawn = partial(pictures.bars, groups={"derivative": over}, unit="time relative to the strobe", title=title)
    what = "Time of derivatives relative to the strobe"
    return Topic("derivatives", over + compiling, notes=NOTES, pictures={"derivatives.png": (what, drawn)})


def compared(function, given, plain, rounds):
    """Measure a function's time over the plain map's, one number per round, and the seconds to trace and compile it."""
    seconds, call = harness.clock(lambda: jax.jit(function).lower(given).compile())
    return harness.in_turn(plain, lambda: jax.block_until_ready(call(given)), rounds)[1], seconds
