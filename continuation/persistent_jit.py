"""Traced functions kept between processes, in a folder within jax's own compile cache, where that is set.

jax's cache spares a process compiling, but each traces and lowers anew what it calls, which is most of a cached start.
Here the lowered module is kept too (jax.export), and called in place of the function's body; and of a function that is
evaluated without compiling the text of its program (`python_program`). What is kept is trusted like jax's cache, which
lies beside it, and like the program itself: the folder is to be the user's own.
"""

import dataclasses
import hashlib
import json
import os
import shutil
import sys
import tempfile
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

from . import in_numpy, python_program
from .packed_call import PackedCall

FOLDER = "modules"  # within jax's cache
GENERATIONS = 3  # of sources, whose modules are kept
DIGEST = hashlib.sha256().digest_size
NUMBER = "number"
SOON = {"xla_backend_optimization_level": 0}  # for what the host calls a few times: compiled in half the time
HOSTS = {np.ndarray, np.float64, np.float32, np.int32, np.int64, np.bool_, bool, int, float}  # types of no tracer
_ours = {__name__.split(".")[0]}  # packages whose sources decide what a traced function is
_evaluated: list[Callable[[], None]] = []  # one for each function and kind of arguments that NumPy has met: compiles it

Given = ParamSpec("Given")
Found = TypeVar("Found")


class Unknown(Exception):
    """A value that has no name which says the same in every process."""


@overload
def persistent_jit(function: Callable[Given, Found], **options: Any) -> Callable[Given, Found]: ...
@overload
def persistent_jit(**options: Any) -> Callable[[Callable[Given, Found]], Callable[Given, Found]]: ...
def persistent_jit(
    function: Callable[..., Any] | None = None, numpy_first: bool | Callable[..., Any] = False, **options: Any
) -> Callable[..., Any]:
    """`jax.jit` for a function of a module that the host calls, its options the same; its module is kept.

    Under a transformation it is the jitted function, without options of the compiler, which jax takes for a whole
    program alone: what has been exported has no derivatives and no lanes. Nothing is kept where jax has no compile
    cache, of anything but one processor, or for an argument that is known to this process alone, as a user's function.

    numpy_first: whether it is evaluated by Python and NumPy (`in_numpy`) until that has cost what compiling does; a
    function that gives the same is evaluated in its place. It then takes no arguments by name, and its results are
    NumPy's arrays, as it is asked by the host (`packed_call`).
    """
    if function is None:
        return partial(persistent_jit, numpy_first=numpy_first, **options)
    _ours.add(function.__module__.split(".")[0])
    plain = jax.jit(function, **{key: each for key, each in options.items() if key != "compiler_options"})

    @wraps(function)
    def traced(*args, **named):
        module = _module(function, args, named)
        return function(*args, **named) if module is None else module(*_numbers((args, named)))

    call = _from_host(function, numpy_first, plain, traced, options) if numpy_first else _called(plain, traced, options)
    call = wraps(function)(call)
    call.lower = jax.jit(function, **options).lower  # type: ignore[attr-defined]  # a function takes any attribute
    return call


def compile_evaluated() -> Iterator[int]:
    """Compiles what NumPy evaluates in this process, one function for one kind of arguments at each step, what was met
    last first, and tells how many are left. For a process that goes on: a compiled function takes a tenth of the time
    and less. What is called meanwhile, by other threads, is still evaluated."""
    while _evaluated:
        _evaluated.pop()()
        yield len(_evaluated)


def _called(plain, traced, options):
    stored = jax.jit(traced, **options)

    def call(*args, **named):
        return plain(*args, **named) if _numbers((args, named)) else stored(*args, **named)

    return call


def _from_host(function, numpy_first, plain, traced, options):
    static = np.atleast_1d(options.get("static_argnums", ())).astype(int).tolist()
    evaluated = numpy_first if callable(numpy_first) else function
    read, keep = partial(_read_way, evaluated, static), partial(_keep_way, evaluated, static)
    tried = in_numpy.Tried(evaluated, static, {}, read, keep)
    further = {key: each for key, each in options.items() if key != "static_argnums"}
    compiled: dict[Any, PackedCall] = {}  # of each kind of arguments that has come so far

    def packed(args, form, leaves):
        @wraps(function)
        def of_leaves(*leaves):
            rest = iter(form.unflatten(leaves))
            return traced(*[each if place in static else next(rest) for place, each in enumerate(args)])

        return PackedCall(of_leaves, leaves, further)

    def ahead(args, leaves, kind):
        if kind not in compiled:
            own = packed(args, kind[0], leaves)
            with jax.enable_x64(kind[-1]):
                own(leaves)
            compiled[kind] = own

    def call(*args):
        leaves, kind = in_numpy.kind_of(args, static)
        if not HOSTS.issuperset(map(type, leaves)) and _numbers(leaves):
            return plain(*args)
        own = compiled.get(kind)
        if own is None:
            is_new = kind not in tried.known
            found = tried.of_kind(args, leaves, kind)
            if found is not None:
                if is_new:
                    _evaluated.append(partial(ahead, args, leaves, kind))
                return found
            own = compiled[kind] = packed(args, kind[0], leaves)
        return own(leaves)

    return call


def _numbers(tree):
    """What of a tree is known only to a transformation."""
    return [leaf for leaf in jax.tree.leaves(tree) if isinstance(leaf, Tracer)]


def _module(function, args, named):
    """(numbers) -> the function's result, by its module, found or made; None where there can be none."""
    try:
        place = _place(function, args, named)
        if place is None:
            return None
        form, content = _read(place) or _made(function, args, named, place)
        module, tree = export.deserialize(bytearray(content)), jax.tree.structure(_built(form))
    except Exception:  # a full disk, another's file, what jax cannot export: the function itself does without
        return None
    return lambda *numbers: tree.unflatten(module.call(*numbers))


def _text_place(function, static, args):
    """The file of the text of a function's program for arguments like these; None where nothing is to be kept."""
    kinds = (each if k in static else jax.tree.map(shaped_abstractify, each) for k, each in enumerate(args))
    place = _place(function, tuple(kinds), {})
    return place and place.with_suffix(".py")


def _read_way(function, static, args):
    """The `Way` of a function of the host that is kept, None where there is none."""
    try:
        place = _text_place(function, static, args)
        if place is None or not place.is_file():
            return None
        program, form = python_program.read(place)
        return in_numpy.Way(program, jax.tree.structure(_built(form)))
    except Exception:  # as where a module is read
        return None


def _keep_way(function, static, args, way):
    with suppress(Exception):
        place = _text_place(function, static, args)
        form = _described(jax.tree.unflatten(way.form, [NUMBER] * way.form.num_leaves))
        if place and way.program.text and jax.tree.structure(_built(form)) == way.form:
            _write(place, f"{way.program.text}\nform = {form!r}\n".encode())


def _place(function, args, named):
    """The file of a function's module for arguments of a kind, be it there or not; None where nothing is to be kept."""
    folder = _folder()
    if folder is None:
        return None
    told = [_named(function), _described((args, named)), bool(jax.config.jax_enable_x64)]
    told.append(str(jax.config.jax_default_matmul_precision))
    return folder / hashlib.sha256(json.dumps(told).encode()).hexdigest()


def cache_folder():
    """Where jax keeps what it compiles, a text; None or an empty one where it does not."""
    return jax.config.jax_compilation_cache_dir


def _folder():
    """Where the modules of these sources are, made where it is missing; None where nothing is to be kept."""
    place = cache_folder()
    if not place or "://" in place or jax.default_backend() != "cpu" or jax.device_count() > 1:
        return None
    folder = Path(place) / FOLDER / _stamp(tuple(sorted(_ours)))
    if not folder.is_dir():
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        others = sorted((one for one in folder.parent.iterdir() if one != folder), key=lambda one: -one.stat().st_mtime)
        for one in others[GENERATIONS - 1 :]:
            shutil.rmtree(one, ignore_errors=True)
    return folder


@lru_cache
def _stamp(packages):
    """A name for all that a module depends on besides the function and its arguments: sources and versions."""
    whole = hashlib.sha256(repr((sys.version_info[:2], jax.__version__, jaxlib.__version__, np.__version__)).encode())
    for package in packages:
        origin = Path(sys.modules[package].__file__)
        for path in sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]:
            content = path.read_bytes()
            whole.update(f"\n{package} {path.relative_to(origin.parent)} {len(content)}\n".encode() + content)
    return whole.hexdigest()[:32]


def _read(place):
    """(form of the result, serialized module) of a file; None where there is no file, or not a whole one."""
    try:
        content = place.read_bytes()
    except OSError:
        return None
    if hashlib.sha256(content[DIGEST:]).digest() != content[:DIGEST]:
        return None
    form, module = content[DIGEST:].split(b"\n", 1)
    return json.loads(form), module


def _made(function, args, named, place):
    """The same of a function traced now, and written."""
    values, tree = jax.tree.flatten((args, named))
    form = []

    def flat(*numbers):
        rest = iter(numbers)
        args, named = tree.unflatten([next(rest) if isinstance(one, Tracer) else one for one in values])
        result = function(*args, **named)
        form[:] = [_described(jax.tree.map(lambda _: NUMBER, result))]
        if jax.tree.structure(_built(*form)) != jax.tree.structure(result):
            raise Unknown(result)
        return jax.tree.leaves(result)

    flat.__name__ = function.__name__
    kinds = (jax.ShapeDtypeStruct(one.shape, one.dtype, weak_type=one.weak_type) for one in _numbers(values))
    module = export.export(jax.jit(flat))(*kinds)
    if any(one.weak_type for one in module.out_avals):
        raise Unknown("a number of weak type, which is not written")
    module = bytes(module.serialize())
    content = json.dumps(*form).encode() + b"\n" + module
    _write(place, hashlib.sha256(content).digest() + content)
    return form[0], module


def _write(place, content):
    """A whole file or none: written beside its place and renamed into it; none where the disk is full."""
    with suppress(OSError):
        handle, part = tempfile.mkstemp(dir=place.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(part, place)
        except BaseException:
            os.unlink(part)
            raise


def _described(value):
    """A value's form as lists and texts: of numbers under a transformation their kind, of all else what it is."""
    if value is NUMBER:
        return NUMBER
    if isinstance(value, Tracer | ShapedArray):
        return {"number": [str(value.dtype), list(value.shape), bool(value.weak_type)]}
    if value is None or type(value) in (bool, int, float, str):
        return {"is": value}
    if type(value) in (tuple, list):
        return {type(value).__name__: [_described(one) for one in value]}
    if type(value) is dict:
        return {"dict": [_described(one) for one in value.items()]}
    if isinstance(value, partial):
        return {"partial": [_described(one) for one in (value.func, value.args, value.keywords)]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [getattr(value, field.name) for field in dataclasses.fields(value)]
        return {"class": _named(type(value)), "parts": [_described(one) for one in parts]}
    if isinstance(value, tuple):
        return {"class": _named(type(value)), "parts": [_described(one) for one in value]}
    return {"function": _named(value)}


def _built(form):
    """The value of a described form, 0 for each number."""
    if form == NUMBER:
        return 0
    if "class" in form:
        return _known(form["class"])(*(_built(one) for one in form["parts"]))
    ((kind, parts),) = form.items()
    return parts if kind == "is" else {"tuple": tuple, "list": list, "dict": dict}[kind](_built(one) for one in parts)


def _named(value):
    """module:name of a function or class of ours. Raises Unknown for any other value."""
    name = f"{getattr(value, '__module__', '')}:{getattr(value, '__qualname__', '')}"
    found = _known(name)
    if value not in (found, getattr(found, "__wrapped__", None)):
        raise Unknown(name)
    return name


def _known(name):
    """The function or class of ours with a name."""
    module, path = name.split(":")
    if module.split(".")[0] not in _ours:
        raise Unknown(name)
    return reduce(getattr, path.split("."), sys.modules[module])
