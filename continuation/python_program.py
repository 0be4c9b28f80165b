"""A traced function's equations as one Python function: small arrays number by number, large ones by NumPy's rules.

On a few numbers Python's own arithmetic is ten times as fast as NumPy's, and moving numbers about, which is half of
what jax traces, costs nothing: the rule of a move is asked once, where the numbers stand.
"""

import marshal
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core
from jax.interpreters import partial_eval

from . import python_forms
from .numpy_indexing import Unknown
from .numpy_rules import COMPILED, rules
from .python_literals import NAMED, literal, rule_text
from .python_text import Block, Chosen, Line, Repeated, count, needed, written

SMALL = 20  # numbers of an array that are written one by one
KINDS = tuple(map(np.dtype, (np.float64, bool, np.int32, np.int64)))  # of which Python has the same
CALLS = {"closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "jit", "pjit", "checkpoint"}
CALLED = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # names for the function that these call

Value = Any  # of a variable: the numbers of its entries, an array of its shape, where it is small; else its own number


def is_small(kind):
    return math.prod(kind.shape) <= SMALL and np.dtype(kind.dtype) in KINDS


def divided(x, y):
    """x / y where y is zero or no number, as the processor has it."""
    return float(np.divide(x, y))


def wrapped(bits, x):
    """A whole number of so many bits."""
    half = 1 << (bits - 1)
    return (x + half) % (2 * half) - half


def kept_lanes(on, new, old):
    """Of lanes: the new values of those that go on."""
    return np.where(on.reshape(on.shape + (1,) * (new.ndim - on.ndim)), new, old)


def without_unused(closed):
    """A closed jaxpr without equations that no result needs, those within the functions that it calls among them."""
    jaxpr, _ = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
    return closed.replace(jaxpr=jaxpr)


SPACE: dict[str, Any] = {"np": np, "math": math, "nan": math.nan, "inf": math.inf, "rules": rules} | NAMED
SPACE |= {each.__name__: each for each in (divided, wrapped, kept_lanes)}  # what a text may name


class Program(NamedTuple):
    """run: (values of the arguments) -> (the results, how many lines were run); size: the lines; text: Python's, which
    gives both, None where it would need what no text holds."""

    run: Callable[..., tuple[list[Any], int]]
    size: int
    text: str | None = None


def program(closed: core.ClosedJaxpr) -> Program:
    """That of a closed jaxpr. Raises Unknown where an equation has no rule."""
    writer = Writer(closed)
    space = SPACE | writer.held
    exec(writer.text, space)  # the text is the writer's own, of a jaxpr
    return Program(space["run"], space["size"], None if writer.held else writer.text)


def code_of(text: str) -> bytes:
    """Translate a program's text as Python does for its own cache, so that a later process need not."""
    return marshal.dumps(compile(text, "<program>", "exec", dont_inherit=True))


def of_code(content: bytes) -> Program:
    """The program whose text `code_of` has translated: executed, so the content must come from a source that is trusted
    and be undamaged (`cache_file`)."""
    space = dict(SPACE)
    exec(marshal.loads(content), space)
    return Program(space["run"], space["size"])


class Writer:
    """The text of a closed jaxpr's program. held: functions and arrays that it names and cannot hold."""

    def __init__(self, closed):
        self.count, self.texts, self.values, self.constants = 0, {}, {}, {}
        self.names, self.held = {}, {}  # {text of a function or an array: its name}, {name: what has no text}
        self.block = Block()
        arguments, given = [self.new() for _ in closed.jaxpr.invars], []
        for one, var in zip(arguments, closed.jaxpr.invars, strict=True):
            given.append(self.unpacked(one, var.aval) if is_small(var.aval) else one)
        found = self.equations(without_unused(closed), given)
        results = [self.whole(*each) for each in zip(found, _kinds(closed.jaxpr.outvars), strict=True)]
        lines = needed(self.block.lines, set(results))
        text = [f"{name} = {each}" for each, name in self.names.items()]
        text += [f"size = {count(lines)}", f"def run({', '.join(map(self.name, arguments))}):"]
        text += [f"    spent = {len(lines)}", *written(lines, self.name, "    ")]
        text.append(f"    return [{', '.join(map(self.name, results))}], spent")
        self.text = "\n".join(text)

    # values

    def new(self):
        self.count += 1
        return self.count

    def name(self, one):
        return self.texts.get(one) or f"v{one}"

    def constant(self, value: Any) -> int:
        """A number of Python's, or an array."""
        small = isinstance(value, float | int)
        key = (type(value), repr(value)) if small else (value.shape, value.dtype, value.tobytes())
        if key not in self.constants:
            one = self.constants[key] = self.new()
            self.values[one], self.texts[one] = (
                value,
                repr(value) if small else self.named(value, partial(literal, value)),
            )
            if small and self.texts[one].startswith("-"):
                self.texts[one] = f"({self.texts[one]})"
        return self.constants[key]

    def constants_of(self, array: Any, kind: Any) -> Value:
        array = np.asarray(array, kind.dtype)
        if not is_small(kind):
            return self.constant(array[()])
        return np.array([self.constant(each) for each in array.ravel().tolist()], int).reshape(array.shape)

    def known(self, value: Value, kind: Any) -> Any:
        """A constant as an array, None where it is none."""
        if not isinstance(value, np.ndarray):
            return self.values.get(value)
        ids = value.ravel().tolist()
        if any(one not in self.values for one in ids):
            return None
        return np.array([self.values[one] for one in ids], kind.dtype).reshape(value.shape)[()]

    def line(self, text: str, given: Sequence[int], count: int | None = None, key: Any = None) -> Any:
        """What a text gives of some values, once: one value, or a list of so many."""
        key = (text if key is None else key, tuple(given))
        found = self.block.find(key)
        if found is None:
            found = [self.new() for _ in range(count or 1)] if count != 0 else []
            self.block.lines.append(Line(found, given, text, count is not None))
            self.block.known[key] = found
        return found[0] if count is None else found

    def whole(self, value: Value, kind: Any) -> int:
        """As one value of NumPy's."""
        if not isinstance(value, np.ndarray):
            return value
        constant = self.known(value, kind)
        if constant is not None:
            return self.constant(constant)
        ids, dtype = value.ravel().tolist(), f"np.{np.dtype(kind.dtype).name}"
        dtype = "np.bool_" if dtype == "np.bool" else dtype
        if not value.ndim:
            return self.line(f"{dtype}({{0}})", ids)
        places = ", ".join(f"{{{k}}}" for k in range(len(ids)))
        shaped = f".reshape({value.shape})" if value.ndim > 1 else ""
        return self.line(f"np.array([{places}], {dtype}){shaped}", ids)

    def unpacked(self, one: int, kind: Any) -> Value:
        """As numbers of Python's."""
        if not kind.shape:
            return np.array(self.line("{0}.item()", [one]))
        return np.array(self.line("{0}.ravel().tolist()", [one], math.prod(kind.shape)), int).reshape(kind.shape)

    def named(self, value: Any, told: Callable[[], str]) -> str:
        """The name of a function or an array. told: gives its text, raises Unknown where it has none."""
        try:
            text = told()
        except Unknown:
            name = f"h{self.new()}"
            self.held[name] = value
            return name
        return self.names.setdefault(text, f"n{len(self.names)}")

    # equations

    def equations(self, closed: Any, given: Sequence[Value]) -> list[Value]:
        """The values of a closed jaxpr's results, those of its arguments being given."""
        jaxpr = closed.jaxpr
        places = dict(zip(jaxpr.invars, given, strict=True))
        for var, value in zip(jaxpr.constvars, closed.consts, strict=True):
            places[var] = self.constants_of(value, var.aval)

        def place(var):
            if isinstance(var, core.Literal):
                return self.constants_of(var.val, var.aval)
            return places[var]

        for equation in jaxpr.eqns:
            found = self.equation(equation, [place(var) for var in equation.invars])
            places |= zip(equation.outvars, found, strict=True)
        return [place(var) for var in jaxpr.outvars]

    def equation(self, equation: Any, given: list[Value]) -> list[Value]:
        name, params = equation.primitive.name, equation.params
        inner = next((params[key] for key in CALLED if key in params), None)
        if isinstance(inner, core.ClosedJaxpr) and (name in CALLS or "call_jaxpr" in params):
            return self.equations(inner, given)
        if name == "while":
            return self.repeated(params, given, _kinds(equation.outvars))
        if name == "scan":
            return self.scanned(params, given, _kinds(equation.outvars))
        if name == "cond":
            return self.chosen(params["branches"], given, _kinds(equation.outvars))
        if name not in rules or any(var.aval.dtype.kind in COMPILED.get(name, "") for var in equation.invars):
            raise Unknown(name)
        return self.primitive(name, params, given, _kinds(equation.invars), _kinds(equation.outvars))

    def primitive(self, name, params, given, kinds, outs):
        several = name in python_forms.SEVERAL
        fixed = [self.known(*each) for each in zip(given, kinds, strict=True)]
        if all(each is not None for each in fixed):
            with np.errstate(all="ignore"):
                found = rules[name](**params)(*fixed)
            return [self.constants_of(*each) for each in zip(found if several else [found], outs, strict=True)]
        if all(isinstance(value, np.ndarray) for value in given) and all(map(is_small, outs)):
            found = python_forms.small(self, name, params, given, fixed, kinds, outs)
            if found is not None:
                return found
        wholes = [self.whole(*each) for each in zip(given, kinds, strict=True)]
        key = (name, *sorted((key, str(each)) for key, each in params.items()))
        function = self.named(rules[name](**params), partial(rule_text, name, params))
        text = f"{function}({', '.join(f'{{{k}}}' for k in range(len(wholes)))})"
        found = self.line(text, wholes, len(outs) if several else None, key)
        return self.taken(found if several else [found], outs)

    def taken(self, found, kinds):
        """Values of NumPy's, those that are small number by number."""
        pairs = zip(found, kinds, strict=True)
        return [self.unpacked(one, kind) if is_small(kind) else one for one, kind in pairs]

    # loops and choices

    def within(self, around, closed, given):
        """(lines, values of the results) of a closed jaxpr in a block of its own."""
        self.block = Block(around)
        found = self.equations(without_unused(closed), given)
        return self.block, found

    def fresh(self, kinds):
        """New values of some kinds."""
        return [
            np.array([self.new() for _ in range(math.prod(kind.shape))], int).reshape(kind.shape)
            if is_small(kind)
            else self.new()
            for kind in kinds
        ]

    def repeated(self, params, given, kinds):
        first, second = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        asked, fixed, begin, around = given[:first], given[first:second], given[second:], self.block
        carry = self.fresh(kinds)
        test, (on,) = self.within(around, params["cond_jaxpr"], [*asked, *carry])
        (on_kind,) = _kinds(params["cond_jaxpr"].jaxpr.outvars)
        if on_kind.shape:  # of lanes, those that are through stay as they are
            lanes = self.whole(on, on_kind)
            going = self.line("{0}.any()", [lanes])
        else:
            going = int(on)
        block, after = self.within(test, params["body_jaxpr"], [*fixed, *carry])
        if on_kind.shape:
            columns = [[self.whole(*each) for each in zip(values, kinds, strict=True)] for values in (after, carry)]
            found = [self.line("kept_lanes({0}, {1}, {2})", [lanes, *pair]) for pair in zip(*columns, strict=True)]
            after = self.taken(found, kinds)
        self.block = around
        loop = Repeated(_flat(carry), _flat(begin), _flat(after), block.lines, test.lines, going)
        around.lines.append(loop)
        return carry

    def scanned(self, params, given, kinds):
        body, fixed, carried = params["jaxpr"], params["num_consts"], params["num_carry"]
        inner, around = _kinds(body.jaxpr.invars), self.block
        carry, heads = self.fresh(kinds[:carried]), self.fresh(inner[fixed + carried :])
        block, after = self.within(around, body, [*given[:fixed], *carry, *heads])
        self.block, rows, kept, stacked = around, [], [], []
        turn = "[::-1]" if params["reverse"] else ""
        for value, one, kind in zip(given[fixed + carried :], heads, inner[fixed + carried :], strict=True):
            small = is_small(kind)
            whole = value
            if isinstance(value, np.ndarray):
                shape = (params["length"], *kind.shape)
                whole = self.whole(value, jax.ShapeDtypeStruct(shape, kind.dtype))
            tail = f".reshape({params['length']}, {math.prod(kind.shape)}).tolist()" if small else ""
            rows.append((Line((), [whole], f"{{0}}{tail}{turn}"), one.ravel().tolist() if small else [one], not small))
        for value, kind in zip(after[carried:], kinds[carried:], strict=True):
            small, listed = isinstance(value, np.ndarray), self.new()
            kept.append((listed, value.ravel().tolist() if small else [value], not small))
            text = f"np.array({{0}}{turn}, np.dtype('{np.dtype(kind.dtype).str}')).reshape({kind.shape})"
            stacked.append((text, listed))
        lines, length = block.lines, params["length"]
        loop = Repeated(
            _flat(carry),
            _flat(given[fixed : fixed + carried]),
            _flat(after[:carried]),
            lines,
            (),
            None,
            length,
            rows,
            kept,
        )
        around.lines.append(loop)
        found = [self.line(text, [one]) for text, one in stacked]
        return [*carry, *self.taken(found, kinds[carried:])]

    def chosen(self, branches, given, kinds):
        which, around = int(given[0]), self.block
        if which in self.values:
            return self.equations(branches[min(max(int(self.values[which]), 0), len(branches) - 1)], given[1:])
        blocks = []
        for branch in branches:
            block, results = self.within(around, branch, given[1:])
            blocks.append((block.lines, _flat(results)))
        self.block, found = around, self.fresh(kinds)
        around.lines.append(Chosen(_flat(found), which, blocks))
        return found


def _kinds(variables):
    return [var.aval for var in variables]


def _flat(values):
    """The numbers of some values in a row."""
    return [one for each in values for one in (each.ravel().tolist() if isinstance(each, np.ndarray) else [each])]
