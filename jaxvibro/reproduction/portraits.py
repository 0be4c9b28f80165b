"""Figure 3: phase portraits of what the scene settles on at five amplitudes."""

from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from .. import plot
from ..attractors.find import find_attractors
from ..maps.simulate import simulate
from ..orbits.find import find_orbit
from ..orbits.orbit import Orbit
from ..scene.state import State
from .claim import statement
from .closed import forced, grazing
from .lasting import more, shares
from .panels import Drawn, panels, png, sheet, styled, trim

NAMES = "abcde"
CLAIMED = ("P100", "P111", "P111", "P112", "P121")  # in the order of the panels
SYMMETRIC, LOPSIDED = 1, 2  # the panel said to be symmetric, the one said not to be
SAMPLES, ROAMED = 400, 60  # of a drive period; periods drawn of a chaotic motion
ROUNDING, APART = 1e-9, 1e-6  # of an attractor's speeds; as different they are two

CAPTION = (
    "Phase portraits at five amplitudes: the motion that the paper names where it lasts, else that which most starts "
    "settle on; where chaotic, 60 drive periods. Dots are the states at phase 0."
)


def drawn(file, progress):
    """Figure 3 and its claims."""
    found = []
    for each in tqdm(panels(file), "portraits", disable=not progress):
        scene, asked = each.scene.make(), each.attractors
        attractors = find_attractors(scene, asked.starts, asked.seed)
        found.append((scene, _lasting(scene, attractors), more(attractors)))
    claims = [_there(k, *one) for k, one in enumerate(found)]
    claims.insert(SYMMETRIC + 1, _symmetric(*found[SYMMETRIC][:2]))
    claims.insert(LOPSIDED + 2, _lopsided(*found[LOPSIDED][:2]))
    with styled():
        return Drawn(_picture(found), CAPTION, tuple(claims))


class Motion(NamedTuple):
    """What lasts: its label, a state on it, its drive periods (0: chaotic), its `Orbit` or None, share of starts."""

    label: str
    state: State
    periods: int
    orbit: Orbit | None
    share: float


def _lasting(scene, attractors):
    """The `Motion`s that last: the attractors that starts settle on, and P100 where it is stable, as its basin may be
    too small for them."""
    found = [
        Motion(one.label, one.state, one.periods, one.orbit, one.share)
        for one in attractors
        if one.kind != "unresolved"
    ]
    w = float(scene.frequency)
    amplitude, damping = float(scene.amplitude), float(scene.damping)
    if amplitude < grazing(w, damping) and not any(one.label == "P100" for one in found):
        orbit = find_orbit(scene, State(*forced(amplitude, w, damping)), periods=1, settle=0)
        found.append(Motion(orbit.label, orbit.state, 1, orbit, 0.0))
    return found


def _there(k, scene, motions, others):
    """That the motion claimed lasts; others: how many unresolved ones there may be."""
    text = f"{CLAIMED[k]} at A = {float(scene.amplitude):g} (number of such attractors)"
    alike = float(sum(_is_meant(k, one) for one in motions))
    reason = f"What lasts there, and the share of starts that settle on it: {shares(motions)}."
    return statement(f"3{NAMES[k]}", text, (alike, 0.0), low=1.0, reason=reason, more=others)


def _is_meant(k, motion):
    label = CLAIMED[k]
    return motion.label in (label, f"P{label[1]}{label[3]}{label[2]}")


def _symmetric(scene, motions):
    """That a motion of those is symmetric: both walls are hit at one speed."""
    reason = "The symmetry is broken before: see SB in figure 4."
    text = f"symmetric at A = {float(scene.amplitude):g} (least difference of the impacts' speeds at the walls)"
    gap = min(_gaps(SYMMETRIC, motions), default=np.nan)
    return statement(f"3{NAMES[SYMMETRIC]}", text, (gap, ROUNDING), high=APART, reason=reason)


def _lopsided(scene, motions):
    """That the motion is not symmetric."""
    text = f"asymmetric at A = {float(scene.amplitude):g} (least difference of the impacts' speeds at the walls)"
    gap = min(_gaps(LOPSIDED, motions), default=np.nan)
    return statement(f"3{NAMES[LOPSIDED]}", text, (gap, ROUNDING), low=APART)


def _gaps(k, motions):
    """The difference of the speeds at both walls of each motion that is meant."""
    for one in (each for each in motions if each.orbit is not None and _is_meant(k, each)):
        speed, side = np.asarray(one.orbit.impacts.speed), np.asarray(one.orbit.impacts.side)
        yield abs(float(speed[side == -1].mean() - speed[side == 1].mean()))


def _picture(found):
    figure, places = sheet(2, 3, 2.2)
    for k, (ax, (scene, motions, _)) in enumerate(zip(places.flat, found, strict=False)):
        one = next((each for each in motions if _is_meant(k, each)), motions[0])
        plot.portrait(simulate(scene, one.state, one.periods or ROAMED, SAMPLES), scene, ax)
        ax.set_title(f"({NAMES[k]}) $A$ = {float(scene.amplitude):g}: {one.label}", loc="left")
    for ax in places.flat[len(found) :]:
        ax.set_axis_off()
    trim(places, shared=False, ticks=4)
    return png(figure)
