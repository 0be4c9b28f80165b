"""`switch`: the curves that leave a special point: of a branch branches, of a locus loci."""

from collections.abc import Callable, Mapping, Sequence
from typing import overload

from continuation.limits import limits_of

from ..branches import switch as of_branches
from ..branches.branch import Branch, Special
from ..branches.follow import Monitors
from ..branches.switch import FIRST_STEP
from ..scene import check
from .locus import Codim2, Locus, build_locus
from .locus_switching import locus_seeds, track_seed

DEPARTURE_LOCI = {  # by kinds of points, on which loci others leave them
    "RG": ("GR",),
    "GPD": ("PD",),
    "DSB": ("SB",),
    "GR": ("SN", "PD", "SB"),
    "SN": ("GR",),
    "PD": ("GR",),
    "SB": ("GR",),
}


@overload
def switch(
    special: Special,
    bounds: tuple[float, float] | None = None,
    first_step: float = FIRST_STEP,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Branch, ...]: ...


@overload
def switch(
    special: Codim2,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    first_step: float = FIRST_STEP,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Locus, ...]: ...


@check.host_only("use strobe or monodromy")
def switch(
    special: Special | Codim2,
    bounds: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
    first_step: float = FIRST_STEP,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Branch, ...] | tuple[Locus, ...]:
    """The curves that leave a special point besides the one it was found on: a tuple, of `Branch` for a point of a
    branch, of `Locus` for one of codimension two, each from the point on, to where it ends.

    special: a `Special` of a branch. At SB and BP the two halves of the branch that crosses there, the first along
    greater times or speeds; at PD the one of twice the period (its other half has the same orbits, a period later); at
    GR those of the itineraries that the branch did not go on with. bounds and the rest as in `follow`; bounds None
    takes the point's.

    Or a `Codim2` of a locus. At RG the SN and the PD, of a symmetric orbit the SB, with the touch as an impact; at GPD
    the SN of the doubled orbit, at DSB that of a lopsided one (its mirror image lies on the same curve); at SN, PD and
    SB on a GR that locus of the orbit without the touch, and at PD and SB the GR of the doubled or of a lopsided orbit;
    at GR, where an SN, PD or SB ends, the GR, which goes through the point, and what else leaves that. bounds, steps
    and tolerance as in `locus`; bounds None takes the locus' own.

    max_points, max_seconds, progress: as in `follow`; max_points holds for each curve, max_seconds for all of them.

    Raises ArgumentError for a point of another kind, and arguments that cannot be.
    """
    limits = limits_of(max_points, max_seconds, progress, check.ArgumentError)
    switch_function = _switch_loci if isinstance(special, Codim2) else _switch_branches
    return switch_function(special, bounds, first_step, largest_step, tolerance, monitors, stop, limits)


def _switch_branches(special, *arguments):
    """Those that leave a `Special`."""
    return of_branches.switch(special, *arguments)


def _switch_loci(special, bounds, first_step, largest_step, tolerance, monitors, stop, limits):
    """Those that leave a `Codim2`."""
    _check_codim2(special, monitors, stop)
    bounds, step_settings = special.bounds if bounds is None else bounds, (first_step, largest_step, tolerance, limits)
    values_text = ", ".join(f"{name} {value:.12g}" for name, value in special.values.items())
    start_reason = f"it left {special.kind} at {values_text}"
    return tuple(
        build_locus(*track_seed(seed, step_settings), start_reason)
        for seed in locus_seeds(special, bounds, *step_settings)
    )


def _check_codim2(special, monitors, stop):
    """Refuse a point that no loci leave, and what only branches know."""
    if special.on not in DEPARTURE_LOCI.get(special.kind, ()):
        kinds = ", ".join(
            f"{kind} of a locus of {' or '.join(locus_kinds)}" for kind, locus_kinds in DEPARTURE_LOCI.items()
        )
        actual_value = f"{special.kind} of a locus of {special.on}"
        raise check.ArgumentError("special", f"must be one that other loci leave: {kinds}", actual_value)
    for key, actual_value in (("monitors", monitors), ("stop", stop)):
        if actual_value:
            raise check.ArgumentError(key, "must be left out: loci have none", actual_value)
