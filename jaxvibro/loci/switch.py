"""Switch to the branches and loci that emanate from a special point: `switch`."""

from collections.abc import Callable, Mapping, Sequence
from typing import overload

from continuation.computation_limits import make_limits

from ..branches import switch as of_branches
from ..branches.branch import Branch, Special
from ..branches.follow import Monitors
from ..branches.switch import FIRST_STEP
from ..scene import check
from .locus import Codim2, Locus, build_locus
from .locus_switching import find_locus_seeds, track_locus_seed

DEPARTURE_LOCI = {  # kind of point: kinds of locus on which other loci emanate from it
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
    """Continue the branches or loci that emanate from a special point.

    Parameters
    ----------
    special : Special or Codim2
        Special point of a branch, of kind SB, BP, PD or GR, or point of codimension two of a locus.
    bounds : tuple of float or dict of str to tuple of float, optional
        Lower and upper bound of the parameter of a branch, or of each parameter of a locus by name. By default the
        bounds of the curve on which the point was located.
    first_step : float, optional
        First arclength step, as in `follow` or `locus`.
    largest_step : float, optional
        Largest arclength step.
    tolerance : float, optional
        Tolerance of Newton's method.
    monitors : dict of str to callable, optional
        User-defined test functions, as in `follow`. Only for branches.
    stop : str or sequence of str, optional
        Kinds of special point at which a branch ends. Only for branches.
    max_points : int, optional
        Largest number of points of each curve. By default the number is unlimited.
    max_seconds : float, optional
        Wall-clock time in s for all curves together. By default the time is unlimited.
    progress : callable, optional
        Function that is called with the number of points computed.

    Returns
    -------
    tuple of Branch or tuple of Locus
        The curves that emanate from the point, except the curve on which the point was located. Each curve starts at
        the point. The exception is the GR on which an SN, PD or SB ends: this locus passes through the point. Branches
        emanate from a `Special`, loci from a `Codim2`.

    Raises
    ------
    ArgumentError
        If no curve emanates from a point of this kind, or if another argument is invalid.

    See Also
    --------
    follow : Continue an orbit in one parameter.
    locus : Continue a special point in two parameters.

    Notes
    -----
    Branches emanate from these special points of a branch:

    - SB, BP: the two halves of the crossing branch. The first half begins towards larger times or speeds.
    - PD: the branch of twice the period. Its other half consists of the same orbits, shifted by one period.
    - GR: the branches of the itineraries along which the branch itself does not continue.

    Loci emanate from these points of codimension two:

    - RG: the SN and the PD (for a symmetric orbit the SB) of the orbit with the grazing contact as an impact.
    - GPD: the SN of the period-doubled orbit.
    - DSB: the SN of an asymmetric orbit. The SN of its mirror image is the same curve in the parameter plane.
    - SN, PD and SB on a GR: the locus of that kind of the orbit without the grazing contact. From a PD or SB also
      emanates the GR of the period-doubled orbit or of an asymmetric orbit.
    - GR at which an SN, PD or SB ends: the GR through the point, and the other loci that emanate from that GR.

    Examples
    --------
    >>> special = branch.points("SB")[0]
    >>> halves = jv.switch(special, bounds=(3.0, 6.0), max_points=20)
    >>> [half.segments[0].label for half in halves]
    ['P111', 'P111']
    """
    limits = make_limits(max_points, max_seconds, progress, check.ArgumentError)
    switch_curves = _switch_loci if isinstance(special, Codim2) else _switch_branches
    return switch_curves(special, bounds, first_step, largest_step, tolerance, monitors, stop, limits)


def _switch_branches(special, *arguments):
    """Continue the branches that emanate from a `Special`."""
    return of_branches.switch(special, *arguments)


def _switch_loci(special, bounds, first_step, largest_step, tolerance, monitors, stop, limits):
    """Continue the loci that emanate from a `Codim2`."""
    _require_switchable(special, monitors, stop)
    bounds, step_settings = special.bounds if bounds is None else bounds, (first_step, largest_step, tolerance, limits)
    values_text = ", ".join(f"{name} {value:.12g}" for name, value in special.values.items())
    start_reason = f"it left {special.kind} at {values_text}"
    return tuple(
        build_locus(*track_locus_seed(locus_seed, step_settings), start_reason)
        for locus_seed in find_locus_seeds(special, bounds, *step_settings)
    )


def _require_switchable(special, monitors, stop):
    """Raise ArgumentError if no loci emanate from a point, or if an argument applies to branches only."""
    if special.on not in DEPARTURE_LOCI.get(special.kind, ()):
        kinds = ", ".join(
            f"{kind} of a locus of {' or '.join(locus_kinds)}" for kind, locus_kinds in DEPARTURE_LOCI.items()
        )
        actual_value = f"{special.kind} of a locus of {special.on}"
        raise check.ArgumentError("special", f"must be a point from which other loci emanate: {kinds}", actual_value)
    for argument_name, actual_value in (("monitors", monitors), ("stop", stop)):
        if actual_value:
            raise check.ArgumentError(argument_name, "must be omitted for loci", actual_value)
