"""Evaluate traced functions by Python and NumPy, without compiling.

Compiling takes a second or more; evaluating one line of a function takes less than 0.1 microseconds. A function that
the host calls a few times is therefore evaluated, and compiled once the evaluations cost about as much as compiling:
the total cost is at most twice the optimum. The equations are those that JAX traces, derivatives included
(`python_program`). Results differ from compiled ones by rounding errors.
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

MAX_EVALUATIONS = 10_000  # evaluations of a function whose cost equals that of compiling it
WEAK_TYPES = {bool, int, float, complex}  # Python types that JAX treats as weakly typed


def call_signature(args, static_indices):
    """Return (leaves of the arguments, key of the signature that decides how the function is traced).

    Arguments with indices in `static_indices` are not numbers.
    """
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
    """Pause Python's cyclic garbage collector while tracing.

    Tracing creates many lasting objects; repeated scans of them cost an eighth of the time.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@dataclass
class Evaluation:
    """Program of a function, structure of its result and number of lines run."""

    program: Program
    treedef: Any
    lines_run: int = 0


class NumpyEvaluator(NamedTuple):
    """Evaluator of a function for each signature of its arguments.

    Parameters
    ----------
    function : callable
        Function to evaluate.
    static_indices : sequence of int
        Indices of the arguments that are not numbers. One of them may have an attribute `compile_at_once`.
    evaluations : dict
        `Evaluation` by signature; None if the function is compiled at once.
    read_program : callable, optional
        Returns the `Evaluation` that an earlier process stored for such arguments, or None.
    store_program : callable, optional
        Stores an `Evaluation`.
    """

    function: Callable[..., Any]
    static_indices: Sequence[int]
    evaluations: dict[Any, Any]
    read_program: Callable[[tuple[Any, ...]], Evaluation | None] = lambda args: None
    store_program: Callable[[tuple[Any, ...], Evaluation], None] = lambda args, evaluation: None

    def __call__(self, args: tuple[Any, ...]) -> Any:
        """Evaluate the function; None if it should be compiled."""
        return self.evaluate(args, *call_signature(args, self.static_indices))

    def evaluate(self, args: tuple[Any, ...], leaves: Sequence[Any], signature: Any) -> Any:
        """Evaluate the function with given leaves and signature (`call_signature`); None if it should be compiled."""
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
        """Make the `Evaluation` for such arguments; None if an equation has no rule or JAX renamed its parameters."""
        try:
            with pause_garbage_collection():
                jax_trace = jax.jit(self.function, static_argnums=tuple(self.static_indices)).trace(*args)
                evaluation = Evaluation(build_program(jax_trace.jaxpr), jax.tree.structure(jax_trace.out_info))
        except (NoRuleError, KeyError):
            return None
        self.store_program(args, evaluation)
        return evaluation
