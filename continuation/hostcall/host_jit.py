"""Call traced functions from the host: evaluate them by Python and NumPy first, and compile them when that pays.

Call compiled functions with all arguments and results packed in one array per type. Passing an array takes two
microseconds, and fetching an array takes three microseconds. A scene, a point and a step control consist of thirty
arrays. Their transfer would take most of the time of a short function.

Compiling takes a second or more. Evaluating one line of a function takes less than 0.1 microseconds. A function that
the host calls a few times is therefore evaluated. It is compiled when its evaluations have cost about as much as
compiling, so that the total cost is at most twice the optimum. The equations are those that JAX traces, including
derivatives (`program_writer`). Results differ from those of compiled functions by rounding errors.

JAX's cache avoids compiling, but each process traces and lowers its functions again, which takes most of the start-up
time. Programs and lowered modules are therefore stored for later processes (`module_store`).
"""

import gc
import math
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from . import module_store, tree_description
from .module_store import tracer_leaves
from .program_writer import build_program, load_program
from .rules import NoRuleError

WEAK_TYPES = {bool, int, float, complex}  # Python types that JAX treats as weakly typed


class ArrayLayout:
    """Layout that packs arrays of known shapes and types into one row per type."""

    def __init__(self, template_arrays):
        indices_by_dtype, slot_by_index = {}, {}
        for index, array in enumerate(template_arrays):
            indices_by_dtype.setdefault(np.dtype(array.dtype), []).append(index)
        self.row_indices = list(indices_by_dtype.values())
        for row, indices in enumerate(self.row_indices):
            start = 0
            for index in indices:
                shape = np.shape(template_arrays[index])
                slot_by_index[index] = row, start, start + math.prod(shape), shape
                start += math.prod(shape)
        # Of each array: (row, start, stop, shape).
        self.slots = [slot_by_index[index] for index in range(len(slot_by_index))]

    def pack(self, arrays: Sequence[Any], concatenate: Callable[..., Any] = np.concatenate) -> list[Any]:
        """Pack arrays into rows, of NumPy or of JAX."""
        return [concatenate([arrays[index] for index in indices], axis=None) for indices in self.row_indices]

    def unpack(self, rows: Sequence[Any]) -> list[Any]:
        """Unpack rows into arrays."""
        return [rows[row][start:stop].reshape(shape) for row, start, stop, shape in self.slots]


class PackedCall:
    """Compiled function that takes the leaves of a pytree on the host and returns a pytree of NumPy arrays.

    `function` takes the leaves as arguments. `leaves` are examples that define shapes and types.
    """

    def __init__(self, function: Callable[..., Any], leaves: Sequence[Any], jit_options: dict[str, Any]) -> None:
        self.function = function
        self.array_indices = [index for index, leaf in enumerate(leaves) if type(leaf) not in WEAK_TYPES]
        self.scalar_indices = [index for index, leaf in enumerate(leaves) if type(leaf) in WEAK_TYPES]
        self.argument_layout = ArrayLayout([leaves[index] for index in self.array_indices])
        self.result_layout: tuple[ArrayLayout, Any] | None = None
        self.compiled_function = jax.jit(self._call_with_rows, **jit_options)

    def _call_with_rows(self, rows, scalar_leaves):
        leaves = dict(zip(self.array_indices, self.argument_layout.unpack(rows), strict=True))
        leaves |= zip(self.scalar_indices, scalar_leaves, strict=True)
        results, treedef = jax.tree.flatten(self.function(*[leaves[index] for index in range(len(leaves))]))
        results = [jnp.asarray(array) for array in results]
        self.result_layout = ArrayLayout(results), treedef
        return self.result_layout[0].pack(results, jnp.concatenate)

    def __call__(self, leaves: Sequence[Any]) -> Any:
        arrays = [leaves[index] for index in self.array_indices] if self.scalar_indices else leaves
        scalars = [leaves[index] for index in self.scalar_indices]
        results = self.compiled_function(self.argument_layout.pack(arrays), scalars)
        assert self.result_layout is not None  # the call has traced the function
        layout, treedef = self.result_layout
        return treedef.unflatten(layout.unpack([np.asarray(array) for array in results]))


FAST_COMPILE = {"xla_backend_optimization_level": 0}  # halves the compile time of functions that the host calls rarely
HOST_TYPES = {np.ndarray, np.float64, np.float32, np.int32, np.int64, np.bool_, bool, int, float}  # types of no tracer
max_evaluations = 10_000  # evaluations of a function whose cost equals that of compiling it
_fallbacks: Counter[tuple[str, str]] = Counter()
_open_queues: list["CompilationQueue"] = []

Params = ParamSpec("Params")
Result = TypeVar("Result")


def persistent_jit(
    numpy_first: bool = False, **options: Any
) -> Callable[[Callable[Params, Result]], Callable[Params, Result]]:
    """Make a decorator that applies `jax.jit` to a module-level function that the host calls, and stores its module.

    Parameters
    ----------
    numpy_first : bool, optional
        If true, evaluate the function by Python and NumPy until the cost reaches that of compiling. The decorated
        function then takes no keyword arguments, and its results on the host are NumPy arrays (`host_jit`). A
        static argument with a true attribute `compile_at_once` prevents the evaluation.
    **options : Any
        Options of `jax.jit`.

    Returns
    -------
    callable
        The decorator.

    Notes
    -----
    Under a transformation the jitted function is called, because exported modules support neither derivatives nor
    batching. The jitted function has no compiler options, because JAX accepts these for whole programs only. Nothing
    is stored if JAX has no compilation cache, if the program does not run on a single CPU device, or if an argument
    exists only in this process, such as a user's function.
    """

    def decorate(function):
        tree_description.own_packages.add(function.__module__.split(".")[0])
        plain_options = {key: option for key, option in options.items() if key != "compiler_options"}
        jitted_function = jax.jit(function, **plain_options)

        @wraps(function)
        def call_stored_module(*args, **kwargs):
            module_call = module_store.load_or_export_module(function, args, kwargs)
            return function(*args, **kwargs) if module_call is None else module_call(*tracer_leaves((args, kwargs)))

        make_call = HostFunction if numpy_first else _make_plain_call
        return wraps(function)(make_call(jitted_function, call_stored_module, options))

    return decorate


def _make_plain_call(jitted_function, call_stored_module, options):
    jitted_module_call = jax.jit(call_stored_module, **options)

    def call(*args, **kwargs):
        return (jitted_function if tracer_leaves((args, kwargs)) else jitted_module_call)(*args, **kwargs)

    return call


class HostFunction:
    """Function that the host calls: NumPy evaluates it until that has cost as much as compiling it.

    Parameters
    ----------
    jitted_function : callable
        The function by `jax.jit`, for calls under a transformation.
    call_stored_module : callable
        The function for calls by compiled programs; it calls the stored module if there is one.
    options : dict
        Options of `jax.jit`.
    """

    def __init__(self, jitted_function, call_stored_module, options):
        self.jitted_function, self.call_stored_module = jitted_function, call_stored_module
        self.static_indices = np.atleast_1d(options.get("static_argnums", ())).astype(int).tolist()
        self.jit_options = {key: option for key, option in options.items() if key != "static_argnums"}
        self.signature_calls: dict[Any, SignatureCall] = {}

    def __call__(self, *args):
        leaves, signature = leaves_and_signature(args, self.static_indices)
        if not HOST_TYPES.issuperset(map(type, leaves)) and tracer_leaves(leaves):
            return self.jitted_function(*args)
        call = self.signature_calls.get(signature)
        if call is None:
            call = self.signature_calls[signature] = self._make_signature_call(args, leaves, signature)
        return call(leaves)

    def _make_signature_call(self, args, leaves, signature):
        # The call keeps the static arguments only.
        static_args, n_args = dict(zip(self.static_indices, signature[2], strict=True)), len(args)

        @wraps(self.call_stored_module)
        def call_with_leaves(*leaves):
            traced_args = iter(signature[0].unflatten(leaves))
            return self.call_stored_module(
                *[static_args[index] if index in static_args else next(traced_args) for index in range(n_args)]
            )

        packed_call = PackedCall(call_with_leaves, leaves, self.jit_options)
        return SignatureCall(packed_call, signature[-1], *self.find_program(args))

    def find_program(self, args):
        """Return the program of the function for these arguments and the tree of its results.

        Both are None if the function is compiled instead.
        """
        if any(getattr(args[index], "compile_at_once", False) for index in self.static_indices):
            return None, None
        function = self.call_stored_module.__wrapped__
        path = module_store.program_path(function, self.static_indices, args)
        try:
            return _read_program(path) or self._trace_program(args, path)
        except (NoRuleError, KeyError) as error:  # also equations of an unknown version of JAX
            count_fallback(function, error)
            return None, None

    def _trace_program(self, args, path):
        with pause_garbage_collection():
            trace = self.jitted_function.trace(*args)
            program = build_program(trace.jaxpr)
        if path:
            with suppress(Exception):  # a full disk, or a result of a class that exists only in this process
                module_store.write_item(path, trace.out_info, program.byte_code)
        return program, jax.tree.structure(trace.out_info)


def _read_program(path):
    """Return the program that an earlier process stored and the tree of its results; None if there is none."""
    with suppress(Exception):  # a file whose classes cannot be found
        stored_item = path and module_store.read_item(path)
        return stored_item and (load_program(stored_item[1]), jax.tree.structure(stored_item[0]))
    return None


class SignatureCall:
    """Calls of a host function with arguments of one signature.

    Parameters
    ----------
    packed_call : PackedCall
        The compiled function.
    enable_x64 : bool
        Precision of the signature.
    program : PythonProgram or None
        Program of the function; None if it is compiled.
    result_treedef : PyTreeDef or None
        Tree structure of the results of the program.
    """

    def __init__(self, packed_call, enable_x64, program, result_treedef):
        self.packed_call, self.enable_x64 = packed_call, enable_x64
        self.program, self.result_treedef, self.n_lines_run = program, result_treedef, 0

    def __call__(self, leaves):
        program = self.program
        if program is not None and self.n_lines_run >= max_evaluations * program.size:
            program = self.program = None  # compiled from now on
        if program is None:
            return self.packed_call(leaves)
        for queue in _open_queues:
            queue.leaves_by_call[self] = leaves
        try:
            with np.errstate(all="ignore"):
                results, n_lines_run = program.run(*[np.asarray(leaf)[()] for leaf in leaves])
        except NoRuleError as error:  # operands that a rule refuses
            count_fallback(self.packed_call.function, error)
            self.program = None
            return self.packed_call(leaves)
        self.n_lines_run += n_lines_run
        return jax.tree.unflatten(self.result_treedef, results)

    def compile(self, leaves):
        """Compile the function for this signature; until then, NumPy evaluates calls from other threads."""
        with jax.enable_x64(self.enable_x64):
            self.packed_call(leaves)
        self.program = None


def count_fallback(function, error):
    """Count that a function is compiled instead of evaluated, with the reason."""
    _fallbacks[function.__qualname__, f"{type(error).__name__}: {error}"] += 1


def fallback_counts() -> dict[tuple[str, str], int]:
    """Return how many signatures of functions were compiled instead of evaluated, by (function, reason)."""
    return dict(_fallbacks)


class CompilationQueue:
    """Functions that NumPy evaluates while this context is open, to be compiled when there is time.

    Long-running processes benefit, because compiled functions take at most a tenth of the time. Until a function is
    compiled, NumPy evaluates its calls from other threads.
    """

    def __init__(self) -> None:
        self.leaves_by_call: dict[SignatureCall, Any] = {}

    def __enter__(self) -> "CompilationQueue":
        _open_queues.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _open_queues.remove(self)

    def compile_next(self) -> bool:
        """Compile the function that was added last; return False if none is left."""
        if not self.leaves_by_call:
            return False
        call, leaves = self.leaves_by_call.popitem()
        call.compile(leaves)
        return True


@contextmanager
def compile_at_once():
    """Compile each function at its first call within this context."""
    global max_evaluations
    previous_max_evaluations = max_evaluations
    max_evaluations = 0
    try:
        yield
    finally:
        max_evaluations = previous_max_evaluations


def leaves_and_signature(args, static_indices):
    """Return (leaves of the arguments, signature: a key of all properties on which tracing depends).

    Arguments with indices in `static_indices` are static: they contain no numbers to trace.
    """
    leaves, treedef = jax.tree.flatten([arg for index, arg in enumerate(args) if index not in static_indices])
    leaf_types = tuple([type(leaf) if type(leaf) in WEAK_TYPES else (leaf.shape, leaf.dtype) for leaf in leaves])
    static_args = tuple([args[index] for index in static_indices])
    return leaves, (treedef, leaf_types, static_args, jax.config.jax_enable_x64)


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
