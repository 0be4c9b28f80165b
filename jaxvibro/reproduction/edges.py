"""Figure 12: between which amplitudes P100 and P111 exist together, at all frequencies, for some dampings."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
import scipy
from tqdm import tqdm

from .. import plot
from ..branches.explore import explore
from ..branches.follow import follow
from ..loci.locus import Locus, locus
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..plot.style import COLOURS
from . import closed
from .claim import own, statement
from .panels import Drawn, legend, panels, png, sheet, styled, trim

NODES = (32, 48)  # of Gauss and Legendre's rule; the difference is the error bar
STEP = 1e-3  # of the parameter in a derivative by differences
OTHER = -1.5  # where the left wall stands in the row of unequal walls
NEAR = 0.1  # of omega = 1: what counts as near
BEYOND, SAME = 0.02, 1e-9  # of the way from a saddle-node to the grazing: where P111 is looked for; of amplitudes
SHORT, LONG = 0.1, 0.3  # steps along a branch, of the speed at its saddle-node
LOOKS = 8  # frequencies at which a motion between the curves is looked for
ACROSS, HIGH = (0.0, 9.0), (0.55, 3.0)  # ranges of amplitude and frequency in the upper picture
NARROW, LOW = (0.68, 1.0), (0.2, 0.55)  # in the lower
SEEN = 0.05  # a tongue as wide is shaded

CAPTION = (
    "Where P100 and P111 exist together: between the locus of the saddle-node (solid, with the closed form (19) as "
    "dots) and that of the grazing (dotted), for the dampings gamma written there; below, enlarged, the tongues at "
    "lower frequencies, where sin(pi r / omega) > 0 again, those of larger damping too thin to be seen. P111 may "
    "graze in them before P100 does, and goes on with more impacts."
)


def drawn(file, progress):
    """Figure 12 and its claims."""
    found = []
    for each in tqdm(panels(file), "loci", disable=not progress):
        scene = each.scene.make()
        found.append((scene, *curves(scene, each), tongues(scene, each)))
    claims = [claim for one in found for claim in _checked(file, *one)]
    claims += [
        *_signs(file, [one[0] for one in found]),
        *_together(file, found),
        *_meetings(file, found),
        _unequal(file),
    ]
    with styled():
        return Drawn(_picture(file, found), CAPTION, tuple(claims))


def curves(scene, file):
    """(locus of the saddle-node of P111, that of the grazing of P100) as a scene file's [locus] asks."""
    asked, table = file.explore, file.locus
    branches = explore(scene, asked.parameter, asked.bounds, asked.max_period, asked.seed)
    fold = min((one for one in branches.points("SN") if one.label == "P111"), key=lambda one: one.value)
    graze = next(one for one in branches.points("GR") if one.label == "P100")
    return tuple(locus(one, table.parameters, table.bounds, largest_step=table.largest_step) for one in (fold, graze))


class Tongue(NamedTuple):
    """fold: the `Locus` of the saddle-node; frequency: one within; touch: the amplitude at which P111 grazes there
    before P100 does, nan where it does not."""

    fold: Locus
    frequency: float
    touch: float


def tongues(scene, file):
    """The `Tongue`s below the region, omega from r / (2 k + 1) to r / (2 k), k = 1, 2, ..., down to the lowest."""
    table, bounce, damping = file.locus, float(scene.restitution), float(scene.damping)
    lowest, root, found = table.bounds["frequency"][0], float(closed.meeting(damping)), []
    for k in range(1, int(0.5 * root / lowest) + 1):
        frequency = 0.5 * (max(lowest, root / (2 * k + 1)) + root / (2 * k))
        begin, speed = (float(each) for each in closed.symmetric_fold(frequency, damping, bounce))
        end = float(closed.grazing(frequency, damping))
        there = scene.replace(frequency=frequency, amplitude=begin + BEYOND * (end - begin))
        orbit = find_orbit(there, closed.symmetric_start(there), periods=1, settle=0)
        steps = {"first_step": SHORT * speed, "largest_step": LONG * speed}  # a tongue may be very thin
        branch = follow(orbit, "amplitude", (0.5 * begin, end), stop="GR", **steps)
        (point,) = branch.points("SN")
        before = [one.value for one in branch.points("GR") if end - one.value > SAME]
        fold = locus(point, table.parameters, table.bounds, largest_step=table.largest_step)
        found.append(Tongue(fold, frequency, min(before, default=np.nan)))
    return tuple(found)


def area(fold, graze):
    """(the area in (A, omega) between two loci up to the highest frequency, its error): of splines through all and
    through every other of their points."""
    fine, coarse = (_between(*(_every(one.values, step) for one in (fold, graze))) for step in (1, 2))
    return fine, abs(fine - coarse)


def _every(curve, step):
    """Every so many points of a curve, its ends among them."""
    return curve[np.unique(np.append(np.arange(0, len(curve), step), len(curve) - 1))]


def _between(fold, graze):
    (low, high), total = _span(fold), 0.0
    for sign, one in ((-1.0, fold), (1.0, graze)):
        across, up = one[np.argsort(one[:, 1])].T
        total += sign * float(scipy.interpolate.CubicSpline(up, across).integrate(max(low, up[0]), min(high, up[-1])))
    return total


def _span(curve):
    return curve[:, 1].min(), curve[:, 1].max()


def _closed(scene, high):
    """((area, error), (its derivatives by damping and restitution, error)) in closed form, up to a frequency."""
    numbers = float(scene.damping), float(scene.restitution)
    whole = [float(closed.area(*numbers, high, nodes)) for nodes in NODES]
    slopes = [np.array(jax.jacfwd(closed.area, (0, 1))(*numbers, high, nodes)) for nodes in NODES]
    return (whole[1], abs(whole[1] - whole[0])), (slopes[1], abs(slopes[1] - slopes[0]).max())


def _checked(file, scene, fold, graze, lower):
    """That the continued loci are the closed forms, in their points and in the area between them."""
    damping = float(scene.damping)
    text = f"the SN of P111 is A_c of (19), gamma {damping:g} (largest difference along the locus)"
    yield own("12", text, (_off(scene, fold), 0.0), high=1e-10)
    for one in lower:
        low, high = _span(one.fold.values)
        touch = "it does not graze before P100" if np.isnan(one.touch) else f"it grazes itself at {one.touch:.6g}"
        begin, end = (float(each) for each in _both(scene, one.frequency))
        text = (
            f"sin(pi r / omega) > 0 again, and the SN of P111 is A_c, from omega {low:.6g} to {high:.6g}, gamma "
            f"{damping:g}: {begin:.6g} at omega {one.frequency:.4g}, where P100 grazes at {end:.6g} and {touch} "
            "(largest difference to A_c)"
        )
        yield own("12", text, (_off(scene, one.fold), 0.0), high=1e-10)
    high = file.locus.bounds["frequency"][1]
    (exact, doubt), _ = _closed(scene, high)
    found, error = area(fold, graze)
    text = f"area with P100 and P111 up to omega {high:g}, gamma {damping:g}: {exact:.6f} in closed form (continued)"
    yield own("12", text, (found, error), low=exact - 1e-6, high=exact + 1e-6 + doubt)


def _off(scene, fold):
    """The largest difference between a locus and A_c, where the closed form's speed is above 0."""
    across, up = fold.values.T
    exact, speed = jax.vmap(closed.symmetric_fold, (0, None, None))(up, float(scene.damping), float(scene.restitution))
    return float(abs(across - exact)[np.asarray(speed) > 0].max())


def _both(scene, frequency):
    """(A_c, sqrt(D)) at a frequency."""
    damping = float(scene.damping)
    return closed.symmetric_fold(frequency, damping, float(scene.restitution))[0], closed.grazing(frequency, damping)


def _signs(file, scenes):
    """How the area and the width change."""
    high = file.locus.bounds["frequency"][1]
    slopes = [_closed(scene, high)[1] for scene in scenes]
    error = max(one[1] for one in slopes)
    damping, restitution = np.array([one[0] for one in slopes]).T
    told = ", ".join(f"{each:.4g}" for each in damping)
    text = f"the region shrinks as gamma grows (derivatives of the area by gamma: {told}; the largest)"
    yield statement("12", text, (float(damping.max()), error), high=0.0)
    told = ", ".join(f"{each:.4g}" for each in restitution)
    text = f"the region shrinks as R falls (derivatives of the area by R: {told}; the least)"
    yield statement("12", text, (float(restitution.min()), error), low=0.0)
    for scene in scenes:
        damping = float(scene.damping)
        up = np.linspace(float(closed.meeting(damping)), high, 200)[1:]
        wide = np.asarray(jax.vmap(closed.width, (0, None, None))(up, damping, float(scene.restitution)))
        text = f"the region grows away from omega = 1, gamma {damping:g} (least slope of its width above the meeting)"
        yield statement("12", text, (float(np.diff(wide).min() / (up[1] - up[0])), 1e-12), low=0.0)


def _together(file, found):
    """That P111 lasts between the curves, where P100 does."""
    high = file.locus.bounds["frequency"][1]
    for scene, *_ in found:
        damping = float(scene.damping)
        low, missing = float(closed.meeting(damping)), 0
        for frequency in np.linspace(low, high, LOOKS + 1)[1:]:
            begin, end = (float(each) for each in _both(scene, frequency))
            missing += not _lasts(scene.replace(frequency=frequency, amplitude=0.5 * (begin + end)))
        text = (
            f"between the curves P100 and P111 exist together, gamma {damping:g} (of {LOOKS} points in the middle, "
            "those without a stable P111)"
        )
        yield statement("12", text, (float(missing), 0.0), high=0.0)


def _lasts(scene):
    """Whether a P111, symmetric or not, is stable: where the closed form's motion settles."""
    try:
        orbit = find_orbit(scene, closed.symmetric_start(scene))
    except OrbitError:
        return False
    return orbit.label == "P111" and orbit.stable


def _meetings(file, found):
    """Where the two curves meet."""
    lowest = file.locus.bounds["frequency"][0]
    for scene, fold, _, lower in found:
        damping, (low, _) = float(scene.damping), _span(fold.values)
        exact = float(closed.meeting(damping))
        again = [each for one in lower for each in reversed(_span(one.fold.values)) if each > lowest]
        below = f", and again at {', '.join(f'{each:.4g}' for each in again)}" if again else ""
        reason = f"They meet at sqrt(1 - gamma^2) = {exact:.6g}{below}."
        text = (
            f"the curves meet near omega = 1, to within {NEAR:g}, gamma {damping:g} (the highest omega where they do)"
        )
        yield statement("12", text, (low, abs(low - exact)), low=1.0 - NEAR, high=1.0 + NEAR, reason=reason)


def _unequal(file):
    """The area between other walls, where there is no closed form, with its derivatives."""
    file = panels(file)[0]
    scene = file.scene.make().replace(**{"left.position": OTHER})
    whole, error = area(*curves(scene, file))
    slopes = []
    for name in ("damping", "restitution"):
        middle = float(scene.parameter(name))
        above, below = (area(*curves(scene.replace(**{name: middle + step}), file))[0] for step in (STEP, -STEP))
        slopes.append((above - below) / (2.0 * STEP))
    text = (
        f"walls at {OTHER:g} and 1, gamma {float(scene.damping):g}: the region is there too, its area's derivative by "
        f"gamma is {slopes[0]:.4g}, by R {slopes[1]:.4g} (area)"
    )
    return own("12", text, (whole, error), low=0.0)


def _picture(file, found):
    figure, places = sheet(2, 1, 3.3)
    (above,), (below,) = places
    for (scene, fold, graze, lower), colour in zip(found, COLOURS, strict=False):
        told, folds = f"\N{GREEK SMALL LETTER GAMMA} = {float(scene.damping):g}", [one.fold for one in lower]
        for ax, loci, bounds in ((above, [fold], HIGH), (below, folds, LOW)):
            for one in (*loci, graze):
                plot.locus(_marked(one, bounds), ax, colour)
            for one in loci:
                _dotted(scene, one, ax, colour)
                if _off_grazing(scene, one) > SEEN:
                    plot.region(one, graze, told, ax, colour)
    for ax, (across, up) in ((above, (ACROSS, HIGH)), (below, (NARROW, LOW))):
        ax.set(xlim=across, ylim=up)
    above.set_ylim(top=file.locus.bounds["frequency"][1])
    trim(places, shared=False, ticks=9)
    legend(figure, places, columns=2, without={patch.get_gid() for patch in above.patches})  # gamma: in the picture
    return png(figure)


def _marked(one, bounds):
    """A locus with its special points within some frequencies alone, and its ends."""
    inside = [each for each in one.special if each.kind == "EP" or bounds[0] < each.values["frequency"] < bounds[1]]
    return replace(one, special=tuple(inside or one.special[:1]))


def _dotted(scene, fold, ax, colour):
    up = np.linspace(*_span(fold.values), 25)
    dots, _ = jax.vmap(closed.symmetric_fold, (0, None, None))(up, float(scene.damping), float(scene.restitution))
    told = "saddle-node, closed form"
    ax.plot(dots, up, linestyle="none", marker="o", markersize=2.5, color=colour, label=told)


def _off_grazing(scene, fold):
    """How far a locus is below the grazing of P100 at most."""
    across, up = fold.values.T
    return float((np.asarray(closed.grazing(up, float(scene.damping))) - across).max())
