"""Properties of the continuation package, which knows no oscillators: its kinds are problems, functions and types."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

import continuation as co
from continuation.hostcall.module_store import read
from continuation.hostcall.program_writer import build_program, load_program
from tests import cached_functions
from tests.cached_functions import DIGEST, compiled, evaluated, flipped, own_files, require_right, separate_cache
from tests.tiers import generator, of_numbers

from .continued import PROBLEMS
from .programs import PROGRAMS, TYPES_OF_NUMBERS, functions_of


@dataclass(frozen=True)
class CacheFile:
    """A kind of cached file: the end of its name, and a function that reads it or writes it anew."""

    name: str
    suffix: str
    values: Callable


FILES = {kind.name: kind for kind in (CacheFile("program", ".code", evaluated), CacheFile("module", "", compiled))}
OWN_KINDS = PROBLEMS | TYPES_OF_NUMBERS | PROGRAMS | FILES


def specials(branch):
    return [special for special in branch.special if special.kind != "EP"]


def assert_zero(residuals, tolerance):
    for residual in residuals:
        assert abs(residual).max() < tolerance


def assert_specials(case, branch, expected, tolerance=1e-10):
    """Check the kinds and places of the special points of a branch, in its order or in reverse."""
    found = specials(branch)
    expected = [(kind, np.append(case.unknowns(z[: len(case.w)]), z[len(case.w) :])) for kind, z in expected]
    reverse = len(found) > 1 and len(found) == len(expected)
    if reverse and abs(found[0].z - expected[0][1]).max() > abs(found[-1].z - expected[0][1]).max():
        expected.reverse()
    assert [special.kind for special in found] == [kind for kind, _ in expected]
    for special, (_, z) in zip(found, expected, strict=True):
        free = slice(None) if case.args or case.system.segments is None else slice(-2, None)  # of orbits, not the phase
        np.testing.assert_allclose(special.z[free], z[free], rtol=0, atol=tolerance)


@cache
def drawn(kind, number):
    """Return a case and its branch."""
    case = kind.draw(number)
    return case, case.trace()


@of_numbers
def test_branch(kind, number):
    """Points, special points, ends, eigenvalues and stability are those of the reference."""
    case, branch = drawn(kind, number)
    w, p = case.coordinates(branch)
    assert_zero(case.solution(w, p), 1e-9)
    assert_specials(case, branch, case.specials)
    assert sorted(case.bounds.index(value) for value in branch.p["m"][[0, -1]]) == case.ends
    assert all("reached its bound" in reason for reason in branch.reasons)
    for special in specials(branch):
        points = np.column_stack([branch.u, branch.p["m"]])[[special.place - 1, special.place + 1]]
        secant = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
        assert abs(np.linalg.norm(special.tangent) - 1.0) < 1e-12 and abs(special.tangent @ secant) > 0.97
    expected = np.array(case.eigenvalues(w, p))
    for point, values in enumerate(branch.eigenvalues):
        polynomial = np.poly(expected[:, point])
        assert abs(np.poly(values) - polynomial).max() < 1e-7 * abs(polynomial).max()
    growth = expected.real.max(0) if case.system.kind == "equilibria" else abs(expected).max(0) - 1.0
    decided = abs(growth) > 1e-6
    assert np.array_equal(branch.stable[decided], growth[decided] < 0.0)
    assert decided.mean() > 0.5


@of_numbers
def test_steps(kind, number):
    """From an end back, with other steps, a branch has the same special points and ends."""
    case, branch = drawn(kind, number)
    rng = generator(kind, number)
    first, largest = rng.choice([0.01, 0.05, 0.2]), rng.choice([0.03, 0.1, 0.3])
    end = rng.choice([0, -1])
    again = case.trace(u=branch.u[end], at=case.at | {"m": branch.p["m"][end]}, first_step=first, largest_step=largest)
    assert_zero(case.solution(*case.coordinates(again)), 1e-9)
    assert_specials(case, again, case.specials)
    assert sorted(again.p["m"][[0, -1]]) == sorted(branch.p["m"][[0, -1]])
    steps = np.linalg.norm(np.diff(np.column_stack([again.u, again.p["m"]]), axis=0), axis=1)
    assert steps.max() < 1.1 * largest


@of_numbers
def test_switch(kind, number):
    """The branches that leave a special point, their ends and their special points are those of the reference."""
    case, branch = drawn(kind, number)
    for special in specials(branch):
        if special.kind not in case.emanating:
            continue
        solution, expected = case.emanating[special.kind]
        if special.kind == "BP":  # the branches meet again in the other one
            expected = expected + [("BP", other.p["m"]) for other in specials(branch) if other is not special]
        emanating, found = co.switch(special), []
        for one in emanating:
            assert_zero(solution(*case.coordinates(one)), 1e-9)
            assert abs(one.p["m"][0] - special.p["m"]) < 1e-3 and one.p["m"][-1] in case.bounds
            found += [(other.kind, other.p["m"]) for other in specials(one)]
        assert len({one.u[-1].tobytes() for one in emanating}) == (2 if special.kind == "BP" else 1)
        assert [kind for kind, _ in sorted(found)] == [kind for kind, _ in sorted(expected)]
        np.testing.assert_allclose([m for _, m in sorted(found)], [m for _, m in sorted(expected)], rtol=0, atol=1e-9)


@of_numbers
def test_curve(kind, number):
    """Curves of special points solve their equations and pass the points of codimension two; slopes are theirs."""
    case, branch = drawn(kind, number)
    for special in specials(branch):
        (m, n), solution, expected = case.curves[special.kind]
        curve = co.curve(special, ("m", "n"), {"m": m, "n": n})
        assert_zero(solution(*case.coordinates(curve)), 1e-9)
        assert_specials(case, curve, expected)
        assert curve.p["n"][0] != curve.p["n"][-1] or curve.p["m"][0] != curve.p["m"][-1]
        if special.kind in case.slope:
            w, _ = case.coordinates(special)
            assert abs(co.sensitivity(special, "n") - case.slope[special.kind](w)) < 1e-9


def assert_alike(computed, expected, rtol, atol, message=""):
    """Check that results have the same structure, types and, to rounding, values."""
    assert jax.tree.structure(computed) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(computed), jax.tree.leaves(expected), strict=True):
        one, other = np.asarray(one), np.asarray(other)
        assert (one.shape, one.dtype) == (other.shape, other.dtype), message
        if other.dtype.kind in "fc":
            eps = np.finfo(other.dtype).eps
            np.testing.assert_allclose(one, other, rtol * eps, atol * eps, equal_nan=True, err_msg=message)
        else:
            np.testing.assert_array_equal(one, other, message)


@pytest.mark.filterwarnings("ignore")
@of_numbers
def test_primitives(kind, number):
    """Every primitive gives what the compiler gives, for numbers written one by one (12) and for arrays (36)."""
    rng, evaluated = generator(kind, number), 0
    cases = functions_of([kind.draw(rng, 36 if number % 2 else 12) for _ in range(2)])
    given = {name: arrays for name, (_, arrays) in cases.items()}
    expected = jax.jit(lambda given: {name: cases[name][0](*arrays) for name, arrays in given.items()})(given)
    for name, (function, arrays) in cases.items():
        computed = cached_functions.in_numpy(function, *arrays)
        if computed is not None:  # else no rule: it is compiled
            evaluated += 1
            assert_alike(computed, expected[name], 64, 16, name)
    assert evaluated > 30


@of_numbers
def test_program(kind, number):
    """A random function gives in NumPy what it gives compiled, and the same bits from the stored text."""
    function, arguments = kind.draw(generator(kind, number))
    computed = cached_functions.in_numpy(function, *arguments)
    assert computed is not None
    assert_alike(computed, jax.jit(function)(*arguments), 1e5, 1e5)
    program = build_program(jax.jit(function).trace(*arguments).jaxpr)
    again = load_program(program.byte_code)
    (one, cost), (other, same_cost) = program.run(*arguments), again.run(*arguments)
    assert (again.size, cost) == (program.size, same_cost)
    assert_alike(one, other, 0, 0)


@of_numbers
def test_damage(kind, number):
    """A cached file with a flipped bit, cut, extended or of another function is refused, and written anew."""
    rng = generator(kind, number)
    with tempfile.TemporaryDirectory() as place, separate_cache(Path(place) / "cache") as folder:
        require_right(kind.values())
        path = own_files(folder)[kind.suffix]
        whole = path.read_bytes()
        assert read(path) == whole[DIGEST:]
        bits = {0, 8 * DIGEST, 8 * len(whole) - 1, *rng.integers(0, 8 * len(whole), 50).tolist()}
        kind.values(cached_functions.other_waves)
        (other,) = [one for one in path.parent.iterdir() if one.suffix == kind.suffix and one != path]
        version = path.parent.with_name("0" * 32) / path.name
        version.parent.mkdir()
        version.write_bytes(whole)
        assert read(other) is not None and read(version) is None
        damaged = [flipped(whole, bit) for bit in bits]
        damaged += [b"", whole[: rng.integers(len(whole))], whole[:-1], whole + b"\n", other.read_bytes()]
        for content in damaged:
            path.write_bytes(content)
            assert read(path) is None
        path.write_bytes(damaged[rng.integers(len(damaged))])
        require_right(kind.values())
        assert read(path) is not None
