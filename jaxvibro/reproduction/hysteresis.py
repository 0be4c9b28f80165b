"""Figure 2: hysteresis of the sweeps at two frequencies, between symmetric walls and between others."""

import numpy as np

from .. import plot
from ..studies.compute import study
from .claim import number, statement
from .closed import forced
from .located import twice, value
from .panels import Drawn, legend, panels, png, sheet, styled, trim

NAMES = "abcd"
JUMPS = (("2.615", "0.40"), ("4.33", "0.65"))  # up and down, as printed, at the two frequencies between walls at 1
AWAY = 1e-6  # from the motion without impacts
SEEN = 1e-3  # between two legs

CAPTION = (
    "x at phase 0 of the drive against its amplitude, swept down and up, over the branches of periodic motions: "
    "between walls at -1 and 1 (above) and at -1.5 and 1 (below), at two frequencies."
)


def drawn(file, progress):
    """Figure 2 and its claims."""
    found = [study(each, progress=progress) for each in panels(file)]
    edges = [_edges(each) for each in found]
    with styled():
        picture = _picture(found)
    claims = [claim for k, jumps in enumerate(JUMPS) for claim in _jumps(found[k], edges[k], jumps)]
    claims += [_wider(found[k + 2], edges[k], edges[k + 2]) for k in range(2)]
    return Drawn(
        picture, CAPTION, tuple(claims), {f".{name}": each.swept for name, each in zip(NAMES, found, strict=True)}
    )


def _edges(found):
    """((value, error) of the grazing of P100, that of the first saddle-node of P111)."""
    pair = twice(found.scene, found.file.explore, found.diagram)
    return value(pair, "GR", "P100"), value(pair, "SN", "P111")


def _jumps(found, edges, printed):
    scene = found.scene
    told = f"frequency {float(scene.frequency):g}"
    seen = [swept_jump(found, leg) for leg in ("up", "down")]
    names = ("the grazing of P100", "the saddle-node of P111")
    for way, edge, name, text, jump in zip(("up", "down"), edges, names, printed, seen, strict=True):
        reason = (
            f"It is {name}. Our own sweep, {found.file.sweep.count} values settled for {found.file.sweep.settle} "
            f"periods, jumps between {jump[0]:.5g} and {jump[1]:.5g}: that depends on its steps and how it settles."
        )
        yield number("2a", f"jump {way} at {told}", text, edge, reason)


def swept_jump(found, leg):
    """Between which two values a leg changes from the motion without impacts to another, or back to it: the last of
    the one side and the first of the other, in the order of the sweep; nan where it does not."""
    swept, scene = found.swept.sel(leg=leg), found.scene
    values = swept[swept.attrs["swept"]].transpose("step", ...).values.ravel()
    w, damping = float(scene.frequency), float(scene.damping)
    states = zip("xv", forced(values, w, damping), strict=True)
    gaps = np.stack([abs(swept[key].transpose("step", "period").values - one[:, None]) for key, one in states])
    (places,) = np.nonzero(np.diff(gaps.max(axis=(0, 2)) > AWAY * (1.0 + values)))
    return (values[places[0]], values[places[0] + 1]) if len(places) else (np.nan, np.nan)


def apart(swept):
    """The (low, high) of each range of values at which the legs of a sweep, one the other's way back, differ."""
    values = swept[swept.attrs["swept"]].transpose("step", "leg").values
    down, up = swept["x"].transpose("leg", "step", "period").values
    differ = abs(up - down[::-1]).max(axis=1) > SEEN
    edges = np.flatnonzero(np.diff(np.concatenate([[False], differ, [False]])))
    return [(values[first, 1], values[last - 1, 1]) for first, last in edges.reshape(-1, 2)]


def _wider(found, narrow, wide):
    """That the interval with two motions is wider between unequal walls."""
    (up, rough), (down, coarse) = wide
    (top, above), (bottom, below) = narrow
    more = (up - down) - (top - bottom), rough + coarse + above + below
    told = (
        f"the loop of P100 and P111 at frequency {float(found.scene.frequency):g}: {up - down:.6g} here, "
        f"{top - bottom:.6g} there"
    )
    again = " and ".join(f"{low:.4g} to {high:.4g}" for low, high in apart(found.swept))
    reason = (
        f"P100 grazes at {up:.6g} here and {top:.6g} there, P111 begins at {down:.6g} and {bottom:.6g}. Our sweeps to "
        f"and fro differ at {again}."
    )
    return statement("2b", f"hysteresis is wider than in 2a ({told}; the difference)", more, low=0.0, reason=reason)


def _picture(found):
    figure, places = sheet(2, 2, 2.3)
    for ax, one, name in zip(places.flat, found, NAMES, strict=True):
        plot.diagram(one.swept, "x", ax)
        for branch in one.drawn:
            plot.branch(branch, "x", ax, "black")
        ax.set_title(f"({name}) $\\omega$ = {float(one.scene.frequency):g}", loc="left")
    trim(places)
    legend(figure, places, without=("branch",))
    return png(figure)
