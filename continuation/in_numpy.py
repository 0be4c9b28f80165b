"""Traced functions evaluated in NumPy, equation by equation: an answer without compiling.

Compiling takes a second and more, evaluating an equation half a microsecond. So what the host calls a few times is
evaluated, and compiled once that has cost about as much: never on more than twice the shorter way. The equations are
those that jax traces, derivatives included, so both ways have one source; their numbers differ by roundings.
"""

import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core

from .numpy_indexing import Unknown
from .numpy_rules import Rule, rules

PATIENCE = 2000  # times that all equations of a function are evaluated before it is compiled, which costs as much

PLAIN = {bool, int, float}  # types of numbers that jax takes for weak ones
SEVERAL = {"cond", "optimization_barrier", "scan", "sort", "split", "unstack", "while"}  # their functions give lists
CALLS = {"closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "jit", "pjit", "checkpoint"}
CALLED = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # names for the function that these call


class Evaluator:
    """A function's equations for arguments of one kind. size: how many there are; spent: how many were evaluated."""

    def __init__(self, closed):
        self.size, self.spent = 0, 0
        self.run = self.built(closed)

    def built(self, closed) -> Callable[..., list[Any]]:
        """(values of the arguments) -> those of the results, lists, of a closed jaxpr."""
        program = Program(self, len(closed.jaxpr.invars))
        results = program.written(closed, range(len(closed.jaxpr.invars)))
        begin, rows = program.values, program.needed(results)
        count, size, gather = len(rows), len(closed.jaxpr.invars), _getter(results)
        self.size += count

        def run(*given):
            self.spent += count
            values = begin.copy()
            values[:size] = given
            for function, get, out in rows:
                values[out] = function(*get(values))
            return list(gather(values))

        return run

    def function(self, equation) -> Rule:
        """The function of an equation's operands: its result, or a list of them."""
        name, given = equation.primitive.name, equation.params
        if name in rules:
            return rules[name](**given)
        if name == "while":
            return self.repeated(given)
        if name == "scan":
            return self.scanned(given, equation.outvars)
        if name == "cond":
            return _chosen([self.built(each) for each in given["branches"]])
        raise Unknown(name)

    def repeated(self, given):
        test, body = self.built(given["cond_jaxpr"]), self.built(given["body_jaxpr"])
        first, second = given["cond_nconsts"], given["cond_nconsts"] + given["body_nconsts"]

        def run(*values):
            asked, fixed, carry = values[:first], values[first:second], values[second:]
            while (on := test(*asked, *carry)[0]).any():  # of lanes, those that are through stay as they are
                new = body(*fixed, *carry)
                carry = [_kept(on, *each) for each in zip(new, carry, strict=True)] if on.ndim else new
            return carry

        return run

    def scanned(self, given, outvars):
        body, fixed, carried = self.built(given["jaxpr"]), given["num_consts"], given["num_carry"]
        order = range(given["length"])[:: -1 if given["reverse"] else 1]
        kinds = [(var.aval.shape, var.aval.dtype) for var in outvars[carried:]]

        def run(*values):
            constant, carry = values[:fixed], values[fixed : fixed + carried]
            rows = [np.empty(*kind) for kind in kinds]
            for k in order:
                found = body(*constant, *carry, *[each[k] for each in values[fixed + carried :]])
                carry = found[:carried]
                for row, one in zip(rows, found[carried:], strict=True):
                    row[k] = one
            return [*carry, *rows]

        return run


class Program:
    """The equations of a jaxpr in a row, those of the functions it calls among them, each once. values: of the
    arguments, which come first, left open; of what is constant; and of the rest, left open."""

    def __init__(self, evaluator, arguments):
        self.evaluator, self.values, self.rows = evaluator, [None] * arguments, []
        self.fixed, self.known = set(), {}

    def written(self, closed, arguments):
        """The places of a closed jaxpr's results, its arguments being at some places."""
        jaxpr = closed.jaxpr
        places = dict(zip(jaxpr.invars, arguments, strict=True))
        places |= {var: self.constant(value) for var, value in zip(jaxpr.constvars, closed.consts, strict=True)}

        def place(var):
            if isinstance(var, core.Literal):
                return self.constant(np.asarray(var.val, var.aval.dtype))
            return places[var]

        for equation in jaxpr.eqns:
            given = tuple(map(place, equation.invars))
            inner = next((equation.params[key] for key in CALLED if key in equation.params), None)
            if equation.primitive.name in CALLS and isinstance(inner, core.ClosedJaxpr):
                found = self.written(inner, given)
            else:
                found = self.row(equation, given)
            places |= zip(equation.outvars, found, strict=True)
        return [place(var) for var in jaxpr.outvars]

    def constant(self, value):
        value = np.asarray(value)[()]
        key = (value.shape, value.dtype, value.tobytes())
        if key not in self.known:
            self.known[key] = len(self.values)
            self.fixed.add(len(self.values))
            self.values.append(value)
        return self.known[key]

    def row(self, equation, given):
        """The places of an equation's results: known ones where it has been written, or is of constants alone."""
        name, params = equation.primitive.name, tuple(sorted(equation.params.items()))
        one = name not in SEVERAL
        key = (name, params, given)
        try:
            if key in self.known:
                return self.known[key]
        except TypeError:  # a parameter that cannot be compared is none of a rule's
            key = None
        function = self.evaluator.function(equation)
        if one and self.fixed.issuperset(given):
            with np.errstate(all="ignore"):
                found = [self.constant(function(*[self.values[place] for place in given]))]
        else:
            first, last = len(self.values), len(self.values) + len(equation.outvars)
            found = list(range(first, last))
            self.values += [None] * len(found)
            self.rows.append((function, given, first if one else slice(first, last), found))
        if key is not None:
            self.known[key] = found
        return found

    def needed(self, results):
        """[(function, what takes its operands of the values, the place of its result or those of several)] of the rows
        that some results need."""
        asked, kept = set(results), []
        for function, given, out, found in reversed(self.rows):
            if not asked.isdisjoint(found):
                asked.update(given)
                kept.append((function, _getter(given), out))
        return kept[::-1]


def _getter(places):
    """(list) -> the values at some places, as a tuple or list."""
    if len(places) > 1:
        return operator.itemgetter(*places)
    first = places[0] if places else 0
    return operator.itemgetter(slice(first, first + len(places)))


def _kept(on, new, old):
    return np.where(on.reshape(on.shape + (1,) * (new.ndim - on.ndim)), new, old)


def kind_of(args, static):
    """(the numbers of a function's arguments in a row; what decides how it is traced, a key). static: places of
    arguments that are no numbers."""
    leaves, form = jax.tree.flatten([each for place, each in enumerate(args) if place not in static])
    kinds = [type(leaf) if type(leaf) in PLAIN else (leaf.shape, leaf.dtype) for leaf in leaves]
    return leaves, (form, tuple(kinds), tuple([args[place] for place in static]), jax.config.jax_enable_x64)


def _chosen(branches):
    return lambda which, *values: branches[min(max(int(which), 0), len(branches) - 1)](*values)


class Tried(NamedTuple):
    """How a function is evaluated for each kind of arguments that it has met. static: places of arguments that are no
    numbers; known: {kind: (`Evaluator`, form of the result), None where there is no rule or what is compiled is kept};
    is_kept: whether it is, for arguments like these."""

    function: Callable[..., Any]
    static: Sequence[int]
    known: dict[Any, Any]
    is_kept: Callable[[tuple[Any, ...]], bool] = lambda args: False

    def __call__(self, args: tuple[Any, ...]) -> Any:
        """The function's result; None, which it never is, where it is to be compiled."""
        return self.of_kind(args, *kind_of(args, self.static))

    def of_kind(self, args: tuple[Any, ...], leaves: Sequence[Any], kind: Any) -> Any:
        """The same of arguments with these numbers and of this kind (`kind_of`)."""
        if kind not in self.known:
            self.known[kind] = None if self.is_kept(args) else self.traced(args)
        evaluator, result = self.known[kind] or (None, None)
        if evaluator is None or evaluator.spent >= PATIENCE * evaluator.size:
            return None
        with np.errstate(all="ignore"):
            return jax.tree.unflatten(result, evaluator.run(*[np.asarray(leaf)[()] for leaf in leaves]))

    def traced(self, args: tuple[Any, ...]) -> tuple[Evaluator, Any] | None:
        """(`Evaluator`, form of the result) for arguments like these; None where an equation has no rule."""
        traced = jax.jit(self.function, static_argnums=tuple(self.static)).trace(*args)
        try:
            return Evaluator(traced.jaxpr), jax.tree.structure(traced.out_info)
        except Unknown:
            return None
