"""Figures 4, 6 and 7: diagrams against the amplitude, swept and followed."""

import math
from itertools import combinations

import numpy as np

from .. import plot
from ..attractors.find import find_attractors
from ..branches.explore import explore
from ..studies.compute import study
from ..studies.results_dataset import dataset
from .claim import number, own, statement
from .lasting import largest, onset, shares, stable_at
from .located import ROUNDING, labelled, nearest, twice, value
from .panels import Drawn, legend, png, sheet, styled, trim

STARTS = 100
LOOKS = 25  # amplitudes between two at which stable motions are counted
BESIDE, LONGEST = 0.05, 8  # how far from an amplitude, and up to how many periods, grazings are looked for
CROWD, EDGE = 2.0 / 3.0, 0.05  # of all special points; of their range, at its ends
CAPTION = (
    "x and v at phase 0 of the drive against its amplitude: swept down and up (dots), and all periodic motions; below, "
    "x where most special points are."
)
LATE = "No motion of this branch exists below the value beside: it turns there."


def fourth(file, progress):
    """Figure 4 and its claims."""
    found, pair = _found(file, progress)
    first, born, doubled = pair.first, value(pair, "SN", "P112"), value(pair, "PD", "P112")
    graze = value(pair, "GR", "P100")
    claims = [
        number("4", "SN1, where P111 begins", "0.5", value(pair, "SN", "P111")),
        number("4", "GB1, where P100 grazes", "3.41", graze),
        number("4", "SB, where P111 loses its symmetry", "3.45", value(pair, "SB"), _still(first, 3.45)),
        number("4", "SN2, where P112 and P121 are born", "4.51", born, LATE),
        number("4", "PD of P112 and P121", "4.735", doubled, _still(first, 4.735, "P112")),
        _four(first, born[0], doubled[0]),
        number(
            "4", "asymmetric P111 ends by grazing", "5.215", value(pair, "GR", "P111", near=5.215), _still(first, 5.215)
        ),
        *_chaos("4", found.scene, "5.24", graze[0]),
        _pair_grazes(found.scene, pair, "5.42", 3),
    ]
    return _drawn(found, claims)


def _four(diagram, low, high):
    """That four motions last from where P112 is born to where it doubles its period."""
    seen = [stable_at(diagram.branches, one) for one in np.linspace(low, high, LOOKS + 2)[1:-1]]
    counts = [len(one) for one in seen]
    labels = " or ".join(sorted({", ".join(sorted(one)) for one in seen}))
    middle = 0.5 * (max(counts) + min(counts)), 0.5 * (max(counts) - min(counts))
    text = f"four motions last between SN2 and PD (stable ones at {LOOKS} amplitudes between: {labels})"
    return statement("4", text, middle, low=4.0, high=4.0)


def _pair_grazes(scene, pair, printed, periods):
    """The grazing of orbits of so many periods nearest to a printed amplitude, and what else grazes there: of all
    orbits of up to `LONGEST` periods the nearest."""
    near = float(printed)
    here = explore(scene, "amplitude", (near - BESIDE, near + BESIDE), LONGEST)
    claimed = nearest(pair.first, "GR", near, periods=periods)
    points = [one for one in (nearest(here, "GR", near), claimed) if one is not None]
    touch = min(points, key=lambda one: abs(one.value - near))
    twins = [one.label for one in here.points("GR") if abs(one.value - touch.value) <= ROUNDING * abs(touch.value)]
    births = [one.value for one in here.points("SN") if one.label == touch.label and one.value < touch.value]
    born = f", born in an SN at {max(births):.9g}," if births else ""
    reason = (
        f"Of all orbits of up to {LONGEST} periods the nearest to graze is {' and '.join(twins or [touch.label])}, of "
        f"period {len(touch.itinerary)}{born} at {touch.value:.9g}."
    )
    if claimed is not None:
        reason += f" Of period {periods} it is {claimed.label}, at {claimed.value:.9g}."
    text = f"GB2, where a period-{periods} pair grazes"
    return number("4", text, printed, value(pair, "GR", near=near, periods=periods), reason)


def _still(diagram, amplitude, label="P111"):
    """That a motion is stable at an amplitude, by its multipliers there."""
    found = []
    for branch in diagram.branches:
        for part in (one for one in branch.segments if one.label == label):
            values, sizes = (each[part.first : part.last + 1] for each in (branch.values, branch.multipliers))
            (places,) = np.nonzero((values[:-1] - amplitude) * (values[1:] - amplitude) <= 0)
            found += [abs(sizes[k : k + 2]).max() for k in places]
    return (
        f"At {amplitude:g} {label} is still stable: its multipliers there are at most {min(found, default=np.nan):.3f}."
    )


EVENTS = {
    "SN of P111": ("SN", "P111"),
    "GR of P100": ("GR", "P100"),
    "SB": ("SB", None),
    "SN of P112": ("SN", "P112"),
    "PD of P112": ("PD", "P112"),
    "GR of P111": ("GR", "P111"),
}


def sixth(file, slower, progress):
    """Figure 6 and its claims, which compare it with figure 4, whose scene file is the other one."""
    found, pair = _found(file, progress)
    other = twice(slower.scene.make(), slower.explore)
    here, there = ({name: value(one, *event) for name, event in EVENTS.items()} for one in (pair, other))
    swapped = [
        f"{one} and {two}"
        for one, two in combinations(EVENTS, 2)
        if (here[one][0] < here[two][0]) != (there[one][0] < there[two][0])
    ]
    order = " < ".join(sorted(here, key=lambda name: here[name][0]))
    reason = f"Here {order}: exchanged are {'; '.join(swapped)}."
    text = "the same order of events as in figure 4 (number of pairs exchanged)"
    least = min(here, key=lambda name: here[name][0] - there[name][0])
    more = here[least][0] - there[least][0], here[least][1] + there[least][1]
    claims = [
        statement("6", text, (float(len(swapped)), 0.0), high=0.0, reason=reason),
        statement("6", f"each at a larger A (the least difference, of {least})", more, low=0.0),
    ]
    return _drawn(found, claims)


def seventh(file, progress):
    """Figure 7 and its claims."""
    found, pair = _found(file, progress)
    first, graze = pair.first, value(pair, "GR", "P100")
    other = nearest(first, "SN", 5.51)
    reason = f"The SN nearest to 5.51 is that of {other.label}, at {other.value:.9g}."
    claims = [
        statement("7", "no SB (number of such points)", (float(len(first.points("SB"))), 0.0), high=0.0),
        number("7", "P111 begins at an SN", "0.7", value(pair, "SN", "P111"), _still(first, 0.7)),
        number("7", "GR, of P100", "3.41", graze),
        number("7", "second SN, of P111", "5.51", value(pair, "SN", "P111", near=5.51), reason),
        *_chaos("7", found.scene, "6.75", graze[0]),
        *_then(pair, 6.75),
    ]
    return _drawn(found, claims)


def _then(pair, amplitude):
    """That a motion of two periods follows the chaos, and where it grazes."""
    values = np.linspace(amplitude, pair.first.bounds[1], LOOKS + 1)[1:]
    branches = [one for one in pair.first.branches if one.data.sizes["period"] == 2]
    seen = [stable_at(branches, one) for one in values]
    labels = ", ".join(sorted({label for one in seen for label in one}))
    text = f"then a period-2 pair (of {LOOKS} amplitudes from {amplitude:g} on those with a stable one: {labels})"
    yield statement("7", text, (float(sum(map(bool, seen))), 0.0), low=1.0)
    beyond = [one for one in pair.first.points("GR") if len(one.itinerary) == 2 and one.value > amplitude]
    if beyond:
        touch = min(beyond, key=lambda one: one.value)
        text = f"that motion grazes: {' and '.join(sorted(labelled(touch)))} meet there (amplitude)"
        yield own("7", text, value(pair, "GR", near=touch.value, periods=2), low=amplitude)


def _chaos(figure, scene, printed, low):
    """That motion is chaotic at an amplitude: the largest exponent of all that lasts. And that chaos begins there:
    where the first is found, from an amplitude on below which the motions are known."""
    amplitude = float(printed)
    there = scene.replace(amplitude=amplitude)
    attractors = find_attractors(there, STARTS)
    exponent, others = largest(there, attractors)
    text = f"chaos at {printed} (largest exponent a period; what starts settle on: {shares(attractors)})"
    yield statement(figure, text, exponent, low=0.0, more=others)
    begins, doubt, count, rate = onset(scene, low, amplitude)
    reason = (
        f"There is chaos at {begins:.4g} already, from {count} starts, with an exponent of {rate:.3g} a period; looked "
        f"at were amplitudes {doubt:g} apart."
    )
    yield number(figure, "chaos begins (the same number read as an onset)", printed, (begins, doubt), reason)


def _found(file, progress):
    found = study(file, progress=progress)
    return found, twice(found.scene, file.explore, found.diagram)


def _drawn(found, claims):
    with styled():
        return Drawn(_picture(found), CAPTION, tuple(claims), {"": dataset(found)})


def _picture(found):
    figure, places = sheet(3, 1, 2.5)
    for (ax,), variable in zip(places, "xvx", strict=True):
        plot.diagram(found.swept, variable, ax, faint=True)
        for branch in found.drawn:
            plot.branch(branch, variable, ax)
    places[2, 0].set_xlim(*_crowd([one.value for branch in found.drawn for one in branch.special]))
    for some in (places[:2], places[2:]):
        trim(some, ticks=9)
        plot.mark_points(found.drawn, some[0, 0])
        some[-1, 0].tick_params(labelbottom=True)
    legend(figure, places, columns=2)
    return png(figure)


def _crowd(values):
    """The least range that holds `CROWD` of some values, and a little more."""
    values = np.sort(values)
    count = math.ceil(CROWD * len(values))
    first = int(np.argmin(values[count - 1 :] - values[: len(values) - count + 1]))
    low, high = values[[first, first + count - 1]]
    return low - EDGE * (high - low), high + EDGE * (high - low)
