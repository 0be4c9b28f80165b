"""What derivatives cost: over the plain strobe of the same batch, in turn with it."""

from functools import partial

import jax
import jax.numpy as jnp

import jaxvibro
from benchmarks import harness, ours, pictures
from benchmarks.rows import Row, Topic
from benchmarks.work import draw

STATES, ROUNDS = 32_768, 9
OTHERS = ("restitution", "damping", "frequency")  # besides x, v and A
OVER, COMPILING = "over the strobe", "seconds, tracing and compiling"
NOTES = (
    f"{STATES:,} random states of figure 4's kind, of which nothing is recorded; each under vmap and jit, in turn with "
    "their strobe from the host, which is called before and after. 2x2: x and v by x and v; 2x6: by A, R, gamma and "
    "omega too. The gradient is one of x + 0.3 v by x, v, A in reverse mode; the Hessian one of x by x, v, A, R.",
)


def measure(size):
    """The `Topic`."""
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
        Row("gradient by 3 numbers, reverse mode", OVER, 2.2): (weighed, numbers),
        Row("2x6 by jacfwd", OVER, 3): (jax.jacfwd(end), widened(OTHERS)),
        Row("Hessian by 4 numbers", OVER, 6): (bent, widened(OTHERS[:1])),
        Row("M = P Q, a route of its own", OVER): (matrix, numbers),
    }
    plain = ours.prepare_batch(states, slots=0)
    over, compiling = [], []
    for row, (function, given) in size.few(tuple(asked.items())):
        ratios, seconds = compared(jax.vmap(function), given, plain, size.rounds(ROUNDS))
        over.append(row.of(ratios))
        compiling.append(Row(row.what, COMPILING).of(seconds))
        print(f"  {row.what}: {over[-1].found[0]:.2f}, {seconds:.1f} s")
    title = f"Derivatives of the strobe of {STATES:,} states"
    drawn = partial(
        pictures.bars, groups={"derivative": over}, unit="time over the strobe, nothing recorded", title=title
    )
    what = "What derivatives cost, over the strobe"
    return Topic("derivatives", over + compiling, notes=NOTES, pictures={"derivatives.png": (what, drawn)})


def compared(function, given, plain, rounds):
    """A function's time over the plain strobe's, one number a round; and the seconds to trace and compile it."""
    seconds, call = harness.clock(lambda: jax.jit(function).lower(given).compile())
    return harness.in_turn(plain, lambda: jax.block_until_ready(call(given)), rounds)[1], seconds
