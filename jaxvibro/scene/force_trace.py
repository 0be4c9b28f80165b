"""What JAX traces of a force, and which of its operations have a Taylor series."""

from functools import lru_cache

from jax.extend import core

from .force import trace

SERIES = """add add_any sub mul div neg square integer_pow pow sqrt rsqrt cbrt exp exp2 expm1 log log1p sin cos sinh
cosh tan tanh logistic erf erfc asin acos atan asinh acosh atanh atan2 copy"""  # of which `flight.series` has rules
WITH_SERIES = frozenset(SERIES.split())
INNER = ("jaxpr", "call_jaxpr")  # the operations of one that is a function of its own
LOOPS = ("while", "scan", "cond")  # functions of their own that are not simply run once
STILL = """abs sign max min floor ceil round select_n clamp is_finite not and or eq ne lt le gt ge rem stop_gradient
convert_element_type"""  # what may be done to numbers that are the same at all times, besides what has a rule
PLAIN = frozenset(STILL.split())

traced = lru_cache(256)(trace)


@lru_cache(256)
def without_rule(function, names, dtype, given=3):
    """The names of the operations of a force of which no Taylor series is known, as a tuple; "... of arrays" where
    it is known of numbers alone. given: as of `trace`."""
    closed = traced(function, names, dtype, given)
    return tuple(sorted(_without(closed.jaxpr, [False] * given + [True] * len(names))[0]))


@lru_cache(256)
def depends_on_time(function, names, dtype):
    """Return True if the time t enters the value of a force."""
    jaxpr = traced(function, names, dtype).jaxpr
    return not all(_without(jaxpr, [False] + [True] * (len(jaxpr.invars) - 1))[1])


def _without(jaxpr, still):
    """(the names, whether each result is the same at all times), the inputs being so or not."""
    known = dict(zip(jaxpr.invars, still, strict=True)) | dict.fromkeys(jaxpr.constvars, True)
    found = set()
    for eqn in jaxpr.eqns:
        given = [is_literal(each) or known[each] for each in eqn.invars]
        inner = inner_of(eqn)
        if inner is not None:
            names, results = _without(inner.jaxpr, given)
            found |= names
        else:
            results = [all(given)] * len(eqn.outvars)
            of_arrays = any(each.aval.shape for each in (*eqn.invars, *eqn.outvars))
            if of_arrays or not _has_rule(eqn, all(given)):
                found.add(f"{eqn.primitive.name} of arrays" if of_arrays else eqn.primitive.name)
        known.update(zip(eqn.outvars, results, strict=True))
    return found, [is_literal(each) or known[each] for each in jaxpr.outvars]


def _has_rule(eqn, still):
    name = eqn.primitive.name
    if name == "convert_element_type":
        return still or _changes_nothing(eqn)
    return name in WITH_SERIES or (still and name in PLAIN)


def _changes_nothing(eqn):
    return eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype


def is_literal(variable):
    return isinstance(variable, core.Literal)


def inner_of(eqn):
    """The `ClosedJaxpr` of an operation that is a function of its own, run once, else None."""
    if eqn.primitive.name in LOOPS:
        return None
    for name in INNER:
        inner = eqn.params.get(name)
        if inner is not None:
            return inner if isinstance(inner, core.ClosedJaxpr) else core.ClosedJaxpr(inner, ())
    return None
