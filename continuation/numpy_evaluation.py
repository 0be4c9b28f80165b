"""Traced functions evaluated by Python and NumPy: an answer without compiling.

Compiling takes a second and more, evaluating a line of a function less than a tenth of a microsecond. So what the host
calls a few times is evaluated, and compiled once that has cost about as much: never on more than twice the shorter way.
The equations are those that jax traces, derivatives included (`python_program`), so both ways have one source; their
numbers differ by roundings.
"""

import gc
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from .numpy_indexing import NoRuleError
from .python_program import Program, build_program

MAX_EVALUATIONS = 10_000  # times that all lines of a function are run before it is compiled, which costs as much
WEAK_TYPES = {bool, int, float, complex}  # types of numbers that jax takes for weak ones


def call_signature(args, static_indices):
    """(the numbers of a function's arguments in a row; what decides how it is traced, a key). static_indices: places of
    arguments that are no numbers."""
    leaves, treedef = jax.tree.flatten([arg for index, arg in enumerate(args) if index not in static_indices])
    leaf_types = [type(leaf) if type(leaf) in WEAK_TYPES else (leaf.shape, leaf.dtype) for leaf in leaves]
    return leaves, (
        treedef,
        tuple(leaf_types),
        tuple([args[index] for index in static_indices]),
        jax.config.jax_enable_x64,
    )


@contextmanager
def pause_garbage_collection():
    """Python's collector of circles waits: tracing makes many objects that stay, and would have it look at all of them
    again and again, an eighth of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@dataclass
class Evaluation:
    """A function's program, the form of its result, and how many lines of it were run."""

    program: Program
    treedef: Any
    lines_run: int = 0


class NumpyEvaluator(NamedTuple):
    """How a function is evaluated for each kind of arguments that it has met. static_indices: places of arguments that
    are no numbers, of which one may say `at_once`; evaluations: {kind: `Evaluation`, None where it is compiled at
    once}; read_program, store_program: the way for arguments like these that an earlier process has kept, None where
    there is none; keeps one."""

    function: Callable[..., Any]
    static_indices: Sequence[int]
    evaluations: dict[Any, Any]
    read_program: Callable[[tuple[Any, ...]], Evaluation | None] = lambda args: None
    store_program: Callable[[tuple[Any, ...], Evaluation], None] = lambda args, evaluation: None

    def __call__(self, args: tuple[Any, ...]) -> Any:
        """The function's result; None, which it never is, where it is to be compiled."""
        return self.evaluate(args, *call_signature(args, self.static_indices))

    def evaluate(self, args: tuple[Any, ...], leaves: Sequence[Any], signature: Any) -> Any:
        """The same of arguments with these numbers and of this kind (`call_signature`)."""
        if signature not in self.evaluations:
            compile_at_once = any(getattr(args[index], "compile_at_once", False) for index in self.static_indices)
            self.evaluations[signature] = (
                None if compile_at_once else self.read_program(args) or self.trace_function(args)
            )
        evaluation = self.evaluations[signature]
        if evaluation is None or evaluation.lines_run >= MAX_EVALUATIONS * evaluation.program.size:
            return None
        with np.errstate(all="ignore"):
            results, lines_run = evaluation.program.run(*[np.asarray(leaf)[()] for leaf in leaves])
        evaluation.lines_run += lines_run
        return jax.tree.unflatten(evaluation.treedef, results)

    def trace_function(self, args: tuple[Any, ...]) -> Evaluation | None:
        """The `Evaluation` for arguments like these; None where an equation has no rule, or, in another version of jax,
        other names of its parameters."""
        try:
            with pause_garbage_collection():
                jax_trace = jax.jit(self.function, static_argnums=tuple(self.static_indices)).trace(*args)
                evaluation = Evaluation(build_program(jax_trace.jaxpr), jax.tree.structure(jax_trace.out_info))
        except (NoRuleError, KeyError):
            return None
        self.store_program(args, evaluation)
        return evaluation
