"""Translate the equations of a traced function into one Python function.

Small arrays are translated entry by entry, large ones use NumPy's rules. On a few numbers, Python's arithmetic is ten
times as fast as NumPy's. Moving entries, which is half of what JAX traces, then costs nothing: the rule of a move is
applied once, while the program is written.
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

from . import scalar_expressions
from .numpy_indexing import NoRuleError
from .numpy_primitives import UNSUPPORTED, rules
from .python_literals import TYPES_BY_NAME, literal_text, rule_text
from .python_source import Block, Conditional, Line, Loop, count_lines, prune_lines, write_lines

MAX_SCALARS = 20  # largest size of an array that is translated entry by entry
PYTHON_DTYPES = tuple(map(np.dtype, (np.float64, bool, np.int32, np.int64)))  # types with a Python equivalent
CALL_PRIMITIVES = {"closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "jit", "pjit", "checkpoint"}
CALLED_JAXPR_KEYS = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # names of the parameter with the called function

Value = Any  # variables of a value: an array of variable numbers if it is small, else one variable number


def is_small(aval):
    """Return True for arrays that are translated entry by entry."""
    return math.prod(aval.shape) <= MAX_SCALARS and np.dtype(aval.dtype) in PYTHON_DTYPES


def divided(x, y):
    """Divide by zero or nan as the processor does."""
    return float(np.divide(x, y))


def wrapped(bits, x):
    """Wrap an integer to the given number of bits."""
    half = 1 << (bits - 1)
    return (x + half) % (2 * half) - half


def kept_lanes(active, new, old):
    """Return the new values of active lanes and the old values of the others."""
    return np.where(active.reshape(active.shape + (1,) * (new.ndim - active.ndim)), new, old)


def without_unused(closed_jaxpr):
    """Remove unused equations from a closed jaxpr, those in called functions included."""
    jaxpr, _ = partial_eval.dce_jaxpr(closed_jaxpr.jaxpr, [True] * len(closed_jaxpr.jaxpr.outvars), instantiate=True)
    return closed_jaxpr.replace(jaxpr=jaxpr)


# Names that a program's text may contain.
NAMESPACE: dict[str, Any] = {"np": np, "math": math, "nan": math.nan, "inf": math.inf, "rules": rules} | TYPES_BY_NAME
NAMESPACE |= {function.__name__: function for function in (divided, wrapped, kept_lanes)}


class Program(NamedTuple):
    """Python program of a function.

    Attributes
    ----------
    run : callable
        Function of the arguments that returns the results and the number of lines run.
    size : int
        Number of lines.
    text : str or None
        Python text that defines both; None if it needs objects that have no text.
    """

    run: Callable[..., tuple[list[Any], int]]
    size: int
    text: str | None = None


def build_program(closed_jaxpr: core.ClosedJaxpr) -> Program:
    """Build the program of a closed jaxpr.

    Parameters
    ----------
    closed_jaxpr : ClosedJaxpr
        Equations of a traced function.

    Returns
    -------
    Program
        The program.

    Raises
    ------
    NoRuleError
        If an equation has no rule.
    """
    writer = Writer(closed_jaxpr)
    namespace = NAMESPACE | writer.objects
    exec(writer.text, namespace)  # the writer made this text from a jaxpr
    return Program(namespace["run"], namespace["size"], None if writer.objects else writer.text)


def compile_text(text: str) -> bytes:
    """Compile a program's text to byte code, as Python does for its own cache."""
    return marshal.dumps(compile(text, "<program>", "exec", dont_inherit=True))


def load_program(content: bytes) -> Program:
    """Load a program that `compile_text` compiled.

    The content is executed: it must be undamaged and from a trusted source (`cache_file`).
    """
    namespace = dict(NAMESPACE)
    exec(marshal.loads(content), namespace)
    return Program(namespace["run"], namespace["size"])


class Writer:
    """Writer of the text of a closed jaxpr's program; `objects` are functions and arrays without text."""

    def __init__(self, closed_jaxpr):
        self.last_number, self.texts, self.values, self.constant_numbers = 0, {}, {}, {}
        self.names, self.objects = {}, {}  # {text of a function or an array: its name}, {name: object without text}
        self.block = Block()
        arguments, inputs = [self.new_number() for _ in closed_jaxpr.jaxpr.invars], []
        for number, var in zip(arguments, closed_jaxpr.jaxpr.invars, strict=True):
            inputs.append(self.unpack(number, var.aval) if is_small(var.aval) else number)
        values = self.write_jaxpr(without_unused(closed_jaxpr), inputs)
        results = [self.pack(*item) for item in zip(values, _avals(closed_jaxpr.jaxpr.outvars), strict=True)]
        lines = prune_lines(self.block.lines, set(results))
        text = [f"{name} = {item}" for item, name in self.names.items()]
        text += [f"size = {count_lines(lines)}", f"def run({', '.join(map(self.name, arguments))}):"]
        text += [f"    spent = {len(lines)}", *write_lines(lines, self.name, "    ")]
        text.append(f"    return [{', '.join(map(self.name, results))}], spent")
        self.text = "\n".join(text)

    # values

    def new_number(self):
        self.last_number += 1
        return self.last_number

    def name(self, number):
        return self.texts.get(number) or f"v{number}"

    def constant(self, value: Any) -> int:
        """Return the variable of a Python number or an array."""
        is_scalar = isinstance(value, float | int)
        key = (type(value), repr(value)) if is_scalar else (value.shape, value.dtype, value.tobytes())
        if key not in self.constant_numbers:
            number = self.constant_numbers[key] = self.new_number()
            self.values[number], self.texts[number] = (
                value,
                repr(value) if is_scalar else self.object_name(value, partial(literal_text, value)),
            )
            if is_scalar and self.texts[number].startswith("-"):
                self.texts[number] = f"({self.texts[number]})"
        return self.constant_numbers[key]

    def constants_of(self, array: Any, aval: Any) -> Value:
        """Return the value of a constant array."""
        array = np.asarray(array, aval.dtype)
        if not is_small(aval):
            return self.constant(array[()])
        return np.array([self.constant(entry) for entry in array.ravel().tolist()], int).reshape(array.shape)

    def constant_array(self, value: Value, aval: Any) -> Any:
        """Return a constant as an array; None if the value is not constant."""
        if not isinstance(value, np.ndarray):
            return self.values.get(value)
        numbers = value.ravel().tolist()
        if any(number not in self.values for number in numbers):
            return None
        return np.array([self.values[number] for number in numbers], aval.dtype).reshape(value.shape)[()]

    def emit(self, text: str, inputs: Sequence[int], n_values: int | None = None, key: Any = None) -> Any:
        """Emit a line once; returns the variable of its result, or a list of `n_values` variables."""
        key = (text if key is None else key, tuple(inputs))
        numbers = self.block.find(key)
        if numbers is None:
            numbers = [self.new_number() for _ in range(n_values or 1)] if n_values != 0 else []
            self.block.lines.append(Line(numbers, inputs, text, n_values is not None))
            self.block.known_results[key] = numbers
        return numbers[0] if n_values is None else numbers

    def pack(self, value: Value, aval: Any) -> int:
        """Pack a value into one NumPy variable."""
        if not isinstance(value, np.ndarray):
            return value
        constant = self.constant_array(value, aval)
        if constant is not None:
            return self.constant(constant)
        numbers, dtype = value.ravel().tolist(), f"np.{np.dtype(aval.dtype).name}"
        dtype = "np.bool_" if dtype == "np.bool" else dtype
        if not value.ndim:
            return self.emit(f"{dtype}({{0}})", numbers)
        placeholders = ", ".join(f"{{{k}}}" for k in range(len(numbers)))
        reshape_text = f".reshape({value.shape})" if value.ndim > 1 else ""
        return self.emit(f"np.array([{placeholders}], {dtype}){reshape_text}", numbers)

    def unpack(self, number: int, aval: Any) -> Value:
        """Unpack a NumPy variable into Python numbers."""
        if not aval.shape:
            return np.array(self.emit("{0}.item()", [number]))
        return np.array(self.emit("{0}.ravel().tolist()", [number], math.prod(aval.shape)), int).reshape(aval.shape)

    def object_name(self, value: Any, make_text: Callable[[], str]) -> str:
        """Return the name of a function or an array; `make_text` gives its text or raises NoRuleError."""
        try:
            text = make_text()
        except NoRuleError:
            name = f"h{self.new_number()}"
            self.objects[name] = value
            return name
        return self.names.setdefault(text, f"n{len(self.names)}")

    # equations

    def write_jaxpr(self, closed_jaxpr: Any, inputs: Sequence[Value]) -> list[Value]:
        """Write a closed jaxpr and return the values of its results."""
        jaxpr = closed_jaxpr.jaxpr
        value_of_variable = dict(zip(jaxpr.invars, inputs, strict=True))
        for var, value in zip(jaxpr.constvars, closed_jaxpr.consts, strict=True):
            value_of_variable[var] = self.constants_of(value, var.aval)

        def lookup_value(var):
            if isinstance(var, core.Literal):
                return self.constants_of(var.val, var.aval)
            return value_of_variable[var]

        for equation in jaxpr.eqns:
            results = self.write_equation(equation, [lookup_value(var) for var in equation.invars])
            value_of_variable |= zip(equation.outvars, results, strict=True)
        return [lookup_value(var) for var in jaxpr.outvars]

    def write_equation(self, equation: Any, inputs: list[Value]) -> list[Value]:
        name, params = equation.primitive.name, equation.params
        called_jaxpr = next((params[key] for key in CALLED_JAXPR_KEYS if key in params), None)
        if isinstance(called_jaxpr, core.ClosedJaxpr) and (name in CALL_PRIMITIVES or "call_jaxpr" in params):
            return self.write_jaxpr(called_jaxpr, inputs)
        if name == "while":
            return self.write_while(params, inputs, _avals(equation.outvars))
        if name == "scan":
            return self.write_scan(params, inputs, _avals(equation.outvars))
        if name == "cond":
            return self.write_cond(params["branches"], inputs, _avals(equation.outvars))
        if name not in rules or any(var.aval.dtype.kind in UNSUPPORTED.get(name, "") for var in equation.invars):
            raise NoRuleError(name)
        return self.write_primitive(name, params, inputs, _avals(equation.invars), _avals(equation.outvars))

    def write_primitive(self, name, params, inputs, avals, out_avals):
        is_list = name in scalar_expressions.LIST_PRIMITIVES
        constants = [self.constant_array(*pair) for pair in zip(inputs, avals, strict=True)]
        if all(pair is not None for pair in constants):
            with np.errstate(all="ignore"):
                results = rules[name](**params)(*constants)
            return [self.constants_of(*pair) for pair in zip(results if is_list else [results], out_avals, strict=True)]
        if all(isinstance(value, np.ndarray) for value in inputs) and all(map(is_small, out_avals)):
            results = scalar_expressions.write_scalars(self, name, params, inputs, constants, avals, out_avals)
            if results is not None:
                return results
        arrays = [self.pack(*pair) for pair in zip(inputs, avals, strict=True)]
        key = (name, *sorted((key, str(pair)) for key, pair in params.items()))
        function = self.object_name(rules[name](**params), partial(rule_text, name, params))
        text = f"{function}({', '.join(f'{{{k}}}' for k in range(len(arrays)))})"
        results = self.emit(text, arrays, len(out_avals) if is_list else None, key)
        return self.unpack_small(results if is_list else [results], out_avals)

    def unpack_small(self, values, avals):
        """Unpack those NumPy variables that are small."""
        pairs = zip(values, avals, strict=True)
        return [self.unpack(value, aval) if is_small(aval) else value for value, aval in pairs]

    # loops and conditionals

    def write_block(self, outer, closed_jaxpr, inputs):
        """Write a closed jaxpr in a new block; returns the block and the values of the results."""
        self.block = Block(outer)
        results = self.write_jaxpr(without_unused(closed_jaxpr), inputs)
        return self.block, results

    def new_values(self, avals):
        """Create variables for values of given shapes and types."""
        return [
            np.array([self.new_number() for _ in range(math.prod(aval.shape))], int).reshape(aval.shape)
            if is_small(aval)
            else self.new_number()
            for aval in avals
        ]

    def write_while(self, params, inputs, avals):
        n_cond, n_consts = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        cond_args, body_args, init, outer = inputs[:n_cond], inputs[n_cond:n_consts], inputs[n_consts:], self.block
        carry = self.new_values(avals)
        cond_block, (is_active,) = self.write_block(outer, params["cond_jaxpr"], [*cond_args, *carry])
        (is_active_aval,) = _avals(params["cond_jaxpr"].jaxpr.outvars)
        if is_active_aval.shape:  # finished lanes keep their values
            lanes = self.pack(is_active, is_active_aval)
            condition = self.emit("{0}.any()", [lanes])
        else:
            condition = int(is_active)
        block, next_carry = self.write_block(cond_block, params["body_jaxpr"], [*body_args, *carry])
        if is_active_aval.shape:
            columns = [
                [self.pack(*entry) for entry in zip(values, avals, strict=True)] for values in (next_carry, carry)
            ]
            results = [self.emit("kept_lanes({0}, {1}, {2})", [lanes, *pair]) for pair in zip(*columns, strict=True)]
            next_carry = self.unpack_small(results, avals)
        self.block = outer
        loop = Loop(_flatten(carry), _flatten(init), _flatten(next_carry), block.lines, cond_block.lines, condition)
        outer.lines.append(loop)
        return carry

    def write_scan(self, params, inputs, avals):
        body, n_consts, n_carry = params["jaxpr"], params["num_consts"], params["num_carry"]
        body_avals, outer = _avals(body.jaxpr.invars), self.block
        carry, xs = self.new_values(avals[:n_carry]), self.new_values(body_avals[n_consts + n_carry :])
        block, body_results = self.write_block(outer, body, [*inputs[:n_consts], *carry, *xs])
        self.block, rows, output_lists, stacked_outputs = outer, [], [], []
        flip = "[::-1]" if params["reverse"] else ""
        for value, entry, aval in zip(inputs[n_consts + n_carry :], xs, body_avals[n_consts + n_carry :], strict=True):
            small = is_small(aval)
            array = value
            if isinstance(value, np.ndarray):
                shape = (params["length"], *aval.shape)
                array = self.pack(value, jax.ShapeDtypeStruct(shape, aval.dtype))
            tail = f".reshape({params['length']}, {math.prod(aval.shape)}).tolist()" if small else ""
            rows.append(
                (Line((), [array], f"{{0}}{tail}{flip}"), entry.ravel().tolist() if small else [entry], not small)
            )
        for value, aval in zip(body_results[n_carry:], avals[n_carry:], strict=True):
            small, list_number = isinstance(value, np.ndarray), self.new_number()
            output_lists.append((list_number, value.ravel().tolist() if small else [value], not small))
            text = f"np.array({{0}}{flip}, np.dtype('{np.dtype(aval.dtype).str}')).reshape({aval.shape})"
            stacked_outputs.append((text, list_number))
        lines, length = block.lines, params["length"]
        loop = Loop(
            _flatten(carry),
            _flatten(inputs[n_consts : n_consts + n_carry]),
            _flatten(body_results[:n_carry]),
            lines,
            (),
            None,
            length,
            rows,
            output_lists,
        )
        outer.lines.append(loop)
        outputs = [self.emit(text, [entry]) for text, entry in stacked_outputs]
        return [*carry, *self.unpack_small(outputs, avals[n_carry:])]

    def write_cond(self, branches, inputs, avals):
        case, outer = int(inputs[0]), self.block
        if case in self.values:
            return self.write_jaxpr(branches[min(max(int(self.values[case]), 0), len(branches) - 1)], inputs[1:])
        blocks = []
        for branch in branches:
            block, branch_results = self.write_block(outer, branch, inputs[1:])
            blocks.append((block.lines, _flatten(branch_results)))
        self.block, results = outer, self.new_values(avals)
        outer.lines.append(Conditional(_flatten(results), case, blocks))
        return results


def _avals(variables):
    return [var.aval for var in variables]


def _flatten(values):
    """Return the variables of values in one list."""
    return [item for value in values for item in (value.ravel().tolist() if isinstance(value, np.ndarray) else [value])]
