"""Figure 10: the largest x against the frequency between compliant walls, and the numbers that the paper leaves out."""

from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple

import msgspec
import numpy as np

from .. import plot
from ..branches.branch import Branch, Special
from ..branches.follow import follow
from ..branches.peaks import peak, peaks
from ..loci.held_point import hold, slopes
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..plot.style import COLOURS
from ..scene.state import State
from . import fitting
from .claim import number, own, statement
from .closed import forced
from .lasting import stable_at
from .located import ROUNDING
from .panels import Drawn, legend, panels, png, sheet, styled, trim

STIFF = (10, 50)
FOLDS, GRAZING = ("1.48", "1.74"), "1.18"  # as printed
BOTH = ("left.damping", "right.damping")  # gamma2
NAMES = ("amplitude", "damping", BOTH)
LOW, HIGH = (0.05, 0.0, 0.0), (2.0, 0.5, 1.0)  # of A, gamma, gamma2
STARTS = tuple(product((0.3, 0.6), (0.05, 0.2), (0.05, 0.4)))
LOOKS = 12  # values of gamma on either side of the fitted one at which an SN's slope is looked at
NEAR = 0.95  # of the gamma beyond which P100 grazes nowhere: the SN ends there too
HALF = 0.005  # of a unit of the last digit printed
SAME = 1e-8  # between solutions
ASIDE = 0.05  # of a jump's frequency: where but one motion lasts
STIFFER, BETWEEN = (10.0, 50.0, 250.0), (1.2, 1.4)  # stiffnesses, and frequencies on the top of all of their curves

SHORT = r"$\max|X|\,/\,d$"

CAPTION = (
    "The largest x on the orbits against the drive's frequency, A = {0:g}, gamma2 = {1:g}, gamma = {2:.6f} fitted to "
    "both saddle-nodes: P100 and P111, stable (solid) and unstable (dashed), for two stiffnesses of the walls. "
    "P111 has another saddle-node within 1e-4 of the upper grazing, below its marker."
)


class FrequencyResponse(NamedTuple):
    """Branches along the frequency; fold: the SN at which P111 ends above; grazing: the GR of P100 there; None where
    there are none."""

    branches: tuple[Branch, ...]
    fold: Special | None
    grazing: Special | None


def drawn(file, progress):
    """Figure 10 and its claims."""
    scenes, asked = [each.scene.make() for each in panels(file)], file.branch
    first = [response(scene, asked) for scene in scenes]
    printed = [float(one) for one in FOLDS]
    ones = [hold(one.fold, ("damping",)) for one in first]
    both = fitting.fitted(ones, printed, [float(scenes[0].damping)], LOW[1], HIGH[1])
    gamma = float(both.values[0])
    found = [response(scene.replace(damping=gamma), asked) for scene in scenes]
    claims = [*_numbers(found, both), *_alone(ones, printed), _apart(scenes[0]), *_three(first, printed)]
    claims += [*_jumps(found), _flat(scenes[0].replace(damping=gamma), asked)]
    caption = CAPTION.format(float(scenes[0].amplitude), float(scenes[0].left.damping), gamma)
    with styled():
        return Drawn(_picture(scenes, found), caption, tuple(claims))


def response(scene, asked):
    """The `FrequencyResponse` of a scene as a scene file's [branch] asks, each branch up to its grazings.

    P100 is followed from both ends of the range, P111 from the scene's own frequency."""
    low, high = asked.bounds
    branches = [_still(scene, w, asked) for w in (low, high)]
    branches.append(_hitting(scene, asked))
    branches = tuple(one for one in branches if one is not None)
    hit = [one for one in branches if one.segments[0].label != "P100"]
    folds = [point for one in hit for point in one.points("SN")]
    touches = [point for one in branches if one not in hit for point in one.points("GR")]
    highest = [max(each, key=lambda point: point.value, default=None) for each in (folds, touches)]
    return FrequencyResponse(branches, *highest)


def _still(scene, frequency, asked):
    """The branch of P100 from one frequency on."""
    scene = scene.replace(frequency=frequency)
    start = State(*forced(float(scene.amplitude), frequency, float(scene.damping)))
    orbit = find_orbit(scene, start, periods=1, settle=0)
    return follow(orbit, asked.parameter, asked.bounds, stop="GR", largest_step=asked.largest_step)


def _hitting(scene, asked):
    """The branch of P111, None where the mass settles on none."""
    start = State(asked.start.x, asked.start.v)
    try:
        orbit = find_orbit(scene, start, periods=1, itinerary=("RL",), settle=asked.settle)
    except OrbitError:
        return None
    return follow(orbit, asked.parameter, asked.bounds, stop="GR", largest_step=asked.largest_step)


def _numbers(found, both):
    """The three numbers at the gamma that suits both saddle-nodes best."""
    gamma = float(both.values[0])
    told = f"gamma {gamma:.6f}, the least squares of both SN"
    for k2, printed, one, there in zip(STIFF, FOLDS, both.points, found, strict=True):
        value = one.value, abs(one.value - there.fold.value) + ROUNDING
        yield number("10", f"SN at k2 = {k2} ({told})", printed, value)
    value = found[0].grazing.value, abs(found[0].grazing.value - found[1].grazing.value) + ROUNDING
    reason = "It depends on A and gamma alone, and no gamma brings it to 1.18: see below."
    yield number("10", f"GR, of P100 ({told})", GRAZING, value, reason)


def _alone(ones, printed):
    """What each saddle-node alone says of gamma."""
    fits = [fitting.fitted([one], [value], one.kept, LOW[1], HIGH[1]) for one, value in zip(ones, printed, strict=True)]
    (one, other), (first, second) = ([float(fit.values[0]) for fit in fits], [fit.by.item() for fit in fits])
    allowed = HALF / abs(first) + HALF / abs(second)
    text = f"one gamma suits both SN: {one:.6f} from k2 = {STIFF[0]}, {other:.6f} from k2 = {STIFF[1]} (difference)"
    yield own("10", text, (abs(one - other), ROUNDING), high=allowed)
    for k2, point in zip(STIFF, ones, strict=True):
        steepest, (low, high) = _slopes(point)
        text = f"no other gamma from {low:g} to {high:.3f} does: the SN falls all the way, k2 = {k2} (greatest slope)"
        yield own("10", text, (steepest, 1e-9), high=0.0)


def _slopes(point):
    """(the greatest d value / d gamma, (low, high)) over the gammas at which both P100 grazes and the point exists."""
    amplitude = float(point.along.scene.amplitude)
    end = NEAR * np.sqrt(0.5 * (1.0 - np.sqrt(1.0 - amplitude**2)))  # 2 gamma sqrt(1 - gamma^2) = A
    found = [(float(slopes(point)[0]), float(point.kept[0]))]
    for last in (LOW[1], end):
        one = point
        for gamma in np.linspace(float(point.kept[0]), last, LOOKS + 1)[1:]:
            (one,), _ = fitting.there([one], [gamma])
            found.append((float(slopes(one)[0]), float(one.kept[0])))
    gammas = [gamma for _, gamma in found]
    return max(found)[0], (min(gammas), max(gammas))


def _apart(scene):
    """That some gamma gives the GR printed, with A as captioned: it is at most sqrt(1 + A), at gamma = 0."""
    amplitude = float(scene.amplitude)
    text = f"a GR at {GRAZING} is possible at A = {amplitude:g} (the highest that any gamma leads to)"
    reason = f"It would need A of at least {float(GRAZING) ** 2 - 1.0:.4f}, were gamma zero."
    return statement("10", text, (np.sqrt(1.0 + amplitude), ROUNDING), low=float(GRAZING) - HALF, reason=reason)


def _three(found, printed):
    """A, gamma and gamma2 from the three numbers printed."""
    points = [*(hold(one.fold, NAMES) for one in found), hold(found[0].grazing, NAMES)]
    targets = [*printed, float(GRAZING)]
    fits = [fitting.fitted(points, targets, start, LOW, HIGH) for start in STARTS]
    best = min(fits, key=lambda fit: abs(fit.misfits).max())
    spread = abs(np.linalg.inv(best.by)) @ np.full(3, HALF)
    named = zip(("A", "gamma", "gamma2"), best.values, spread, strict=True)
    told = ", ".join(f"{name} = {value:.6f} (digits: ± {more:.2g})" for name, value, more in named)
    text = (
        f"all three numbers are reproduced by {told} (largest misfit; condition of the derivative {best.condition:.3g})"
    )
    yield own("10", text, (float(abs(best.misfits).max()), ROUNDING), high=1e-10)
    good = [fit.values for fit in fits if fit.met and abs(fit.misfits).max() < SAME]
    different = [one for k, one in enumerate(good) if all(abs(one - other).max() > SAME for other in good[:k])]
    text = f"no other three do: {len(good)} of {len(fits)} starts lead to a solution (number of different ones)"
    yield own("10", text, (float(len(different)), 0.0), low=1.0, high=1.0)


def _jumps(found):
    """That two motions last between the grazing of P100 and the saddle-node of P111, and one on either side."""
    for k2, one in zip(STIFF, found, strict=True):
        low, high = one.grazing.value, one.fold.value
        seen = [(w, ["P100", "P111"]) for w in np.linspace(low, high, LOOKS + 2)[1:-1]]
        seen += [(low - ASIDE, ["P111"]), (high + ASIDE, ["P100"])]
        wrong = sum(sorted(stable_at(one.branches, w)) != labels for w, labels in seen)
        text = (
            f"k2 = {k2}: P100 and P111 last from omega {low:.6g}, where a sweep down jumps, to {high:.6g}, where one "
            f"up falls from x = {peak(one.fold.orbit):.4g}; one of them beside (of {len(seen)} frequencies those "
            "where not)"
        )
        yield own("10", text, (float(wrong), 0.0), high=0.0)


def _flat(scene, asked):
    """That the top of the curve is the flatter the stiffer the walls are."""
    asked, rises = msgspec.structs.replace(asked, bounds=BETWEEN), []
    for k2 in STIFFER:
        stiff = scene.replace(**{"left.stiffness": k2, "right.stiffness": k2})
        tops = peaks(_hitting(stiff, asked))
        rises.append(abs(float(tops[-1] - tops[0])))
    told = ", ".join(f"{rise:.4g} at k2 = {k2:g}" for rise, k2 in zip(rises, STIFFER, strict=True))
    low, high = BETWEEN
    text = (
        f"the top gets flat as k2 grows: from omega {low:g} to {high:g} the largest x rises by {told} (largest ratio)"
    )
    ratios = [after / before for before, after in pairwise(rises)]
    return own("10", text, (max(ratios), SAME), high=1.0)


def marked(branch):
    """A branch with its SN and GR alone, for a picture in which nothing else is asked for."""
    return replace(branch, special=tuple(one for one in branch.special if one.kind in ("SN", "GR")))


def _picture(scenes, found):
    figure, places = sheet(2, 1, 2.7)
    for (ax,), scene, one in zip(places, scenes, found, strict=True):
        for each in reversed(one.branches):  # P100 last: its GR hides an SN that is as good as there
            plot.branch(marked(each), "peak", ax, COLOURS[2 if each.segments[0].label == "P100" else 7])
        ax.set_title(f"$k_2$ = {float(scene.left.stiffness):g}", loc="left")
        ax.set_ylim(0.0)
    trim(places, ticks=9)
    for (ax,) in places:
        ax.set_ylabel(SHORT)
    legend(figure, places, columns=3)
    return png(figure)
