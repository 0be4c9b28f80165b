"""Numbers of a scene, and what they leave open between nodes: least squares under equations, by Gauss and Newton.

Unknown are all nodes of a record and the free numbers together (multiple shooting; Bock 1981): the sum of squares of
residuals is least under c = 0, what is left open between one node and the next. A step solves the Karush-Kuhn-Tucker
system ((H, C^T), (C, 0)), H the squares' normal matrix, C the derivative of c. The part of its inverse that belongs to
the numbers is their covariance.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..scene.scene import Scene, changed

ROUNDS = 200  # of Newton's steps
SHORT = 1e-6  # of the errors: a step as short is the last
CLOSED = 1e-3  # of that: what may be left open between nodes
FAR = 4.0  # scales that a number may change by in a step
HALVINGS = 8
RARE = 1e-5  # a chi2 that noise makes larger so seldom is too large
WEAKEST = 1e-12  # of H's first entries: what makes it regular in unknowns that nothing is known of


class Free(NamedTuple):
    """The free numbers: their names, the drive's phase at time 0 last where it is free; scales; where they began; in
    scales, how far from there they may go, and how much is known of them beforehand, a matrix."""

    names: tuple[str, ...]
    scales: Float[np.ndarray, " free"]
    begun: Float[np.ndarray, " free"]
    low: Float[np.ndarray, " free"]
    high: Float[np.ndarray, " free"]
    known: Float[np.ndarray, "free free"]

    def apart(self, numbers: Float[np.ndarray, "free ..."], phase: float) -> tuple[tuple[str, ...], Any]:
        """(the names of the scene's numbers among them, the drive's phase at time 0, which may be one of the
        numbers)."""
        return (self.names[:-1], numbers[-1]) if self.names[-1:] == ("phase",) else (self.names, phase)

    def at(self, scene: Scene, phase: float, numbers: Float[np.ndarray, " free"]) -> tuple[Scene, float]:
        """(the scene with these numbers, the phase)."""
        names, phase = self.apart(numbers, phase)
        return changed(scene, dict(zip(names, numbers[: len(names)], strict=True))), float(phase)

    def from_phase(self, numbers: Float[np.ndarray, " free"]) -> "Free":
        """The same begun at the phase of other numbers, where it is free."""
        if self.names[-1] != "phase":
            return self
        return self._replace(begun=np.append(self.begun[:-1], numbers[-1]))

    def room(self, numbers: Float[np.ndarray, " free"]) -> Float[np.ndarray, "2 free"]:
        """(low, high) of the further change of numbers, in scales."""
        return np.array([self.low, self.high]) - (numbers - self.begun) / self.scales


class Felt(NamedTuple):
    """Of nodes and numbers: what is left open and its derivative by the nodes' unknowns, then by the numbers in their
    scales; the residuals in errors, and their derivative."""

    open: Float[np.ndarray, " equations"]
    open_by: "scipy.sparse.csr_array"
    residuals: Float[np.ndarray, " seen"]
    residuals_by: "scipy.sparse.csr_array"


class Problem(NamedTuple):
    """felt: (nodes, numbers) -> `Felt`; moved: (nodes, change of their unknowns) -> nodes; share: (nodes, numbers,
    change of the unknowns, of the numbers) -> how much of it may be made at once, 1 at most."""

    felt: Callable[[Any, Float[np.ndarray, " free"]], Felt]
    moved: Callable[[Any, Float[np.ndarray, " inner"]], Any]
    share: Callable[[Any, Float[np.ndarray, " free"], Float[np.ndarray, " inner"], Float[np.ndarray, " free"]], float]


class Solved(NamedTuple):
    """nodes, numbers; residuals in errors; chi2: their squares' sum; moved: the same of what was known beforehand;
    open: what is left open at most; parts: the factors of the last system, None where it is singular; inner: how many
    unknowns the nodes have; met: whether the last step was a short one."""

    nodes: Any
    numbers: Float[np.ndarray, " free"]
    residuals: Float[np.ndarray, " seen"]
    chi2: float
    moved: float
    open: float
    parts: "scipy.sparse.linalg.SuperLU | None"
    inner: int
    met: bool

    @property
    def covariance(self) -> Float[np.ndarray, "free free"]:
        """Of the numbers, in scales."""
        return self.spread([])

    def spread(self, places: Sequence[int]) -> Float[np.ndarray, "some some"]:
        """The covariance of some of the nodes' unknowns, and then the numbers in scales; nan where there is none."""
        chosen = np.array([*places, *range(self.inner, self.inner + len(self.numbers))])
        if self.parts is None:
            return np.full((len(chosen),) * 2, np.nan)
        columns = np.zeros((self.parts.shape[0], len(chosen)))
        columns[chosen, np.arange(len(chosen))] = 1.0
        return self.parts.solve(columns)[chosen]


class _Point(NamedTuple):
    nodes: Any
    numbers: Float[np.ndarray, " free"]
    felt: Felt


def solved(problem: Problem, nodes, free: Free, numbers, rounds=ROUNDS, short=SHORT) -> Solved:
    """The `Solved` least squares from nodes and numbers near it; short: of errors and scales, a step as short is the
    last."""
    now = _Point(nodes, numbers, problem.felt(nodes, numbers))
    price, met = 0.0, False
    for _ in range(rounds):
        way = _step(now, free)
        if way is None:
            break
        step, multipliers, parts = way
        price = max(price, 1.5 * np.max(abs(multipliers), initial=0.0))
        last = _longest_move(now, step) <= short
        new = _moved(problem, now, free, step, price, parts, last)
        if not np.isfinite(_merit(new, free, price)):
            break
        now = new
        met = bool(last and _left_open(now) <= CLOSED * short)
        if met:
            break
    return _told(now, free, met)


def largest_chi2(dof: int) -> float:
    """What noise makes larger too seldom."""
    return float(scipy.special.chdtri(max(1, dof), RARE))


def _left_open(now):
    return float(abs(now.felt.open).max(initial=0.0))


def _away(now, free):
    return (now.numbers - free.begun) / free.scales


def _merit(now, free, price):
    away, residuals = _away(now, free), now.felt.residuals
    return 0.5 * (residuals @ residuals + away @ free.known @ away) + price * abs(now.felt.open).sum()


def _system(now, free):
    """(the matrix of Karush, Kuhn and Tucker, the gradient)."""
    felt = now.felt
    inner = felt.open_by.shape[1] - len(now.numbers)
    normal = felt.residuals_by.T @ felt.residuals_by
    slope = felt.residuals_by.T @ felt.residuals
    slope[inner:] += free.known @ _away(now, free)
    least = WEAKEST * np.max(normal.diagonal()[:inner], initial=1.0)
    normal = normal + scipy.sparse.block_diag([least * scipy.sparse.eye_array(inner), free.known])
    return scipy.sparse.block_array([[normal, felt.open_by.T], [felt.open_by, None]], format="csc"), slope


def _factors(matrix):
    """The factors of a matrix, None where it has none."""
    if not np.isfinite(matrix.data).all():
        return None
    try:
        return scipy.sparse.linalg.splu(matrix)
    except RuntimeError:  # it is singular
        return None


def _step(now, free):
    """(step, multipliers, the matrix's factors), None where there is none. A number that would pass the end of where it
    may be goes there."""
    matrix, slope = _system(now, free)
    size, inner = len(slope), len(slope) - len(now.numbers)
    right = -np.concatenate([slope, now.felt.open])
    low, high = free.room(now.numbers)
    held = np.zeros(len(low), bool)
    while (parts := _factors(matrix)) is not None:
        found = parts.solve(right)
        if not np.isfinite(found).all():
            break
        step = found[inner:size]
        past = ((step < low) | (step > high)) & ~held
        if not past.any():
            return found[:size], found[size:], parts
        rows = np.isin(np.arange(len(right)), inner + np.flatnonzero(past)).astype(float)
        matrix = (scipy.sparse.diags_array(1.0 - rows) @ matrix + scipy.sparse.diags_array(rows)).tocsc()
        right[inner + np.flatnonzero(past)] = np.where(step < low, low, high)[past]
        held |= past
    return None


def _moved(problem, now, free, step, price, parts, last):
    """The `_Point` after as much of a step as makes it better, of the last step after all of it. Where the whole step
    does not, what is then left open is taken away first (Maratos's effect)."""

    def after(change):
        by_node, by_number = _parts(now, change)
        nodes, numbers = problem.moved(now.nodes, by_node), now.numbers + by_number * free.scales
        return _Point(nodes, numbers, problem.felt(nodes, numbers))

    def longest(change):
        by_node, by_number = _parts(now, change)
        share = problem.share(now.nodes, now.numbers, by_node, by_number * free.scales)
        return min(share, FAR / max(np.max(abs(by_number), initial=0.0), FAR))

    whole = longest(step)
    share, before = whole, _merit(now, free, price)
    for _ in range(HALVINGS):
        new = after(share * step)
        if last or _merit(new, free, price) <= before:
            break
        if share == whole == 1.0:
            closing = np.concatenate([0.0 * step, -new.felt.open])
            further = step + parts.solve(closing)[: len(step)]
            new = after(longest(further) * further)
            if _merit(new, free, price) <= before:
                break
        share *= 0.5
    return new


def _parts(now, step):
    """(of the nodes' unknowns, of the numbers in scales)."""
    inner = len(step) - len(now.numbers)
    return step[:inner], step[inner:]


def _longest_move(now, step):
    """The largest change of what was measured, in errors, and of the numbers, in scales."""
    return max(abs(now.felt.residuals_by @ step).max(initial=0.0), abs(_parts(now, step)[1]).max(initial=0.0))


def _told(now, free, met):
    matrix, _ = _system(now, free)
    residuals, away = now.felt.residuals, _away(now, free)
    chi2, moved = float(residuals @ residuals), float(away @ free.known @ away)
    inner = now.felt.open_by.shape[1] - len(now.numbers)
    return Solved(now.nodes, now.numbers, residuals, chi2, moved, _left_open(now), _factors(matrix), inner, met)
