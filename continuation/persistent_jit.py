"""Store traced functions for later processes, in a folder inside JAX's compilation cache, if this cache is set.

JAX's cache avoids compiling, but each process traces and lowers its functions again, which takes most of the start-up
time. This module therefore stores the lowered module of a function (jax.export) and calls it in place of the function.
It also stores the program of a function that is evaluated without compiling (`jaxpr_to_python`). Modules and
programs are executed. `trusted_cache_file` therefore reads them only from a folder to which only the user can write,
and only if their digest is correct. JAX trusts its own cache in the same folder.
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

from . import jaxpr_to_python, numpy_evaluation, trusted_cache_file
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
    """Error for a value that cannot be identified in another process by a qualified name."""


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
        Module-level function. None stands for a decorator with the other arguments.
    numpy_first : bool or callable, optional
        If true, evaluate the function by Python and NumPy (`numpy_evaluation`) until the cost reaches that of
        compiling. If callable, evaluate this function, which must give the same result, instead. The decorated function
        then takes no keyword arguments, and its results on the host are NumPy arrays (`packed_call`).
    **options : Any
        Options of `jax.jit`.

    Returns
    -------
    callable
        The decorated function, or the decorator.

    Notes
    -----
    Under a transformation the jitted function is called, because exported modules support neither derivatives nor
    batching. The jitted function has no compiler options, because JAX accepts these for whole programs only. Nothing
    is stored if JAX has no compilation cache, if the program does not run on a single CPU device, or if an argument
    exists only in this process, such as a user's function.
    """
    if function is None:
        return partial(persistent_jit, numpy_first=numpy_first, **options)
    _own_packages.add(function.__module__.split(".")[0])
    jitted_function = jax.jit(function, **{key: option for key, option in options.items() if key != "compiler_options"})

    @wraps(function)
    def call_stored_module(*args, **kwargs):
        module_call = _load_or_export_module(function, args, kwargs)
        return function(*args, **kwargs) if module_call is None else module_call(*_tracer_leaves((args, kwargs)))

    persistent_call = (
        _make_host_call(function, numpy_first, jitted_function, call_stored_module, options)
        if numpy_first
        else _make_plain_call(jitted_function, call_stored_module, options)
    )
    persistent_call = wraps(function)(persistent_call)
    lower = jax.jit(function, **options).lower
    persistent_call.lower = lower  # type: ignore[attr-defined]  # functions accept any attribute
    return persistent_call


def compile_numpy_functions() -> Iterator[int]:
    """Compile the functions that NumPy evaluates in this process, starting with the most recent.

    Long-running processes benefit, because compiled functions take at most a tenth of the time. Until a function is
    compiled, NumPy evaluates its calls from other threads.

    Yields
    ------
    int
        Number of remaining pairs of a function and a signature.
    """
    while _pending:
        _pending.pop()()
        yield len(_pending)


def _make_plain_call(jitted_function, call_stored_module, options):
    jitted_module_call = jax.jit(call_stored_module, **options)

    def call(*args, **kwargs):
        return (
            jitted_function(*args, **kwargs) if _tracer_leaves((args, kwargs)) else jitted_module_call(*args, **kwargs)
        )

    return call


def _make_host_call(function, numpy_first, jitted_function, call_stored_module, options):
    static_indices = np.atleast_1d(options.get("static_argnums", ())).astype(int).tolist()
    numpy_function = numpy_first if callable(numpy_first) else function
    read_program, store_program = (
        partial(_read_program, numpy_function, static_indices),
        partial(_store_program, numpy_function, static_indices),
    )
    evaluator = numpy_evaluation.NumpyEvaluator(numpy_function, static_indices, {}, read_program, store_program)
    jit_options = {key: option for key, option in options.items() if key != "static_argnums"}
    call_by_signature: dict[Any, PackedCall] = {}  # by signature

    def make_packed_call(args, args_treedef, leaves):
        @wraps(function)
        def call_with_leaves(*leaves):
            leaf_iterator = iter(args_treedef.unflatten(leaves))
            return call_stored_module(
                *[arg if index in static_indices else next(leaf_iterator) for index, arg in enumerate(args)]
            )

        return PackedCall(call_with_leaves, leaves, jit_options)

    def compile_signature(args, leaves, signature):
        if signature not in call_by_signature:
            packed_call = make_packed_call(args, signature[0], leaves)
            with jax.enable_x64(signature[-1]):
                packed_call(leaves)
            call_by_signature[signature] = packed_call

    def call(*args):
        leaves, signature = numpy_evaluation.leaves_and_signature(args, static_indices)
        if not HOST_TYPES.issuperset(map(type, leaves)) and _tracer_leaves(leaves):
            return jitted_function(*args)
        packed_call = call_by_signature.get(signature)
        if packed_call is None:
            is_new_to_numpy = signature not in evaluator.evaluation_by_signature
            result = evaluator.evaluate(args, leaves, signature)
            if result is not None:
                if is_new_to_numpy:
                    _pending.append(partial(compile_signature, args, leaves, signature))
                return result
            packed_call = call_by_signature[signature] = make_packed_call(args, signature[0], leaves)
        return packed_call(leaves)

    return call


def _tracer_leaves(pytree):
    """Return the leaves of a tree that are tracers."""
    return [leaf for leaf in jax.tree.leaves(pytree) if isinstance(leaf, Tracer)]


def _load_or_export_module(function, args, kwargs):
    """Return a function of tracers that calls the stored or newly exported module; None if neither is possible."""
    try:
        path = _module_path(function, args, kwargs)
        if path is None:
            return None
        content = trusted_cache_file.read(path)
        result_structure, module_bytes = (
            _export_module(function, args, kwargs, path) if content is None else _split_content(content)
        )
        module, result_treedef = (
            export.deserialize(bytearray(module_bytes)),
            jax.tree.structure(_build_from_description(result_structure)),
        )
    except Exception:  # a full disk, a foreign file, or a function that JAX cannot export: call the function itself
        return None
    return lambda *tracers: result_treedef.unflatten(module.call(*tracers))


def _program_path(function, static_indices, args):
    """Return the path of the program of a function for arguments of these types; None if programs are not stored."""
    abstract_args = (
        arg if index in static_indices else jax.tree.map(shaped_abstractify, arg) for index, arg in enumerate(args)
    )
    path = _module_path(function, tuple(abstract_args), {})
    return path and path.with_suffix(PROGRAM_SUFFIX)


def _read_program(function, static_indices, args):
    """Read the stored `ProgramEvaluation` of a host function; None if it is missing."""
    try:
        path = _program_path(function, static_indices, args)
        content = None if path is None else trusted_cache_file.read(path)
        if content is None:
            return None
        result_structure, program_bytes = _split_content(content)
        return numpy_evaluation.ProgramEvaluation(
            jaxpr_to_python.load_program(program_bytes), jax.tree.structure(_build_from_description(result_structure))
        )
    except Exception:  # as in `_load_or_export_module`
        return None


def _store_program(function, static_indices, args, evaluation):
    """Store the program of a `ProgramEvaluation`."""
    with suppress(Exception):
        path = _program_path(function, static_indices, args)
        result_structure = _describe_structure(
            jax.tree.unflatten(evaluation.result_treedef, [NUMBER] * evaluation.result_treedef.num_leaves)
        )
        if (
            path
            and evaluation.program.text
            and jax.tree.structure(_build_from_description(result_structure)) == evaluation.result_treedef
        ):
            trusted_cache_file.write(
                path, _join_content(result_structure, jaxpr_to_python.compile_program_text(evaluation.program.text))
            )


def _module_path(function, args, kwargs):
    """Return the path of the module of a function for arguments of these types; None if modules are not stored."""
    folder = _prepare_module_folder()
    if folder is None:
        return None
    key = [_qualified_name(function), _describe_structure((args, kwargs)), bool(jax.config.jax_enable_x64)]
    key.append(str(jax.config.jax_default_matmul_precision))
    return folder / hashlib.sha256(json.dumps(key).encode()).hexdigest()


def jax_cache_folder():
    """Return the folder of JAX's compilation cache as text; None or an empty text if the cache is not set."""
    return jax.config.jax_compilation_cache_dir


def reason_without_cache() -> str | None:
    """Explain why traced functions are not stored in this process.

    Returns
    -------
    str or None
        The reason; None if they are stored.
    """
    return _cache_setup_problem() or trusted_cache_file.reason_for_distrust(*_cache_folders())


def _cache_setup_problem():
    """Explain why functions cannot be stored in any folder; return None if they can."""
    folder = jax_cache_folder()
    if not folder:
        return "no cache folder is set (JAX_COMPILATION_CACHE_DIR)"
    if "://" in folder:
        return "the cache is not a folder of the file system"
    if jax.default_backend() != "cpu":
        return f"functions are compiled for {jax.default_backend()}, not for the CPU"
    return "there are several devices" if jax.device_count() > 1 else None


def _cache_folders():
    """Return (JAX's cache folder, its subfolder of modules, the subfolder of modules of the present sources)."""
    cache_root = Path(jax_cache_folder())
    return cache_root, cache_root / FOLDER, cache_root / FOLDER / _source_stamp(tuple(sorted(_own_packages)))


def _prepare_module_folder():
    """Return the folder of modules of the present sources; None if nothing is stored.

    A missing folder is created. The folders of old sources are then removed, except the newest `MAX_GENERATIONS` - 1.
    """
    if _cache_setup_problem():
        return None
    cache_root, all_modules_folder, folder = cache_folders = _cache_folders()
    if _is_distrusted(cache_root, cache_root):
        return None
    is_new = not folder.is_dir()
    for path in cache_folders if is_new else ():
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    if _is_distrusted(cache_root, *cache_folders):
        return None
    if is_new:
        outdated_folders = [path for path in all_modules_folder.iterdir() if path != folder]
        for path in sorted(outdated_folders, key=lambda path: -path.stat().st_mtime)[MAX_GENERATIONS - 1 :]:
            shutil.rmtree(path, ignore_errors=True)
    return folder


def _is_distrusted(cache_root, *folders):
    """Return True, with a warning, if the folders of a cache must not be used."""
    reason = trusted_cache_file.reason_for_distrust(*folders)
    if reason is not None:
        trusted_cache_file.warn_once(cache_root, reason)
    return reason is not None


@lru_cache
def _source_stamp(package_names):
    """Return a digest of the sources and versions on which modules depend."""
    versions = (sys.version_info[:2], jax.__version__, jaxlib.__version__, np.__version__)
    digest = hashlib.sha256(repr((*versions, sys.implementation.name, importlib.util.MAGIC_NUMBER)).encode())
    for package_name in package_names:
        package_file = Path(sys.modules[package_name].__file__)
        for path in sorted(package_file.parent.rglob("*.py")) if package_file.name == "__init__.py" else [package_file]:
            content = path.read_bytes()
            digest.update(
                f"\n{package_name} {path.relative_to(package_file.parent)} {len(content)}\n".encode() + content
            )
    return digest.hexdigest()[:32]


def _join_content(result_structure, program_bytes):
    """Join the structure of a result and a module or program into the content of a file."""
    return json.dumps(result_structure).encode() + b"\n" + program_bytes


def _split_content(content):
    """Split the content of a file into the structure of the result and the module or program."""
    result_structure, program_bytes = content.split(b"\n", 1)
    return json.loads(result_structure), program_bytes


def _export_module(function, args, kwargs, path):
    """Export a function and write its module; return (structure of the result, module)."""
    leaves, treedef = jax.tree.flatten((args, kwargs))
    result_structure = []

    def flat_function(*tracers):
        tracer_iterator = iter(tracers)
        args, kwargs = treedef.unflatten(
            [next(tracer_iterator) if isinstance(leaf, Tracer) else leaf for leaf in leaves]
        )
        result = function(*args, **kwargs)
        result_structure[:] = [_describe_structure(jax.tree.map(lambda _: NUMBER, result))]
        if jax.tree.structure(_build_from_description(*result_structure)) != jax.tree.structure(result):
            raise NotPersistentError(result)
        return jax.tree.leaves(result)

    flat_function.__name__ = function.__name__
    avals = (jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type) for aval in _tracer_leaves(leaves))
    module = export.export(jax.jit(flat_function))(*avals)
    if any(aval.weak_type for aval in module.out_avals):
        raise NotPersistentError("weakly typed results are not stored")
    module = bytes(module.serialize())
    trusted_cache_file.write(path, _join_content(result_structure[0], module))
    return result_structure[0], module


def _describe_structure(value):
    """Describe a value by dictionaries, lists and texts.

    Tracers are described by their types, functions and classes by their qualified names, and other data by their
    values.
    """
    if value is NUMBER:
        return NUMBER
    if isinstance(value, Tracer | ShapedArray):
        return {"number": [str(value.dtype), list(value.shape), bool(value.weak_type)]}
    if value is None or type(value) in (bool, int, float, str):
        return {"is": value}
    if type(value) in (tuple, list):
        return {type(value).__name__: [_describe_structure(item) for item in value]}
    if type(value) is dict:
        return {"dict": [_describe_structure(item) for item in value.items()]}
    if isinstance(value, partial):
        return {"partial": [_describe_structure(item) for item in (value.func, value.args, value.keywords)]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        field_values = [getattr(value, field.name) for field in dataclasses.fields(value)]
        return {"class": _qualified_name(type(value)), "parts": [_describe_structure(item) for item in field_values]}
    if isinstance(value, tuple):
        return {"class": _qualified_name(type(value)), "parts": [_describe_structure(item) for item in value]}
    return {"function": _qualified_name(value)}


def _build_from_description(description):
    """Build the value that a description of `_describe_structure` defines, with 0 for each `NUMBER`."""
    if description == NUMBER:
        return 0
    if "class" in description:
        return _object_by_name(description["class"])(*(_build_from_description(part) for part in description["parts"]))
    ((container_kind, part_descriptions),) = description.items()
    return (
        part_descriptions
        if container_kind == "is"
        else {"tuple": tuple, "list": list, "dict": dict}[container_kind](
            _build_from_description(part) for part in part_descriptions
        )
    )


def _qualified_name(value):
    """Return module:name of a function or class of `_own_packages`. Raises NotPersistentError for any other value."""
    name = f"{getattr(value, '__module__', '')}:{getattr(value, '__qualname__', '')}"
    resolved_object = _object_by_name(name)
    if value not in (resolved_object, getattr(resolved_object, "__wrapped__", None)):
        raise NotPersistentError(name)
    return name


def _object_by_name(qualified_name):
    """Return the function or class of `_own_packages` that a qualified name, module:name, denotes."""
    module_name, object_path = qualified_name.split(":")
    if module_name.split(".")[0] not in _own_packages:
        raise NotPersistentError(qualified_name)
    return reduce(getattr, object_path.split("."), sys.modules[module_name])
