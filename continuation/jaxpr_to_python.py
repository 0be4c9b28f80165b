"""Translate the equations of a traced function into one Python function.

Small arrays are translated entry by entry; large arrays use the rules of `numpy_primitives`. For a few numbers,
Python's arithmetic is ten times as fast as NumPy's. Half of the equations that JAX traces only move entries. Such an
equation takes no time in the program, because its rule is applied when the program is written.
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
from .numpy_gather_scatter import NoRuleError
from .numpy_primitives import UNSUPPORTED, rules
from .program_lines import Block, Conditional, Line, Loop, count_lines, prune_lines, write_lines
from .python_literals import TYPES_BY_NAME, literal_text, rule_text

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
NAMESPACE: dict[str, Any] = {"np": np, "math": math, "nan": math.nan, "inf": math.inf, "rules": rules} | TYPES_BY_NAME
NAMESPACE |= {function.__name__: function for function in (divide_ieee, wrap_integer, select_active)}


class PythonProgram(NamedTuple):
    """Python program of a function.

    Attributes
    ----------
    run : callable
        Function of the arguments that returns the results and the number of executed lines.
    size : int
        Number of lines.
    text : str or None
        Python text that defines `run` and `size`; None if the program needs objects without text.
    """

    run: Callable[..., tuple[list[Any], int]]
    size: int
    text: str | None = None


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
        If an equation has no rule.
    """
    writer = ProgramWriter(closed_jaxpr)
    namespace = NAMESPACE | writer.objects
    exec(writer.text, namespace)  # the writer made this text from a jaxpr
    return PythonProgram(namespace["run"], namespace["size"], None if writer.objects else writer.text)


def compile_program_text(program_text: str) -> bytes:
    """Compile a program's text to byte code, as Python does for its own cache."""
    return marshal.dumps(compile(program_text, "<program>", "exec", dont_inherit=True))


def load_program(byte_code: bytes) -> PythonProgram:
    """Load a program from byte code of `compile_program_text`.

    The byte code is executed. It must be undamaged and from a trusted source (`trusted_cache_file`).
    """
    namespace = dict(NAMESPACE)
    exec(marshal.loads(byte_code), namespace)
    return PythonProgram(namespace["run"], namespace["size"])


class ProgramWriter:
    """Writer of the program text of a closed jaxpr; `objects` are functions and arrays without text."""

    def __init__(self, closed_jaxpr):
        self.last_number, self.texts, self.values, self.constant_numbers = 0, {}, {}, {}
        self.names, self.objects = {}, {}  # {text of a function or an array: its name}, {name: object without text}
        self.block = Block()
        argument_numbers, input_values = [self.new_number() for _ in closed_jaxpr.jaxpr.invars], []
        for variable_number, var in zip(argument_numbers, closed_jaxpr.jaxpr.invars, strict=True):
            input_values.append(
                self.unpack_array(variable_number, var.aval) if is_small_array(var.aval) else variable_number
            )
        result_values = self.write_jaxpr(remove_unused_equations(closed_jaxpr), input_values)
        result_numbers = [
            self.pack_array(*item) for item in zip(result_values, _avals_of(closed_jaxpr.jaxpr.outvars), strict=True)
        ]
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
            self.values[number], self.texts[number] = (
                value,
                repr(value) if is_scalar else self.object_name(value, partial(literal_text, value)),
            )
            if is_scalar and self.texts[number].startswith("-"):
                self.texts[number] = f"({self.texts[number]})"
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
        entry_numbers = value.ravel().tolist()
        if any(number not in self.values for number in entry_numbers):
            return None
        return np.array([self.values[number] for number in entry_numbers], aval.dtype).reshape(value.shape)[()]

    def emit_line(
        self, text: str, operand_numbers: Sequence[int], n_results: int | None = None, key: Any = None
    ) -> Any:
        """Emit a line unless an equal line exists.

        Returns the variable of the result, or a list of `n_results` variables.
        """
        key = (text if key is None else key, tuple(operand_numbers))
        result_numbers = self.block.find(key)
        if result_numbers is None:
            result_numbers = [self.new_number() for _ in range(n_results or 1)] if n_results != 0 else []
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
        dtype_text = "np.bool_" if dtype_text == "np.bool" else dtype_text
        if not value.ndim:
            return self.emit_line(f"{dtype_text}({{0}})", entry_numbers)
        placeholders = ", ".join(f"{{{k}}}" for k in range(len(entry_numbers)))
        reshape_text = f".reshape({value.shape})" if value.ndim > 1 else ""
        return self.emit_line(f"np.array([{placeholders}], {dtype_text}){reshape_text}", entry_numbers)

    def unpack_array(self, number: int, aval: Any) -> Value:
        """Unpack a NumPy variable into Python numbers."""
        if not aval.shape:
            return np.array(self.emit_line("{0}.item()", [number]))
        return np.array(self.emit_line("{0}.ravel().tolist()", [number], math.prod(aval.shape)), int).reshape(
            aval.shape
        )

    def object_name(self, value: Any, make_text: Callable[[], str]) -> str:
        """Return the name of a function or an array; `make_text` returns the text or raises NoRuleError."""
        try:
            text = make_text()
        except NoRuleError:
            name = f"h{self.new_number()}"
            self.objects[name] = value
            return name
        return self.names.setdefault(text, f"n{len(self.names)}")

    # equations

    def write_jaxpr(self, closed_jaxpr: Any, input_values: Sequence[Value]) -> list[Value]:
        """Write a closed jaxpr and return the values of its results."""
        jaxpr = closed_jaxpr.jaxpr
        value_of_variable = dict(zip(jaxpr.invars, input_values, strict=True))
        for var, value in zip(jaxpr.constvars, closed_jaxpr.consts, strict=True):
            value_of_variable[var] = self.constant_value(value, var.aval)

        def lookup_value(var):
            if isinstance(var, core.Literal):
                return self.constant_value(var.val, var.aval)
            return value_of_variable[var]

        for equation in jaxpr.eqns:
            results = self.write_equation(equation, [lookup_value(var) for var in equation.invars])
            value_of_variable |= zip(equation.outvars, results, strict=True)
        return [lookup_value(var) for var in jaxpr.outvars]

    def write_equation(self, equation: Any, input_values: list[Value]) -> list[Value]:
        name, params = equation.primitive.name, equation.params
        called_jaxpr = next((params[key] for key in CALLED_JAXPR_KEYS if key in params), None)
        if isinstance(called_jaxpr, core.ClosedJaxpr) and (name in CALL_PRIMITIVES or "call_jaxpr" in params):
            return self.write_jaxpr(called_jaxpr, input_values)
        if name == "while":
            return self.write_while(params, input_values, _avals_of(equation.outvars))
        if name == "scan":
            return self.write_scan(params, input_values, _avals_of(equation.outvars))
        if name == "cond":
            return self.write_cond(params["branches"], input_values, _avals_of(equation.outvars))
        if name not in rules or any(var.aval.dtype.kind in UNSUPPORTED.get(name, "") for var in equation.invars):
            raise NoRuleError(name)
        return self.write_primitive(name, params, input_values, _avals_of(equation.invars), _avals_of(equation.outvars))

    def write_primitive(self, name, params, input_values, input_avals, result_avals):
        returns_list = name in scalar_expressions.LIST_PRIMITIVES
        constants = [
            self.constant_array(*value_and_aval) for value_and_aval in zip(input_values, input_avals, strict=True)
        ]
        if all(constant is not None for constant in constants):
            with np.errstate(all="ignore"):
                results = rules[name](**params)(*constants)
            return [
                self.constant_value(*result_and_aval)
                for result_and_aval in zip(results if returns_list else [results], result_avals, strict=True)
            ]
        if all(isinstance(value, np.ndarray) for value in input_values) and all(map(is_small_array, result_avals)):
            results = scalar_expressions.write_small_primitive(
                self, name, params, input_values, constants, input_avals, result_avals
            )
            if results is not None:
                return results
        array_numbers = [
            self.pack_array(*value_and_aval) for value_and_aval in zip(input_values, input_avals, strict=True)
        ]
        key = (name, *sorted((param_name, str(param_value)) for param_name, param_value in params.items()))
        function = self.object_name(rules[name](**params), partial(rule_text, name, params))
        text = f"{function}({', '.join(f'{{{k}}}' for k in range(len(array_numbers)))})"
        results = self.emit_line(text, array_numbers, len(result_avals) if returns_list else None, key)
        return self.unpack_small(results if returns_list else [results], result_avals)

    def unpack_small(self, values, avals):
        """Unpack the NumPy variables that hold small arrays."""
        pairs = zip(values, avals, strict=True)
        return [self.unpack_array(value, aval) if is_small_array(aval) else value for value, aval in pairs]

    # loops and conditionals

    def write_block(self, outer_block, closed_jaxpr, input_values):
        """Write a closed jaxpr in a new block; return the block and the values of the results."""
        self.block = Block(outer_block)
        results = self.write_jaxpr(remove_unused_equations(closed_jaxpr), input_values)
        return self.block, results

    def new_variables(self, avals):
        """Create variables for values of given shapes and types."""
        return [
            np.array([self.new_number() for _ in range(math.prod(aval.shape))], int).reshape(aval.shape)
            if is_small_array(aval)
            else self.new_number()
            for aval in avals
        ]

    def write_while(self, params, input_values, result_avals):
        n_cond_consts, n_loop_consts = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        cond_consts, body_consts, initial_values, outer_block = (
            input_values[:n_cond_consts],
            input_values[n_cond_consts:n_loop_consts],
            input_values[n_loop_consts:],
            self.block,
        )
        carry_values = self.new_variables(result_avals)
        cond_block, (condition_value,) = self.write_block(
            outer_block, params["cond_jaxpr"], [*cond_consts, *carry_values]
        )
        (condition_aval,) = _avals_of(params["cond_jaxpr"].jaxpr.outvars)
        if condition_aval.shape:  # finished lanes keep their values
            active_lanes_number = self.pack_array(condition_value, condition_aval)
            condition_number = self.emit_line("{0}.any()", [active_lanes_number])
        else:
            condition_number = int(condition_value)
        body_block, next_carry_values = self.write_block(
            cond_block, params["body_jaxpr"], [*body_consts, *carry_values]
        )
        if condition_aval.shape:
            packed_carries = [
                [self.pack_array(*entry) for entry in zip(values, result_avals, strict=True)]
                for values in (next_carry_values, carry_values)
            ]
            results = [
                self.emit_line("select_active({0}, {1}, {2})", [active_lanes_number, *pair])
                for pair in zip(*packed_carries, strict=True)
            ]
            next_carry_values = self.unpack_small(results, result_avals)
        self.block = outer_block
        loop = Loop(
            _flatten_numbers(carry_values),
            _flatten_numbers(initial_values),
            _flatten_numbers(next_carry_values),
            body_block.lines,
            cond_block.lines,
            condition_number,
        )
        outer_block.lines.append(loop)
        return carry_values

    def write_scan(self, params, input_values, result_avals):
        body_jaxpr, n_consts, n_carry = params["jaxpr"], params["num_consts"], params["num_carry"]
        body_avals, outer_block = _avals_of(body_jaxpr.jaxpr.invars), self.block
        carry_values, row_values = (
            self.new_variables(result_avals[:n_carry]),
            self.new_variables(body_avals[n_consts + n_carry :]),
        )
        body_block, body_results = self.write_block(
            outer_block, body_jaxpr, [*input_values[:n_consts], *carry_values, *row_values]
        )
        self.block, row_sources, output_lists, output_texts = outer_block, [], [], []
        reversal_text = "[::-1]" if params["reverse"] else ""
        for value, entry, aval in zip(
            input_values[n_consts + n_carry :], row_values, body_avals[n_consts + n_carry :], strict=True
        ):
            is_small_value = is_small_array(aval)
            array_number = value
            if isinstance(value, np.ndarray):
                shape = (params["length"], *aval.shape)
                array_number = self.pack_array(value, jax.ShapeDtypeStruct(shape, aval.dtype))
            to_rows_text = f".reshape({params['length']}, {math.prod(aval.shape)}).tolist()" if is_small_value else ""
            row_sources.append(
                (
                    Line((), [array_number], f"{{0}}{to_rows_text}{reversal_text}"),
                    entry.ravel().tolist() if is_small_value else [entry],
                    not is_small_value,
                )
            )
        for value, aval in zip(body_results[n_carry:], result_avals[n_carry:], strict=True):
            is_small_value, output_list_number = isinstance(value, np.ndarray), self.new_number()
            output_lists.append(
                (output_list_number, value.ravel().tolist() if is_small_value else [value], not is_small_value)
            )
            text = f"np.array({{0}}{reversal_text}, np.dtype('{np.dtype(aval.dtype).str}')).reshape({aval.shape})"
            output_texts.append((text, output_list_number))
        lines, length = body_block.lines, params["length"]
        loop = Loop(
            _flatten_numbers(carry_values),
            _flatten_numbers(input_values[n_consts : n_consts + n_carry]),
            _flatten_numbers(body_results[:n_carry]),
            lines,
            (),
            None,
            length,
            row_sources,
            output_lists,
        )
        outer_block.lines.append(loop)
        output_numbers = [self.emit_line(text, [entry]) for text, entry in output_texts]
        return [*carry_values, *self.unpack_small(output_numbers, result_avals[n_carry:])]

    def write_cond(self, branches, input_values, result_avals):
        case_number, outer_block = int(input_values[0]), self.block
        if case_number in self.values:
            return self.write_jaxpr(
                branches[min(max(int(self.values[case_number]), 0), len(branches) - 1)], input_values[1:]
            )
        branch_blocks = []
        for branch in branches:
            block, branch_results = self.write_block(outer_block, branch, input_values[1:])
            branch_blocks.append((block.lines, _flatten_numbers(branch_results)))
        self.block, results = outer_block, self.new_variables(result_avals)
        outer_block.lines.append(Conditional(_flatten_numbers(results), case_number, branch_blocks))
        return results


def _avals_of(variables):
    return [var.aval for var in variables]


def _flatten_numbers(values):
    """Return the variables of values in one list."""
    return [item for value in values for item in (value.ravel().tolist() if isinstance(value, np.ndarray) else [value])]
