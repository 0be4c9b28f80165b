"""Figures 4, 6 and 7: diagrams against the amplitude, swept and followed."""

from itertools import combinations

import numpy as np

from .. import plot
from ..attractors import find_attractors
from ..data import dataset
from ..spectrum import spectrum
from ..stretch import stretches
from ..study import study
from .claim import number, statement
from .located import twice, value
from .panels import Drawn, legend, png, sheet, styled, trim

STARTS = 100
CAPTION = "x and v at phase 0 of the drive against its amplitude: swept down and up (dots), and all periodic motions."
EARLY = "The paper's value is read from a sweep; the motion itself lasts up to the value beside, from few starts."
LATE = "No motion of this branch exists below the value beside: it turns there."


def fourth(file, progress):
    """Figure 4 and its claims."""
    found, pair = _found(file, progress)
    end = value(pair, "GR", "P111", near=5.215)
    claims = [
        number("4", "SN1, where P111 begins", "0.5", value(pair, "SN", "P111")),
        number("4", "GB1, where P100 grazes", "3.41", value(pair, "GR", "P100")),
        number("4", "SB, where P111 loses its symmetry", "3.45", value(pair, "SB"), _still(pair.first, 3.45)),
        number("4", "SN2, where P112 and P121 are born", "4.51", value(pair, "SN", "P112"), LATE),
        number("4", "PD of P112 and P121", "4.735", value(pair, "PD", "P112"), _still(pair.first, 4.735, "P112")),
        number("4", "asymmetric P111 ends by grazing", "5.215", end, _still(pair.first, 5.215)),
        _chaos("4", found.scene, 5.24),
        number(
            "4", "GB2, where a period-3 pair grazes", "5.42", value(pair, "GR", near=5.42, periods=3), _third(found)
        ),
    ]
    return _drawn(found, claims)


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


def _third(found):
    """What is there in place of a period-3 pair."""
    here = find_attractors(found.scene.replace(amplitude=5.42), STARTS)
    told = " and ".join(one.label for one in here)
    return f"At 5.42 starts settle on {told}; the orbits of three periods graze where the value says, none nearer."


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
    symmetric = float(len(pair.first.points("SB")))
    claims = [
        statement("7", "no SB (number of such points)", (symmetric, 0.0), high=0.0),
        number("7", "P111 begins at an SN", "0.7", value(pair, "SN", "P111"), EARLY),
        number("7", "GR", "3.41", value(pair, "GR", "P100")),
        number("7", "second SN", "5.51", value(pair, "SN", near=5.51), LATE),
        _chaos("7", found.scene, 6.75),
        _then(found),
    ]
    return _drawn(found, claims)


def _then(found):
    """That a motion of two periods follows the chaos."""
    counts = [one.count for one in stretches(found.swept) if one.periods == 2 and max(one.first, one.last) > 6.75]
    return statement(
        "7", "beyond it a period-2 pair (values of our sweeps with it)", (float(sum(counts)), 0.0), low=1.0
    )


def _chaos(figure, scene, amplitude):
    """That the motion is chaotic at an amplitude: the largest exponent of what most starts settle on."""
    one = find_attractors(scene.replace(amplitude=amplitude), STARTS)[0]
    found = spectrum(scene, "amplitude", [amplitude], one.state)
    exponent = tuple(float(found[key].values[0, 0]) for key in ("exponent", "error"))
    reason = f"What most starts settle on is {one.label}."
    return statement(figure, f"chaos at {amplitude:g} (largest exponent a period)", exponent, low=0.0, reason=reason)


def _found(file, progress):
    found = study(file, progress)
    return found, twice(found.scene, file.explore, found.diagram)


def _drawn(found, claims):
    with styled():
        return Drawn(_picture(found), CAPTION, tuple(claims), {"": dataset(found)})


def _picture(found):
    figure, places = sheet(2, 1, 3.1)
    for (ax,), variable in zip(places, "xv", strict=True):
        plot.diagram(found.swept, variable, ax, faint=True)
        for branch in found.drawn:
            plot.branch(branch, variable, ax)
    trim(places, ticks=9)
    plot.mark_points(found.drawn, places[0, 0])
    legend(figure, places, columns=2)
    return png(figure)
