"""Keep traced functions between processes, in a folder inside JAX's compilation cache, if that is set.

JAX's cache saves compiling, but each process traces and lowers its functions again, which is most of a start with a
cache. This module also stores the lowered module (jax.export) and calls it in place of the function's body, and stores
the program of a function that is evaluated without compiling (`python_program`). Both are executed, so `cache_file`
reads them only from a folder that only the user can write to, and only if their digest is correct. JAX trusts its own
cache in the same folder.
"""

import dataclasses
import hashlib
import importlib.util
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache, partial, reduce, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, overload

import jax
import jaxlib
import numpy as np
from jax import export
from jax.api_util import shaped_abstractify
from jax.core import ShapedArray, Tracer

from . import cache_file, numpy_evaluation, python_program
from .packed_call import PackedCall

FOLDER = "modules"  # folder inside JAX's cache
MAX_GENERATIONS = 3  # number of versions of the sources whose modules are kept
PROGRAM_SUFFIX = ".code"  # suffix of programs; modules have none
NUMBER = "number"
FAST_COMPILE = {"xla_backend_optimization_level": 0}  # halves the compile time of functions that the host calls rarely
HOST_TYPES = {np.ndarray, np.float64, np.float32, np.int32, np.int64, np.bool_, bool, int, float}  # types of no tracer
_own_packages = {__name__.split(".")[0]}  # packages whose sources determine traced functions
_pending: list[Callable[[], None]] = []  # compiles a function for a signature that NumPy evaluates

Params = ParamSpec("Params")
Result = TypeVar("Result")


class NotPersistentError(Exception):
    """Error for a value without a name that is valid in every process."""


@overload
def persistent_jit(function: Callable[Params, Result], **options: Any) -> Callable[Params, Result]: ...
@overload
def persistent_jit(**options: Any) -> Callable[[Callable[Params, Result]], Callable[Params, Result]]: ...
def persistent_jit(
    function: Callable[..., Any] | None = None, numpy_first: bool | Callable[..., Any] = False, **options: Any
) -> Callable[..., Any]:
    """Apply `jax.jit` to a module-level function that the host calls, and store its lowered module.

    Parameters
    ----------
    function : callable, optional
        Module-level function. Without it a decorator is returned.
    numpy_first : bool or callable, optional
        Evaluate the function by Python and NumPy (`numpy_evaluation`) until the cost reaches that of compiling. A
        function with the same result is evaluated in its place. Such a function takes no keyword arguments, and on the
        host its results are NumPy arrays (`packed_call`).
    **options : Any
        Options of `jax.jit`.

    Returns
    -------
    callable
        The function.

    Notes
    -----
    Under a transformation this is the jitted function without compiler options, which JAX accepts for whole programs
    only: exported modules have no derivatives and no batching. Nothing is stored if JAX has no compilation cache, if
    the program does not run on a single CPU device, or if an argument exists in this process only, such as a user's
    function.
    """
    if function is None:
        return partial(persistent_jit, numpy_first=numpy_first, **options)
    _own_packages.add(function.__module__.split(".")[0])
    jitted = jax.jit(function, **{key: option for key, option in options.items() if key != "compiler_options"})

    @wraps(function)
    def call_module(*args, **kwargs):
        module = _persistent_module(function, args, kwargs)
        return function(*args, **kwargs) if module is None else module(*_tracers((args, kwargs)))

    call = (
        _make_host_call(function, numpy_first, jitted, call_module, options)
        if numpy_first
        else _make_call(jitted, call_module, options)
    )
    call = wraps(function)(call)
    call.lower = jax.jit(function, **options).lower  # type: ignore[attr-defined]  # functions accept any attribute
    return call


def compile_evaluated() -> Iterator[int]:
    """Compile the functions that NumPy evaluates in this process, the most recent first.

    Compiled functions take at most a tenth of the time, so this suits processes that continue. Calls from other threads
    are evaluated until then.

    Yields
    ------
    int
        Number of functions and signatures that remain.
    """
    while _pending:
        _pending.pop()()
        yield len(_pending)


def _make_call(jitted, call_module, options):
    persistent_call = jax.jit(call_module, **options)

    def call(*args, **kwargs):
        return jitted(*args, **kwargs) if _tracers((args, kwargs)) else persistent_call(*args, **kwargs)

    return call


def _make_host_call(function, numpy_first, jitted, call_module, options):
    static = np.atleast_1d(options.get("static_argnums", ())).astype(int).tolist()
    host_function = numpy_first if callable(numpy_first) else function
    read, store = partial(_read_program, host_function, static), partial(_store_program, host_function, static)
    evaluator = numpy_evaluation.NumpyEvaluator(host_function, static, {}, read, store)
    jit_options = {key: option for key, option in options.items() if key != "static_argnums"}
    compiled_calls: dict[Any, PackedCall] = {}  # by signature

    def make_packed_call(args, treedef, leaves):
        @wraps(function)
        def call_with_leaves(*leaves):
            leaf_iter = iter(treedef.unflatten(leaves))
            return call_module(*[arg if index in static else next(leaf_iter) for index, arg in enumerate(args)])

        return PackedCall(call_with_leaves, leaves, jit_options)

    def compile_signature(args, leaves, signature):
        if signature not in compiled_calls:
            packed_call = make_packed_call(args, signature[0], leaves)
            with jax.enable_x64(signature[-1]):
                packed_call(leaves)
            compiled_calls[signature] = packed_call

    def call(*args):
        leaves, signature = numpy_evaluation.call_signature(args, static)
        if not HOST_TYPES.issuperset(map(type, leaves)) and _tracers(leaves):
            return jitted(*args)
        packed_call = compiled_calls.get(signature)
        if packed_call is None:
            is_new = signature not in evaluator.evaluations
            result = evaluator.evaluate(args, leaves, signature)
            if result is not None:
                if is_new:
                    _pending.append(partial(compile_signature, args, leaves, signature))
                return result
            packed_call = compiled_calls[signature] = make_packed_call(args, signature[0], leaves)
        return packed_call(leaves)

    return call


def _tracers(tree):
    """Return the leaves of a tree that are tracers."""
    return [leaf for leaf in jax.tree.leaves(tree) if isinstance(leaf, Tracer)]


def _persistent_module(function, args, kwargs):
    """Return a function of tracers that calls the stored or exported module; None if that is not possible."""
    try:
        path = _module_path(function, args, kwargs)
        if path is None:
            return None
        content = cache_file.read(path)
        structure, payload = _export_module(function, args, kwargs, path) if content is None else _split_file(content)
        module, treedef = export.deserialize(bytearray(payload)), jax.tree.structure(_build(structure))
    except Exception:  # a full disk, a foreign file, or a function that JAX cannot export: call the function itself
        return None
    return lambda *tracers: treedef.unflatten(module.call(*tracers))


def _program_path(function, static, args):
    """Return the file of a function's program for such arguments; None if nothing is stored."""
    avals = (arg if index in static else jax.tree.map(shaped_abstractify, arg) for index, arg in enumerate(args))
    path = _module_path(function, tuple(avals), {})
    return path and path.with_suffix(PROGRAM_SUFFIX)


def _read_program(function, static, args):
    """Read the stored `Evaluation` of a host function, or None."""
    try:
        path = _program_path(function, static, args)
        content = None if path is None else cache_file.read(path)
        if content is None:
            return None
        structure, code = _split_file(content)
        return numpy_evaluation.Evaluation(python_program.load_program(code), jax.tree.structure(_build(structure)))
    except Exception:  # as in `_persistent_module`
        return None


def _store_program(function, static, args, evaluation):
    """Store the program of an `Evaluation`."""
    with suppress(Exception):
        path = _program_path(function, static, args)
        structure = _describe(jax.tree.unflatten(evaluation.treedef, [NUMBER] * evaluation.treedef.num_leaves))
        if path and evaluation.program.text and jax.tree.structure(_build(structure)) == evaluation.treedef:
            cache_file.write(path, _join_file(structure, python_program.compile_text(evaluation.program.text)))


def _module_path(function, args, kwargs):
    """Return the file of a function's module for such arguments, existing or not; None if nothing is stored."""
    folder = _folder()
    if folder is None:
        return None
    key = [_qualified_name(function), _describe((args, kwargs)), bool(jax.config.jax_enable_x64)]
    key.append(str(jax.config.jax_default_matmul_precision))
    return folder / hashlib.sha256(json.dumps(key).encode()).hexdigest()


def cache_folder():
    """Return the folder of JAX's compilation cache as text; None or empty if it is not set."""
    return jax.config.jax_compilation_cache_dir


def reason_without_cache() -> str | None:
    """Explain why traced functions are not stored in this process.

    Returns
    -------
    str or None
        The reason; None if they are stored.
    """
    return _reason_not_persistent() or cache_file.reason_for_distrust(*_folders())


def _reason_not_persistent():
    """Explain why nothing can be stored in any folder; None if it can."""
    folder = cache_folder()
    if not folder:
        return "no cache folder is set (JAX_COMPILATION_CACHE_DIR)"
    if "://" in folder:
        return "the cache is not a folder of the file system"
    if jax.default_backend() != "cpu":
        return f"functions are compiled for {jax.default_backend()}, not for the CPU"
    return "there are several devices" if jax.device_count() > 1 else None


def _folders():
    """Return JAX's cache folder, the folder of modules in it, and the folder for the present sources in that."""
    root = Path(cache_folder())
    return root, root / FOLDER, root / FOLDER / _source_stamp(tuple(sorted(_own_packages)))


def _folder():
    """Return the folder of the modules of the present sources, created if missing; None if nothing is stored."""
    if _reason_not_persistent():
        return None
    root, modules, folder = folders = _folders()
    if _is_distrusted(root, root):
        return None
    is_new = not folder.is_dir()
    for path in folders if is_new else ():
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    if _is_distrusted(root, *folders):
        return None
    if is_new:
        other_generations = [path for path in modules.iterdir() if path != folder]
        for path in sorted(other_generations, key=lambda path: -path.stat().st_mtime)[MAX_GENERATIONS - 1 :]:
            shutil.rmtree(path, ignore_errors=True)
    return folder


def _is_distrusted(root, *folders):
    """Return True, with a warning, if the folders of a cache must not be used."""
    reason = cache_file.reason_for_distrust(*folders)
    if reason is not None:
        cache_file.warn_once(root, reason)
    return reason is not None


@lru_cache
def _source_stamp(packages):
    """Return a digest of everything that a module depends on besides function and arguments: sources and versions."""
    versions = (sys.version_info[:2], jax.__version__, jaxlib.__version__, np.__version__)
    digest = hashlib.sha256(repr((*versions, sys.implementation.name, importlib.util.MAGIC_NUMBER)).encode())
    for package in packages:
        origin = Path(sys.modules[package].__file__)
        for path in sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]:
            content = path.read_bytes()
            digest.update(f"\n{package} {path.relative_to(origin.parent)} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:32]


def _join_file(structure, payload):
    """Join the structure of a result and its module or program to the content of a file."""
    return json.dumps(structure).encode() + b"\n" + payload


def _split_file(content):
    """Split the content of a file into the structure of the result and the module or program."""
    structure, payload = content.split(b"\n", 1)
    return json.loads(structure), payload


def _export_module(function, args, kwargs, path):
    """Export a function, write its module, and return its structure and module."""
    leaves, treedef = jax.tree.flatten((args, kwargs))
    structure = []

    def flat_function(*tracers):
        tracer_iter = iter(tracers)
        args, kwargs = treedef.unflatten([next(tracer_iter) if isinstance(leaf, Tracer) else leaf for leaf in leaves])
        result = function(*args, **kwargs)
        structure[:] = [_describe(jax.tree.map(lambda _: NUMBER, result))]
        if jax.tree.structure(_build(*structure)) != jax.tree.structure(result):
            raise NotPersistentError(result)
        return jax.tree.leaves(result)

    flat_function.__name__ = function.__name__
    avals = (jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type) for aval in _tracers(leaves))
    module = export.export(jax.jit(flat_function))(*avals)
    if any(aval.weak_type for aval in module.out_avals):
        raise NotPersistentError("weakly typed results are not stored")
    module = bytes(module.serialize())
    cache_file.write(path, _join_file(structure[0], module))
    return structure[0], module


def _describe(value):
    """Describe the structure of a value as lists and texts: types of tracers, values of everything else."""
    if value is NUMBER:
        return NUMBER
    if isinstance(value, Tracer | ShapedArray):
        return {"number": [str(value.dtype), list(value.shape), bool(value.weak_type)]}
    if value is None or type(value) in (bool, int, float, str):
        return {"is": value}
    if type(value) in (tuple, list):
        return {type(value).__name__: [_describe(item) for item in value]}
    if type(value) is dict:
        return {"dict": [_describe(item) for item in value.items()]}
    if isinstance(value, partial):
        return {"partial": [_describe(item) for item in (value.func, value.args, value.keywords)]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [getattr(value, field.name) for field in dataclasses.fields(value)]
        return {"class": _qualified_name(type(value)), "parts": [_describe(item) for item in fields]}
    if isinstance(value, tuple):
        return {"class": _qualified_name(type(value)), "parts": [_describe(item) for item in value]}
    return {"function": _qualified_name(value)}


def _build(structure):
    """Build the value of a description, with 0 for each number."""
    if structure == NUMBER:
        return 0
    if "class" in structure:
        return _resolve_name(structure["class"])(*(_build(item) for item in structure["parts"]))
    ((kind, items),) = structure.items()
    return items if kind == "is" else {"tuple": tuple, "list": list, "dict": dict}[kind](_build(item) for item in items)


def _qualified_name(value):
    """Return module:name of a function or class of these packages; raise NotPersistentError for any other value."""
    name = f"{getattr(value, '__module__', '')}:{getattr(value, '__qualname__', '')}"
    resolved = _resolve_name(name)
    if value not in (resolved, getattr(resolved, "__wrapped__", None)):
        raise NotPersistentError(name)
    return name


def _resolve_name(name):
    """Return the function or class of these packages with a name."""
    module, qualname = name.split(":")
    if module.split(".")[0] not in _own_packages:
        raise NotPersistentError(name)
    return reduce(getattr, qualname.split("."), sys.modules[module])
