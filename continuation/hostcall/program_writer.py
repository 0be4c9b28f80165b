"""Translate the equations of a traced function into one Python function.

Small arrays are translated entry by entry; large arrays use the rules of `rules`. For a few numbers, Python's
arithmetic is ten times as fast as NumPy's. Half of the equations that JAX traces only move entries. Such an equation
takes no time in the program, because its rule is applied when the program is written.
"""

import marshal
import math
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jax.extend import core
from jax.interpreters import partial_eval

from .program_lines import Block, Conditional, Line, Loop, count_lines, prune_lines, write_lines
from .rules import RULES, UNSUPPORTED, NoRuleError, make_rule, rule_arguments
from .scalar_expressions import LIST_PRIMITIVES, write_small_primitive

_NAMED_TYPES = (lax.GatherDimensionNumbers, lax.ScatterDimensionNumbers, lax.GatherScatterMode, lax.RoundingMethod)
TYPES_BY_NAME = {named_type.__name__: named_type for named_type in _NAMED_TYPES}  # types that a text may contain


def literal_text(value: Any) -> str:
    """Return the Python text of a value. Raises NoRuleError if the value has no text."""
    value_type = type(value)
    is_named = TYPES_BY_NAME.get(value_type.__name__) is value_type
    if value is None or value_type in (bool, int, float, str):
        return repr(value)
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biufc" and value.dtype.isbuiltin:
        return f"np.ndarray({value.shape}, {literal_text(value.dtype)}, {value.tobytes()!r}).copy()[()]"
    if isinstance(value, np.dtype) and value.isbuiltin:
        return f"np.dtype({value.str!r})"
    if is_named and isinstance(value, Enum):
        return f"{value_type.__name__}.{value.name}"
    if value_type is tuple or (is_named and isinstance(value, tuple)):
        type_text = value_type.__name__ if is_named else ""
        entries_text = "".join(f"{literal_text(entry)}, " for entry in value)
        return f"{type_text}({entries_text})"
    raise NoRuleError(f"no text of {value_type.__name__}")


def rule_text(name: str, params: dict[str, Any]) -> str:
    """Return the Python text of a call of a primitive's rule with the parameters of an equation."""
    texts = [f"{key}={literal_text(value)}" for key, value in rule_arguments(params).items()]
    return f"RULES[{name!r}]({', '.join(texts)})"


MAX_SCALARS = 20  # largest size of an array that is translated entry by entry
PYTHON_DTYPES = tuple(map(np.dtype, (np.float64, bool, np.int32, np.int64)))  # types with a Python equivalent
CALL_PRIMITIVES = {"closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "jit", "pjit", "checkpoint"}
CALLED_JAXPR_KEYS = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # names of the parameter with the called function

Value = Any  # variables of a value: an array of variable numbers if it is small, else one variable number


def is_small_array(aval):
    """Return True for arrays that are translated entry by entry."""
    return math.prod(aval.shape) <= MAX_SCALARS and np.dtype(aval.dtype) in PYTHON_DTYPES


def divide_ieee(x, y):
    """Divide x by y; division by zero gives inf or nan, as in floating-point arithmetic."""
    return float(np.divide(x, y))


def wrap_integer(n_bits, x):
    """Wrap an integer to the range of signed integers with `n_bits` bits."""
    half = 1 << (n_bits - 1)
    return (x + half) % (2 * half) - half


def select_active(is_active, new_values, old_values):
    """Return the new values of active lanes and the old values of the others."""
    return np.where(
        is_active.reshape(is_active.shape + (1,) * (new_values.ndim - is_active.ndim)), new_values, old_values
    )


def remove_unused_equations(closed_jaxpr):
    """Remove unused equations from a closed jaxpr, including those in called functions."""
    jaxpr, _ = partial_eval.dce_jaxpr(closed_jaxpr.jaxpr, [True] * len(closed_jaxpr.jaxpr.outvars), instantiate=True)
    return closed_jaxpr.replace(jaxpr=jaxpr)


# Names that a program's text may contain.
NAMESPACE: dict[str, Any] = {"np": np, "math": math, "nan": math.nan, "inf": math.inf, "RULES": RULES} | TYPES_BY_NAME
NAMESPACE |= {function.__name__: function for function in (divide_ieee, wrap_integer, select_active)}


class PythonProgram(NamedTuple):
    """Python program of a function.

    Attributes
    ----------
    run : callable
        Function of the arguments that returns the results and the number of executed lines.
    size : int
        Number of lines.
    byte_code : bytes
        Byte code that defines `run` and `size`.
    """

    run: Callable[..., tuple[list[Any], int]]
    size: int
    byte_code: bytes


def build_program(closed_jaxpr: core.ClosedJaxpr) -> PythonProgram:
    """Build the program of a closed jaxpr.

    Parameters
    ----------
    closed_jaxpr : ClosedJaxpr
        Equations of a traced function.

    Returns
    -------
    PythonProgram
        The program.

    Raises
    ------
    NoRuleError
        If an equation has no rule, or if a constant or a parameter has no text.
    """
    text = ProgramWriter(closed_jaxpr).text
    return load_program(marshal.dumps(compile(text, "<program>", "exec", dont_inherit=True)))


def load_program(byte_code: bytes) -> PythonProgram:
    """Load a program from the byte code of a `PythonProgram`.

    The byte code is executed. It must be undamaged and from a trusted source (`module_store`).
    """
    namespace = dict(NAMESPACE)
    exec(marshal.loads(byte_code), namespace)
    return PythonProgram(namespace["run"], namespace["size"], byte_code)


class ProgramWriter:
    """Writer of the program text of a closed jaxpr."""

    def __init__(self, closed_jaxpr):
        self.last_number, self.texts, self.values, self.constant_numbers = 0, {}, {}, {}
        self.names = {}  # {text of a function or an array: its name}
        self.block = Block()
        argument_numbers = [self.new_number() for _ in closed_jaxpr.jaxpr.invars]
        input_values = self.unpack_small(argument_numbers, _avals_of(closed_jaxpr.jaxpr.invars))
        result_values = self.write_jaxpr(remove_unused_equations(closed_jaxpr), input_values)
        result_numbers = self.pack_arrays(result_values, _avals_of(closed_jaxpr.jaxpr.outvars))
        lines = prune_lines(self.block.lines, set(result_numbers))
        text_lines = [f"{name} = {item}" for item, name in self.names.items()]
        text_lines += [f"size = {count_lines(lines)}", f"def run({', '.join(map(self.name, argument_numbers))}):"]
        text_lines += [f"    spent = {len(lines)}", *write_lines(lines, self.name, "    ")]
        text_lines.append(f"    return [{', '.join(map(self.name, result_numbers))}], spent")
        self.text = "\n".join(text_lines)

    # values

    def new_number(self):
        self.last_number += 1
        return self.last_number

    def name(self, number):
        return self.texts.get(number) or f"v{number}"

    def constant_number(self, value: Any) -> int:
        """Return the variable number of a constant: a Python number or an array."""
        is_scalar = isinstance(value, float | int)
        key = (type(value), repr(value)) if is_scalar else (value.shape, value.dtype, value.tobytes())
        if key not in self.constant_numbers:
            number = self.constant_numbers[key] = self.new_number()
            text = f"({value!r})" if is_scalar else self.name_of(literal_text(value))
            self.values[number], self.texts[number] = value, text
        return self.constant_numbers[key]

    def constant_value(self, array: Any, aval: Any) -> Value:
        """Return the variable numbers of a constant array: one per entry if the array is small, else one."""
        array = np.asarray(array, aval.dtype)
        if not is_small_array(aval):
            return self.constant_number(array[()])
        return np.array([self.constant_number(entry) for entry in array.ravel().tolist()], int).reshape(array.shape)

    def constant_array(self, value: Value, aval: Any) -> Any:
        """Return the array of a constant value; None if the value is not constant."""
        if not isinstance(value, np.ndarray):
            return self.values.get(value)
        entries = [self.values.get(number) for number in value.ravel().tolist()]
        return None if None in entries else np.array(entries, aval.dtype).reshape(value.shape)[()]

    def emit_line(
        self, text: str, operand_numbers: Sequence[int], n_results: int | None = None, key: Any = None
    ) -> Any:
        """Emit a line unless an equal line exists.

        Returns the variable of the result, or a list of `n_results` variables.
        """
        key = (text if key is None else key, tuple(operand_numbers))
        result_numbers = self.block.known_results.get(key)
        if result_numbers is None:
            result_numbers = [self.new_number() for _ in range(1 if n_results is None else n_results)]
            self.block.lines.append(Line(result_numbers, operand_numbers, text, n_results is not None))
            self.block.known_results[key] = result_numbers
        return result_numbers[0] if n_results is None else result_numbers

    def pack_array(self, value: Value, aval: Any) -> int:
        """Pack a value into one NumPy variable."""
        if not isinstance(value, np.ndarray):
            return value
        constant_array = self.constant_array(value, aval)
        if constant_array is not None:
            return self.constant_number(constant_array)
        entry_numbers, dtype_text = value.ravel().tolist(), f"np.{np.dtype(aval.dtype).name}"
        if not value.ndim:
            return self.emit_line(f"{dtype_text}({{0}})", entry_numbers)
        placeholders = ", ".join(f"{{{k}}}" for k in range(len(entry_numbers)))
        reshape_text = f".reshape({value.shape})" if value.ndim > 1 else ""
        return self.emit_line(f"np.array([{placeholders}], {dtype_text}){reshape_text}", entry_numbers)

    def pack_arrays(self, values, avals):
        return [self.pack_array(value, aval) for value, aval in zip(values, avals, strict=True)]

    def unpack_array(self, number: int, aval: Any) -> Value:
        """Unpack a NumPy variable into Python numbers."""
        if not aval.shape:
            return np.array(self.emit_line("{0}.item()", [number]))
        numbers = self.emit_line("{0}.ravel().tolist()", [number], math.prod(aval.shape))
        return np.array(numbers, int).reshape(aval.shape)

    def unpack_small(self, values, avals):
        """Unpack the NumPy variables that hold small arrays."""
        pairs = zip(values, avals, strict=True)
        return [self.unpack_array(value, aval) if is_small_array(aval) else value for value, aval in pairs]

    def name_of(self, text: str) -> str:
        """Return the name of a function or an array with a text."""
        return self.names.setdefault(text, f"n{len(self.names)}")

    # equations

    def write_jaxpr(self, closed_jaxpr: Any, input_values: Sequence[Value]) -> list[Value]:
        """Write a closed jaxpr and return the values of its results."""
        jaxpr = closed_jaxpr.jaxpr
        value_of_variable = dict(zip(jaxpr.invars, input_values, strict=True))
        constants = zip(jaxpr.constvars, closed_jaxpr.consts, strict=True)
        value_of_variable |= {variable: self.constant_value(value, variable.aval) for variable, value in constants}

        def look_up(variable):
            is_literal = isinstance(variable, core.Literal)
            return self.constant_value(variable.val, variable.aval) if is_literal else value_of_variable[variable]

        for equation in jaxpr.eqns:
            results = self.write_equation(equation, [look_up(variable) for variable in equation.invars])
            value_of_variable |= zip(equation.outvars, results, strict=True)
        return [look_up(variable) for variable in jaxpr.outvars]

    def write_equation(self, equation: Any, input_values: list[Value]) -> list[Value]:
        name, params, result_avals = equation.primitive.name, equation.params, _avals_of(equation.outvars)
        called_jaxpr = next((params[key] for key in CALLED_JAXPR_KEYS if key in params), None)
        if isinstance(called_jaxpr, core.ClosedJaxpr) and (name in CALL_PRIMITIVES or "call_jaxpr" in params):
            return self.write_jaxpr(called_jaxpr, input_values)
        write_structure = {"while": self.write_while, "scan": self.write_scan, "cond": self.write_cond}.get(name)
        if write_structure:
            return write_structure(params, input_values, result_avals)
        if any(variable.aval.dtype.kind in UNSUPPORTED.get(name, "") for variable in equation.invars):
            raise NoRuleError(f"{name} of these types")
        return self.write_primitive(name, params, input_values, _avals_of(equation.invars), result_avals)

    def write_primitive(self, name, params, input_values, input_avals, result_avals):
        rule, returns_list = make_rule(name, params), name in LIST_PRIMITIVES
        constants = [self.constant_array(*pair) for pair in zip(input_values, input_avals, strict=True)]
        if all(constant is not None for constant in constants):
            with np.errstate(all="ignore"):
                results = rule(*constants)
            results = zip(results if returns_list else [results], result_avals, strict=True)
            return [self.constant_value(*result_and_aval) for result_and_aval in results]
        if all(isinstance(value, np.ndarray) for value in input_values) and all(map(is_small_array, result_avals)):
            results = write_small_primitive(self, name, params, input_values, constants, input_avals)
            if results is not None:
                return results
        array_numbers = self.pack_arrays(input_values, input_avals)
        key = (name, *sorted((param_name, str(param_value)) for param_name, param_value in params.items()))
        function = self.name_of(rule_text(name, params))
        text = f"{function}({', '.join(f'{{{k}}}' for k in range(len(array_numbers)))})"
        results = self.emit_line(text, array_numbers, len(result_avals) if returns_list else None, key)
        return self.unpack_small(results if returns_list else [results], result_avals)

    # loops and conditionals

    def new_variables(self, avals):
        """Create variables for values of given shapes and types."""
        return [
            np.array([self.new_number() for _ in range(math.prod(aval.shape))], int).reshape(aval.shape)
            if is_small_array(aval)
            else self.new_number()
            for aval in avals
        ]

    def write_needed(self, closed_jaxpr, input_values):
        """Write the needed equations of a closed jaxpr and return the values of its results."""
        return self.write_jaxpr(remove_unused_equations(closed_jaxpr), input_values)

    def end_loop(self, outer_block, carries, initial_values, next_values, *head):
        """Append the loop of the lines of the current block to the outer block, and continue in the outer block."""
        columns = map(_flatten_numbers, (carries, initial_values, next_values))
        outer_block.lines.append(Loop(*columns, self.block.lines, *head))
        self.block = outer_block

    def write_while(self, params, input_values, result_avals):
        n_cond, n_consts = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        outer_block, carries = self.block, self.new_variables(result_avals)
        self.block = Block(outer_block)
        (condition,) = self.write_needed(params["cond_jaxpr"], [*input_values[:n_cond], *carries])
        (condition_aval,) = _avals_of(params["cond_jaxpr"].jaxpr.outvars)
        is_active = self.pack_array(condition, condition_aval) if condition_aval.shape else int(condition)
        test_text = "if not {0}.any(): break" if condition_aval.shape else "if not {0}: break"
        self.block.lines.append(Line((), [is_active], test_text))
        next_values = self.write_needed(params["body_jaxpr"], [*input_values[n_cond:n_consts], *carries])
        if condition_aval.shape:  # finished lanes keep their values
            new_and_old = (self.pack_arrays(values, result_avals) for values in (next_values, carries))
            pairs = zip(*new_and_old, strict=True)
            selected = [self.emit_line("select_active({0}, {1}, {2})", [is_active, *pair]) for pair in pairs]
            next_values = self.unpack_small(selected, result_avals)
        self.end_loop(outer_block, carries, input_values[n_consts:], next_values)
        return carries

    def write_scan(self, params, input_values, result_avals):
        n_consts, n_carry, length, body = (params[key] for key in ("num_consts", "num_carry", "length", "jaxpr"))
        n_fixed, index, outer_block = n_consts + n_carry, self.new_number(), self.block
        row_avals, output_avals = _avals_of(body.jaxpr.invars)[n_fixed:], result_avals[n_carry:]
        reversal = "[::-1]" if params["reverse"] else ""
        tables = self.tables_of_rows(input_values[n_fixed:], row_avals, length)
        carries, rows = self.new_variables(result_avals[:n_carry]), self.new_variables(row_avals)
        empty_output_lists = [self.new_number() for _ in output_avals]
        output_lists = [self.new_number() for _ in output_avals]
        outer_block.lines += [Line([number], (), "[]") for number in empty_output_lists]
        self.block = Block(outer_block)
        for row, table in zip(rows, tables, strict=True):
            self.block.lines.append(
                Line(_flatten_numbers([row]), [table, index], "{0}[{1}]", isinstance(row, np.ndarray))
            )
        results = self.write_needed(body, [*input_values[:n_consts], *carries, *rows])
        for number, value in zip(output_lists, results[n_carry:], strict=True):
            entries = _flatten_numbers([value])
            placeholders = "".join(f"{{{k}}}, " for k in range(1, len(entries) + 1))
            entry_text = f"({placeholders})" if isinstance(value, np.ndarray) else "{1}"
            self.block.lines.append(Line((), [number, *entries], f"{{0}}.append({entry_text})"))
        initial_values = [*input_values[n_consts:n_fixed], *empty_output_lists]
        next_values = [*results[:n_carry], *output_lists]
        head = f"for {self.name(index)} in range({length}){reversal}:"
        self.end_loop(outer_block, [*carries, *output_lists], initial_values, next_values, head)
        outputs = []
        for number, aval in zip(output_lists, output_avals, strict=True):
            text = f"np.array({{0}}{reversal}, np.dtype('{np.dtype(aval.dtype).str}')).reshape({aval.shape})"
            outputs.append(self.emit_line(text, [number]))
        return [*carries, *self.unpack_small(outputs, output_avals)]

    def tables_of_rows(self, values, row_avals, length):
        """Return a variable for each array that a scan reads: a list of lists of numbers if its rows are small."""
        tables = []
        for value, aval in zip(values, row_avals, strict=True):
            number = self.pack_array(value, jax.ShapeDtypeStruct((length, *aval.shape), aval.dtype))
            if is_small_array(aval):
                number = self.emit_line(f"{{0}}.reshape({length}, {math.prod(aval.shape)}).tolist()", [number])
            tables.append(number)
        return tables

    def write_cond(self, params, input_values, result_avals):
        case_number, branches, outer_block = int(input_values[0]), params["branches"], self.block
        if case_number in self.values:
            index = min(max(int(self.values[case_number]), 0), len(branches) - 1)
            return self.write_jaxpr(branches[index], input_values[1:])
        results, blocks = self.new_variables(result_avals), []
        for branch in branches:
            self.block = Block(outer_block)
            values = _flatten_numbers(self.write_needed(branch, input_values[1:]))
            pairs = zip(_flatten_numbers(results), values, strict=True)
            blocks.append([*self.block.lines, *(Line([result], [value], "{0}") for result, value in pairs)])
        self.block = outer_block
        outer_block.lines.append(Conditional(_flatten_numbers(results), case_number, blocks))
        return results


def _avals_of(variables):
    return [variable.aval for variable in variables]


def _flatten_numbers(values):
    """Return the variables of values in one list."""
    return [item for value in values for item in (value.ravel().tolist() if isinstance(value, np.ndarray) else [value])]
