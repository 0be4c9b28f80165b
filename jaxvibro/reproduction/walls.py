"""One wall: the orbits P101 and P110 with their closed forms, fixed and moving, and the paper's remark on them."""

import numpy as np

from .. import plot
from ..branches.explore import explore
from ..scene.scene import make_scene
from ..scene.wall import Motion, Wall
from . import closed
from .claim import own, statement
from .located import ROUNDING, twice, value
from .panels import Drawn, legend, panels, png, sheet, styled, trim

MOTION = (0.1, 0.5)  # amplitude and phase of the wall in the row of a moving one
SAME = 1e-9

CAPTION = (
    "x at phase 0 of the drive against its amplitude, one wall, at three frequencies: P101 begins in a saddle-node "
    "only where sin(r T) < 0."
)


def drawn(file, progress):
    """The diagrams of one wall and the claims on it."""
    found, claims = [], []
    for each in panels(file):
        scene = each.scene.make()
        pair = twice(scene, each.explore)
        found.append((scene, pair.first))
        claims += _folds(scene, pair)
    claims += [*_mirrored(file, *found[0]), _moving(file, found[0][0])]
    with styled():
        return Drawn(_picture(found), CAPTION, tuple(claims))


def _known(scene):
    wall = float(scene.right.position)
    return closed.single_fold(float(scene.frequency), float(scene.damping), float(scene.restitution), wall)


def _folds(scene, pair):
    """Where P101 has a saddle-node: as its own condition says, not as (19)'s does."""
    w, r = float(scene.frequency), float(np.sqrt(1.0 - float(scene.damping) ** 2))
    fold, speed = (float(each) for each in _known(scene))
    found = value(pair, "SN", "P101")
    told = f"frequency {w:g}"
    count = float(sum(one.label == "P101" for one in pair.first.points("SN")))
    ours, theirs = np.sin(2.0 * np.pi * r / w) < 0, np.sin(np.pi * r / w) > 0
    if ours:
        text = f"P101 has an SN where sin(r T) < 0, {told}: at A_c = {fold:.12g} (located less closed form)"
        yield own("one wall", text, (found[0] - fold, found[1]), low=-SAME, high=SAME)
    else:
        text = f"P101 has no SN where sin(r T) > 0, {told} (number of them; the closed form's u is {speed:.3g})"
        yield own("one wall", text, (count, 0.0), high=0.0)
    expected = "has" if theirs else "has no"
    reason = "The condition has (19)'s form with another sign and twice the time: sin(r T) < 0, not sin(r T / 2) > 0."
    text = f'"the condition is the same as (19)": {told}, P101 {expected} SN (number of them)'
    low, high = (1.0, np.inf) if theirs else (-np.inf, 0.0)
    yield statement("one wall", text, (count, 0.0), low=low, high=high, reason=reason)


def _mirrored(file, scene, diagram):
    """That P110 on a wall to the left is the mirror image of P101."""
    numbers = (float(getattr(scene, key)) for key in ("amplitude", "frequency", "damping", "restitution"))
    turned = make_scene(*numbers, (-float(scene.right.position), None))
    table = file.explore
    other = explore(turned, table.parameter, table.bounds, table.max_period, table.seed)
    here = [one.value for one in diagram.points("SN") if one.label == "P101"]
    there = [one.value for one in other.points("SN") if one.label == "P110"]
    gap = abs(here[0] - there[0]) if here and there else np.nan
    text = f"P110 on a wall to the left has the SN of P101, frequency {float(scene.frequency):g} (difference)"
    yield own("one wall", text, (gap, ROUNDING), high=SAME)


def _moving(file, scene):
    """That a wall which moves with the drive acts like a fixed one under another drive."""
    motion = Motion(*MOTION)
    numbers = (float(getattr(scene, key)) for key in ("amplitude", "frequency", "damping", "restitution"))
    moving = make_scene(*numbers, (None, Wall(float(scene.right.position), motion=motion)))
    found = value(twice(moving, file.explore), "SN", "P101")
    exact = closed.amplitude_at(float(_known(scene)[0]), float(scene.frequency), float(scene.damping), motion)
    text = (
        f"a wall moving by {MOTION[0]:g} cos(omega t + {MOTION[1]:g}), frequency {float(scene.frequency):g}: SN of "
        f"P101 at A = {exact:.12g} (located less closed form)"
    )
    return own("moving wall", text, (found[0] - exact, found[1]), low=-SAME, high=SAME)


def _picture(found):
    figure, places = sheet(1, len(found), 2.4)
    for ax, (scene, diagram) in zip(places.flat, found, strict=True):
        for branch in diagram.branches:
            plot.branch(branch, "x", ax, "black")
        ax.set_title(f"$\\omega$ = {float(scene.frequency):g}", loc="left")
    trim(places, shared=False, ticks=4)
    legend(figure, places, without=("branch",))
    return png(figure)
