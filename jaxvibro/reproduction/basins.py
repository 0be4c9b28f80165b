"""Figure 5: which start settles on what, and the manifolds of the saddles between the basins."""

import numpy as np
import scipy
from tqdm import tqdm

from .. import plot
from ..attractors.basins import basins
from ..attractors.find import find_attractors
from ..attractors.manifold import manifold
from ..branches.explore import explore
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from .claim import own, statement
from .lasting import more, shares
from .panels import Drawn, panels, png, sheet, styled, trim

NAMES = "ab"
SAMPLES = 4  # points of a manifold for the width of a cell
LENGTH = 60.0  # of a manifold on each side of a saddle

CAPTION = (
    "Basins of attraction on the section at phase 0, where the paper's figure is said to be (a) and where there is a "
    "chaotic attractor beside periodic ones (b): chaos is white. Lines are the stable manifolds of the saddles."
)


def drawn(file, whole, progress):
    """Figure 5 and its claims; whole: the scene file with the diagram that the saddles are on."""
    table = whole.explore
    diagram = explore(whole.scene.make(), table.parameter, table.bounds, table.max_period, table.seed)
    found, claims = [], []
    for each in tqdm(panels(file), "basins", disable=not progress):
        scene, asked = each.scene.make(), each.basins
        attractors = find_attractors(scene, asked.starts, asked.seed)
        held = basins(scene, *asked.grid, asked.phase, attractors)
        curves = {orbit: manifold(orbit, "stable", LENGTH, asked.phase) for orbit in saddles(scene, diagram)}
        found.append((scene, held, curves))
        claims += _chaos(scene, attractors, len(found) == 1)
    claims += _boundary(*found[0])
    with styled():
        return Drawn(
            _picture(found), CAPTION, tuple(claims), {f".{k}": one[1] for k, one in zip(NAMES, found, strict=True)}
        )


def saddles(scene, diagram):
    """The orbits of one period at a scene's amplitude, on the branches of a diagram, with a multiplier above 1."""
    value, found = float(scene.parameter(diagram.name)), []
    for branch in diagram.branches:
        if branch.data.sizes["period"] > 1:
            continue
        ahead = branch.values - value
        for place in np.flatnonzero(ahead[:-1] * ahead[1:] <= 0):
            orbit = _between(scene, branch, int(place))
            if orbit is None:
                continue
            larger = orbit.multipliers[0]
            known = any(abs(orbit.state.x - one.state.x) + abs(orbit.state.v - one.state.v) < 1e-6 for one in found)
            if not larger.imag and larger.real > 1 and not known:
                found.append(orbit)
    return found


def _between(scene, branch, place):
    """The orbit between a point of a branch and the next, from one of them; None where neither leads to it."""
    for near in (branch.orbit(place), branch.orbit(place + 1)):
        try:
            orbit = find_orbit(scene, near.state, periods=1, settle=0)
        except OrbitError:
            continue
        if orbit.label == near.label:
            return orbit
    return None


def _chaos(scene, attractors, is_theirs):
    """Whether there is a chaotic attractor: where the paper says so, and where we do."""
    chaotic = sum(one.kind == "chaotic" for one in attractors)
    amplitude, others = float(scene.amplitude), more(attractors)
    reason = f"What starts settle on is {shares(attractors)}."
    if is_theirs:
        text = f"white is a chaotic attractor, A = {amplitude:g} (number of chaotic attractors)"
        yield statement("5", text, (float(chaotic), 0.0), low=1.0, reason=reason, more=others)
        return
    both = float(min(chaotic, sum(one.kind == "periodic" for one in attractors)))
    text = f"such a picture is at A = {amplitude:g}: {shares(attractors)} (pairs of chaotic and periodic attractors)"
    yield own("5", text, (both, 0.0), low=1.0, reason=reason, more=others)
    twins = sum(one.kind == "chaotic" and one.mirror_of not in (None, k) for k, one in enumerate(attractors))
    text = f"two chaotic attractors at A = {amplitude:g}, each the other's mirror image (number of such)"
    yield own("5", text, (float(twins), 0.0), low=2.0, high=2.0, reason=reason, more=others)


def _boundary(scene, held, curves):
    """Whether the boundary of the basins is the stable manifold of the symmetric saddle, or of all saddles."""
    symmetric = [curve for orbit, curve in curves.items() if orbit.label == "P111"]
    share, total = beyond(held, symmetric)
    others = ", ".join(sorted({orbit.label for orbit in curves} - {"P111"}))
    reason = f"The rest of the boundary are stable manifolds of the saddles {others} that are born in SN2."
    text = "the boundary is the stable manifold of the unstable symmetric motion (share of the boundary's cells beyond)"
    error = np.sqrt(share * (1.0 - share) / total)
    yield statement("5", text, (share, float(error)), high=1e-3, reason=reason)
    share, total = beyond(held, list(curves.values()))
    text = f"it is those of all saddles, {len(curves)} (share of the {total} cells farther than one from them)"
    yield own("5", text, (share, float(np.sqrt(share * (1.0 - share) / total))), high=1e-3)


def beyond(held, curves):
    """(the share of the cells at a boundary of basins that are farther than one cell from some curves, all of them)."""
    label = held["label"].values
    edge = np.zeros(label.shape, bool)
    for axis in (0, 1):
        differ = np.diff(label, axis=axis) != 0
        first, second = ((slice(None), slice(s, e)) if axis else (slice(s, e),) for s, e in ((None, -1), (1, None)))
        edge[first] |= differ
        edge[second] |= differ
    near = np.zeros(label.shape, bool)
    for curve in curves:
        near[tuple(_cells(held, curve))] = True
    near = scipy.ndimage.binary_dilation(near, np.ones((3, 3), bool))
    return float((edge & ~near).sum() / max(1, edge.sum())), int(edge.sum())


def _cells(held, curve):
    """(rows, columns) of the cells that a manifold leads through, each piece of it filled in."""
    sizes = [float(held[key][1] - held[key][0]) for key in ("v", "x")]
    places = np.stack(
        [(curve[key].values - float(held[key][0])) / size for key, size in zip(("v", "x"), sizes, strict=True)]
    )
    step = np.diff(places, axis=1)
    joined = np.diff(curve["piece"].values) == 0
    count = np.where(joined, np.ceil(SAMPLES * abs(step).max(axis=0)), 0).astype(int) + 1
    share = np.concatenate([np.arange(n) / n for n in count])
    filled = np.repeat(places[:, :-1], count, axis=1) + share * np.repeat(step, count, axis=1)
    cells = np.round(filled).astype(int)
    inside = np.all((cells >= 0) & (cells < np.array(held["label"].shape)[:, None]), axis=0)
    return cells[:, inside]


def _picture(found):
    figure, places = sheet(1, len(found), 4.6)
    for ax, name, (scene, held, curves) in zip(places.flat, NAMES, found, strict=True):
        plot.basins(held, ax)
        told = ax.get_legend()
        texts = [each.get_text() for each in told.texts]
        look = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "frameon": False}
        ax.legend(handles=told.legend_handles, labels=texts, **look)
        for curve in curves.values():
            plot.manifold(curve, ax)
        ax.set_title(f"({name}) $A$ = {float(scene.amplitude):g}", loc="left")
    trim(places, ticks=3)
    return png(figure)
