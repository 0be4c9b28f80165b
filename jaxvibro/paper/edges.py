"""Figure 12: between which amplitudes P100 and P111 exist together, at all frequencies, for some dampings."""

import jax
import numpy as np
from scipy.interpolate import CubicSpline
from tqdm import tqdm

from .. import plot
from ..explore import explore
from ..locus import locus
from ..plot.style import COLOURS
from . import closed
from .claim import number, statement
from .panels import Drawn, panels, png, sheet, styled

NODES = (32, 48)  # of Gauss and Legendre's rule; the difference is the error bar
STEP = 1e-3  # of the parameter in a derivative by differences
OTHER = -1.5  # where the left wall stands in the row of unequal walls

CAPTION = (
    "Where P100 and P111 exist together: between the locus of the saddle-node (solid, with the closed form (19) as "
    "dots) and that of the grazing (dotted), for three dampings."
)


def drawn(file, progress):
    """Figure 12 and its claims."""
    found = []
    for each in tqdm(panels(file), "loci", disable=not progress):
        scene = each.scene.make()
        found.append((scene, *curves(scene, each)))
    claims = [claim for one in found for claim in _checked(file, *one)]
    claims += [*_signs(file, [one[0] for one in found]), *_meetings(found), _unequal(file)]
    with styled():
        return Drawn(_picture(file, found), CAPTION, tuple(claims))


def curves(scene, file):
    """(locus of the saddle-node of P111, that of the grazing of P100) as a scene file's [locus] asks."""
    asked, table = file.explore, file.locus
    branches = explore(scene, asked.parameter, asked.bounds, asked.max_period, asked.seed)
    fold = min((one for one in branches.points("SN") if one.label == "P111"), key=lambda one: one.value)
    graze = next(one for one in branches.points("GR") if one.label == "P100")
    return tuple(locus(one, table.parameters, table.bounds, largest_step=table.largest_step) for one in (fold, graze))


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
        total += sign * float(CubicSpline(up, across).integrate(max(low, up[0]), min(high, up[-1])))
    return total


def _span(curve):
    return curve[:, 1].min(), curve[:, 1].max()


def _closed(scene, high):
    """((area, error), (its derivatives by damping and restitution, error)) in closed form, up to a frequency."""
    numbers = float(scene.damping), float(scene.restitution)
    whole = [float(closed.area(*numbers, high, nodes)) for nodes in NODES]
    slopes = [np.array(jax.jacfwd(closed.area, (0, 1))(*numbers, high, nodes)) for nodes in NODES]
    return (whole[1], abs(whole[1] - whole[0])), (slopes[1], abs(slopes[1] - slopes[0]).max())


def _checked(file, scene, fold, graze):
    """That the continued loci are the closed forms, in their points and in the area between them."""
    damping, restitution = float(scene.damping), float(scene.restitution)
    across, up = fold.values.T
    exact, speed = jax.vmap(closed.symmetric_fold, (0, None, None))(up, damping, restitution)
    inside = np.asarray(speed) > 0
    gap = float(abs(across - exact)[inside].max())
    text = f"the SN of P111 is A_c of (19), gamma {damping:g} (largest difference along the locus)"
    yield statement("12", text, (gap, 0.0), high=1e-10)
    high = file.locus.bounds["frequency"][1]
    (exact, doubt), _ = _closed(scene, high)
    found, error = area(fold, graze)
    text = f"area with P100 and P111 up to omega {high:g}, gamma {damping:g}: {exact:.6f} in closed form (continued)"
    yield statement("12", text, (found, error), low=exact - 1e-6, high=exact + 1e-6 + doubt)


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


def _meetings(found):
    """Where the two curves meet."""
    for scene, fold, _ in found:
        damping, (low, _) = float(scene.damping), _span(fold.values)
        exact = float(closed.meeting(damping))
        reason = (
            f"They meet at sqrt(1 - gamma^2) = {exact:.6g}; below it sin(pi r / omega) < 0 and there is no hysteresis."
        )
        text = f"the curves meet near omega = 1, gamma {damping:g}"
        yield number("12", text, "1.0", (low, abs(low - exact)), reason)


def _unequal(file):
    """The area between other walls, where there is no closed form, with its derivatives."""
    file = panels(file)[0]
    scene = file.scene.make().replace(**{"left.position": OTHER})
    whole, error = area(*curves(scene, file))
    slopes = []
    for name in ("damping", "restitution"):
        own = float(scene.parameter(name))
        above, below = (area(*curves(scene.replace(**{name: own + step}), file))[0] for step in (STEP, -STEP))
        slopes.append((above - below) / (2.0 * STEP))
    text = (
        f"walls at {OTHER:g} and 1, gamma {float(scene.damping):g}: the region is there too, its area's derivative by "
        f"gamma is {slopes[0]:.4g}, by R {slopes[1]:.4g} (area)"
    )
    return statement("12", text, (whole, error), low=0.0)


def _picture(file, found):
    figure, ((ax,),) = sheet(1, 1, 3.8)
    for (scene, fold, graze), colour in zip(found, COLOURS, strict=False):
        for one in (fold, graze):
            plot.locus(one, ax, colour)
        plot.region(fold, graze, f"{float(scene.damping):g}", ax, colour)
        up = np.linspace(*_span(fold.values), 25)
        dots, _ = jax.vmap(closed.symmetric_fold, (0, None, None))(up, float(scene.damping), float(scene.restitution))
        ax.plot(dots, up, linestyle="none", marker="o", markersize=3, color=colour)
    for which, name in zip("xy", file.locus.parameters, strict=True):
        ax.set(**{f"{which}lim": file.locus.bounds[name]})
    ax.set_xlim(0.0, 9.0)
    return png(figure)
