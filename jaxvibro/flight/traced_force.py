"""The Taylor series of a motion under a force of the user's own, operation by operation of what JAX traces of it."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from ..compiled.compiler_hints import stage
from ..scene.force_trace import inner_of, is_literal, traced
from .series import RULES, Series, Square, added, times


@lru_cache(256)
def is_series_of_root(function, names, dtype):
    """Whether the push of a wall is a power series in the root of the depth, also at the depth 0."""
    closed, one = traced(function, names, dtype, 2), np.ones((), dtype)
    with jax.ensure_compile_time_eval():
        depth = Square(Series(lambda own, k: None, 0.0 * one, one))
        rate = Series(lambda own, k: None, 0.3 * one, one)
        (found,) = _run(closed, [depth, rate, *(Series(None, 0.7 * one) for _ in names)])
        return all(found[k] is None or bool(jnp.isfinite(found[k])) for k in range(4))


def along(force, time, x, v):
    """The `Series` of a force where t, x and v are these `Series`."""
    return _series(force, np.dtype(jnp.result_type(*jax.tree.leaves((x[0], v[0])))), [time, x, v])


def pushed(law, depth, rate):
    """The `Series` of a wall's push, of a depth that is the `Square` of its root."""
    return _series(law, np.dtype(jnp.result_type(*jax.tree.leaves((depth[0], rate[0])))), [depth, rate])


def _series(force, dtype, given):
    """The `Series` of a function of these, and of its numbers."""
    closed = traced(force.function, tuple(force.numbers), dtype, len(given))
    (found,) = _run(closed, [*given, *(Series(None, number) for number in force.numbers.values())])
    return found


def _run(closed, given):
    known = dict(zip(closed.jaxpr.invars, given, strict=True))
    known |= {name: Series(None, value) for name, value in zip(closed.jaxpr.constvars, closed.consts, strict=True)}

    def read(variable):
        return Series(None, variable.val) if is_literal(variable) else known[variable]

    for eqn in closed.jaxpr.eqns:
        ins = [read(each) for each in eqn.invars]
        inner = inner_of(eqn)
        if inner is not None:
            outs = _run(inner, ins)
        elif all(each.constant for each in ins):
            outs = [Series(None, _plainly(eqn, [each[0] for each in ins]))]
        elif eqn.primitive.name == "convert_element_type":
            outs = ins
        else:
            outs = [RULES[eqn.primitive.name](ins, **eqn.params)]
        known.update(zip(eqn.outvars, outs, strict=True))
    return [read(each) for each in closed.jaxpr.outvars]


def _plainly(eqn, given):
    """The result of an operation on numbers that are the same at all times, lanes or not."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, given))
    return eqn.primitive.bind(*(jnp.broadcast_to(jnp.asarray(each), shape) for each in given), **eqn.params)


def motion(force, time, x, v, drive, order):
    """The coefficients of x, from the constant up to an order, of the motion that is at x, v at a time t; drive: those
    of another force, order - 1 of them."""
    start = Series(lambda own, k: _next(acceleration[k - 2], drive[k - 2], k), x, v)
    speed = Series(lambda own, k: times(k + 1.0, start[k + 1]), v)
    acceleration = along(force, Series(lambda own, k: None, time, 1.0), start, speed)
    return [start[k] for k in range(order + 1)]


def _next(own, drive, k):
    return stage(_over, own, drive, share=1.0 / (k * (k - 1)))


def _over(own, drive, share):
    return share * added(own, drive)


def forced(force, frequency, cosine, sine, count):
    """The first coefficients of force cos(omega t), where its phasor is this."""
    return stage(_forced, force, frequency, cosine, sine, count=count)


def _forced(force, frequency, cosine, sine, count):
    found = [force * cosine, -(force * sine) * frequency]
    square = frequency * frequency
    for k in range(2, count):
        found.append(found[k - 2] * (square * (-1.0 / (k * (k - 1)))))
    return found[:count]
