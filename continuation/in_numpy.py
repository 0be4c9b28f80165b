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

from .numpy_indexing import Unknown
from .python_program import Program, program

PATIENCE = 10_000  # times that all lines of a function are run before it is compiled, which costs as much
PLAIN = {bool, int, float, complex}  # types of numbers that jax takes for weak ones


def kind_of(args, static):
    """(the numbers of a function's arguments in a row; what decides how it is traced, a key). static: places of
    arguments that are no numbers."""
    leaves, form = jax.tree.flatten([each for place, each in enumerate(args) if place not in static])
    kinds = [type(leaf) if type(leaf) in PLAIN else (leaf.shape, leaf.dtype) for leaf in leaves]
    return leaves, (form, tuple(kinds), tuple([args[place] for place in static]), jax.config.jax_enable_x64)


@contextmanager
def uncollected():
    """Python's collector of circles waits: tracing makes many objects that stay, and would have it look at all of them
    again and again, an eighth of the time."""
    waits = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if waits:
            gc.enable()


@dataclass
class Way:
    """A function's program, the form of its result, and how many lines of it were run."""

    program: Program
    form: Any
    spent: int = 0


class Tried(NamedTuple):
    """How a function is evaluated for each kind of arguments that it has met. static: places of arguments that are no
    numbers, of which one may say `at_once`; known: {kind: `Way`, None where it is compiled at once}; read, keep: the
    way for arguments like these that an earlier process has kept, None where there is none; keeps one."""

    function: Callable[..., Any]
    static: Sequence[int]
    known: dict[Any, Any]
    read: Callable[[tuple[Any, ...]], Way | None] = lambda args: None
    keep: Callable[[tuple[Any, ...], Way], None] = lambda args, way: None

    def __call__(self, args: tuple[Any, ...]) -> Any:
        """The function's result; None, which it never is, where it is to be compiled."""
        return self.of_kind(args, *kind_of(args, self.static))

    def of_kind(self, args: tuple[Any, ...], leaves: Sequence[Any], kind: Any) -> Any:
        """The same of arguments with these numbers and of this kind (`kind_of`)."""
        if kind not in self.known:
            at_once = any(getattr(args[place], "at_once", False) for place in self.static)
            self.known[kind] = None if at_once else self.read(args) or self.traced(args)
        way = self.known[kind]
        if way is None or way.spent >= PATIENCE * way.program.size:
            return None
        with np.errstate(all="ignore"):
            found, spent = way.program.run(*[np.asarray(leaf)[()] for leaf in leaves])
        way.spent += spent
        return jax.tree.unflatten(way.form, found)

    def traced(self, args: tuple[Any, ...]) -> Way | None:
        """The `Way` for arguments like these; None where an equation has no rule, or, in another version of jax, other
        names of its parameters."""
        try:
            with uncollected():
                traced = jax.jit(self.function, static_argnums=tuple(self.static)).trace(*args)
                way = Way(program(traced.jaxpr), jax.tree.structure(traced.out_info))
        except (Unknown, KeyError):
            return None
        self.keep(args, way)
        return way
