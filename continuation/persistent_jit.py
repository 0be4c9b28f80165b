"""Traced functions kept between processes, in a folder within jax's own compile cache, where that is set.

jax's cache spares a process compiling, but each traces and lowers anew what it calls, which is most of a cached start.
Here the lowered module is kept too (jax.export), and called in place of the function's body; and of a function that is
evaluated without compiling its program (`python_program`). Both are executed, so `cache_file` reads them only from a
folder that no one but the user can write to, and only if their digest is right. JAX trusts its own cache beside them.
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

from . import cache_file, in_numpy, python_program
from .packed_call import PackedCall

FOLDER = "modules"  # within jax's cache
GENERATIONS = 3  # of sources, whose modules are kept
PROGRAMS = ".code"  # how the names of programs end, those of modules have no ending
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
        kept = cache_file.read(place)
        form, content = _made(function, args, named, place) if kept is None else _parts(kept)
        module, tree = export.deserialize(bytearray(content)), jax.tree.structure(_built(form))
    except Exception:  # a full disk, another's file, what jax cannot export: the function itself does without
        return None
    return lambda *numbers: tree.unflatten(module.call(*numbers))


def _program_place(function, static, args):
    """The file of a function's program for arguments like these; None where nothing is to be kept."""
    kinds = (each if k in static else jax.tree.map(shaped_abstractify, each) for k, each in enumerate(args))
    place = _place(function, tuple(kinds), {})
    return place and place.with_suffix(PROGRAMS)


def _read_way(function, static, args):
    """The `Way` of a function of the host that is kept, None where there is none."""
    try:
        place = _program_place(function, static, args)
        kept = None if place is None else cache_file.read(place)
        if kept is None:
            return None
        form, code = _parts(kept)
        return in_numpy.Way(python_program.of_code(code), jax.tree.structure(_built(form)))
    except Exception:  # as where a module is read
        return None


def _keep_way(function, static, args, way):
    with suppress(Exception):
        place = _program_place(function, static, args)
        form = _described(jax.tree.unflatten(way.form, [NUMBER] * way.form.num_leaves))
        if place and way.program.text and jax.tree.structure(_built(form)) == way.form:
            cache_file.write(place, _joined(form, python_program.code_of(way.program.text)))


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


def reason_without_cache() -> str | None:
    """Explain why traced functions are not kept in the cache folder in this process; None if they are."""
    return _hindrance() or cache_file.reason_for_distrust(*_folders())


def _hindrance():
    """Why nothing can be kept, whatever folder it is; None if it can."""
    place = cache_folder()
    if not place:
        return "no cache folder is set (JAX_COMPILATION_CACHE_DIR)"
    if "://" in place:
        return "it is not a folder of the file system"
    if jax.default_backend() != "cpu":
        return f"functions are compiled for {jax.default_backend()}, not for a processor"
    return "there are several devices" if jax.device_count() > 1 else None


def _folders():
    """jax's cache folder, that of the modules in it, and that of the modules of these sources in that."""
    top = Path(cache_folder())
    return top, top / FOLDER, top / FOLDER / _stamp(tuple(sorted(_ours)))


def _folder():
    """Where the modules of these sources are, made where it is missing; None where nothing is to be kept."""
    if _hindrance():
        return None
    top, above, folder = folders = _folders()
    if _is_distrusted(top, top):
        return None
    is_new = not folder.is_dir()
    for one in folders if is_new else ():
        one.mkdir(mode=0o700, parents=True, exist_ok=True)
    if _is_distrusted(top, *folders):
        return None
    if is_new:
        others = [one for one in above.iterdir() if one != folder]
        for one in sorted(others, key=lambda one: -one.stat().st_mtime)[GENERATIONS - 1 :]:
            shutil.rmtree(one, ignore_errors=True)
    return folder


def _is_distrusted(top, *folders):
    """Return True, with a warning, if the folders of a cache must not be used."""
    reason = cache_file.reason_for_distrust(*folders)
    if reason is not None:
        cache_file.warn_once(top, reason)
    return reason is not None


@lru_cache
def _stamp(packages):
    """A name for all that a module depends on besides the function and its arguments: sources and versions."""
    versions = (sys.version_info[:2], jax.__version__, jaxlib.__version__, np.__version__)
    whole = hashlib.sha256(repr((*versions, sys.implementation.name, importlib.util.MAGIC_NUMBER)).encode())
    for package in packages:
        origin = Path(sys.modules[package].__file__)
        for path in sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]:
            content = path.read_bytes()
            whole.update(f"\n{package} {path.relative_to(origin.parent)} {len(content)}\n".encode() + content)
    return whole.hexdigest()[:32]


def _joined(form, content):
    """The form of a result and what gives it, as the content of a file."""
    return json.dumps(form).encode() + b"\n" + content


def _parts(content):
    """(form of the result, what gives it) of a file's content."""
    form, rest = content.split(b"\n", 1)
    return json.loads(form), rest


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
    cache_file.write(place, _joined(form[0], module))
    return form[0], module


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
