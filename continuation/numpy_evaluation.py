"""Evaluate traced functions by Python and NumPy, without compiling.

Compiling takes a second or more. Evaluating one line of a function takes less than 0.1 microseconds. A function that
the host calls a few times is therefore evaluated. It is compiled when its evaluations have cost about as much as
compiling, so that the total cost is at most twice the optimum. The equations are those that JAX traces, including
derivatives (`jaxpr_to_python`). Results differ from those of compiled functions by rounding errors.
"""

import gc
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from .jaxpr_to_python import PythonProgram, build_program
from .numpy_gather_scatter import NoRuleError

MAX_EVALUATIONS = 10_000  # evaluations of a function whose cost equals that of compiling it
WEAK_TYPES = {bool, int, float, complex}  # Python types that JAX treats as weakly typed


def leaves_and_signature(args, static_indices):
    """Return (leaves of the arguments, signature: a key of all properties on which tracing depends).

    Arguments with indices in `static_indices` are static: they contain no numbers to trace.
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

    Tracing creates many objects that persist. Repeated scans of these objects would take an eighth of the time.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@dataclass
class ProgramEvaluation:
    """Program of a function for one signature, and the cost of its evaluations.

    Attributes
    ----------
    program : PythonProgram
        Program of the function.
    result_treedef : PyTreeDef
        Tree structure of the result.
    n_lines_run : int
        Number of lines that all evaluations have executed.
    """

    program: PythonProgram
    result_treedef: Any
    n_lines_run: int = 0


class NumpyEvaluator(NamedTuple):
    """Evaluator of a function for each signature of its arguments.

    Parameters
    ----------
    function : callable
        Function to evaluate.
    static_indices : sequence of int
        Indices of the static arguments. If one of these has a true attribute `compile_at_once`, the function is not
        evaluated.
    evaluation_by_signature : dict
        `ProgramEvaluation` by signature; None if the function is compiled at once.
    read_program : callable, optional
        Returns the `ProgramEvaluation` that an earlier process stored for this signature, or None.
    store_program : callable, optional
        Stores a `ProgramEvaluation`.
    """

    function: Callable[..., Any]
    static_indices: Sequence[int]
    evaluation_by_signature: dict[Any, Any]
    read_program: Callable[[tuple[Any, ...]], ProgramEvaluation | None] = lambda args: None
    store_program: Callable[[tuple[Any, ...], ProgramEvaluation], None] = lambda args, evaluation: None

    def __call__(self, args: tuple[Any, ...]) -> Any:
        """Evaluate the function; return None if the function should be compiled."""
        return self.evaluate(args, *leaves_and_signature(args, self.static_indices))

    def evaluate(self, args: tuple[Any, ...], leaves: Sequence[Any], signature: Any) -> Any:
        """Evaluate the function with the leaves and the signature of the arguments (`leaves_and_signature`).

        Returns None if the function should be compiled.
        """
        if signature not in self.evaluation_by_signature:
            must_compile_at_once = any(getattr(args[index], "compile_at_once", False) for index in self.static_indices)
            self.evaluation_by_signature[signature] = (
                None if must_compile_at_once else self.read_program(args) or self.trace_function(args)
            )
        evaluation = self.evaluation_by_signature[signature]
        if evaluation is None or evaluation.n_lines_run >= MAX_EVALUATIONS * evaluation.program.size:
            return None
        with np.errstate(all="ignore"):
            results, lines_run = evaluation.program.run(*[np.asarray(leaf)[()] for leaf in leaves])
        evaluation.n_lines_run += lines_run
        return jax.tree.unflatten(evaluation.result_treedef, results)

    def trace_function(self, args: tuple[Any, ...]) -> ProgramEvaluation | None:
        """Make the `ProgramEvaluation` for the signature of these arguments.

        Returns None if an equation has no rule for its parameters.
        """
        try:
            with pause_garbage_collection():
                jax_trace = jax.jit(self.function, static_argnums=tuple(self.static_indices)).trace(*args)
                evaluation = ProgramEvaluation(build_program(jax_trace.jaxpr), jax.tree.structure(jax_trace.out_info))
        except (NoRuleError, KeyError):
            return None
        self.store_program(args, evaluation)
        return evaluation
