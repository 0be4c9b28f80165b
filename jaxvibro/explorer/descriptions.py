"""What the page tells in words: of the orbit or motion, of special points, of what can be done with what is chosen."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..attractors.shares import share_text
from ..branches.branch import MEANINGS, Branch, Special, labels_of
from ..branches.switch import KINDS as LEAVING
from ..loci.first_point import KINDS, RESTS
from ..orbits.orbit import Orbit
from .lines import resolved
from .shown import Shown, branches

WHOLE = {  # of the scene, and so always there
    "explore": "all branches",
    "sweep": "sweep up and down",
    "attractors": "attractors from 200 starts",
    "basins": "basins behind the portrait",
    "map": "map behind the plane",
}


def facts(shown: Shown, results: Mapping[str, Any]) -> str:
    """What is known of the orbit, or motion, that the portrait shows, and of the special point that was chosen."""
    told = []
    chosen = resolved(shown.chosen, results) if shown.chosen else None
    if isinstance(chosen, Special):
        form = chosen.normal_form
        more = f", {form.consequence}: {form}" if form else ""
        meets = f", where {' and '.join(labels_of(chosen))} meet" if chosen.joins else ""
        told.append(f"{chosen.kind} ({MEANINGS.get(chosen.kind, 'a monitor')}) at {chosen.value:.12g}{meets}{more}")
    elif shown.place is not None and isinstance(chosen, Branch):
        told.append(f"point {shown.place} of {len(chosen)} at {chosen.name} {chosen.values[shown.place]:.12g}")
    one = results.get(shown.current)
    if isinstance(one, Orbit):
        told.append(one.table())
    elif isinstance(one, xr.Dataset):
        told.append(_of_motion(one))
    for line in shown.lines[-1:]:
        value = results[line.name]
        if line.call == "margin":
            told.append(value.table())
        elif line.call == "attractors":
            told.append("\n".join(f"{each.label}, {share_text(each)}" for each in value))
    return "\n\n".join(told)


def title(shown: Shown, results: Mapping[str, Any]) -> str:
    """What the portrait shows, in a few words."""
    one = results.get(shown.current)
    if isinstance(one, Orbit):
        return f"{one.label}, {'stable' if one.stable else 'unstable'}"
    return "" if one is None else "no orbit"


def label_of(call: str, shown: Shown, results: Mapping[str, Any]) -> str:
    """What an action is called."""
    return next((one["label"] for one in actions(shown, results) if one["call"] == call), call)


def _of_motion(motion):
    x, v = (motion[name].values for name in ("x", "v"))
    hits = motion.sizes["impact"]
    turns = (motion["phase"].values[-1] - motion["phase"].values[0]) / (2.0 * np.pi)
    return (
        f"no periodic orbit of up to 32 periods was settled on: {turns:.0f} periods are shown, with {hits} impacts;\n"
        f"x from {x.min():.6g} to {x.max():.6g}, v from {v.min():.6g} to {v.max():.6g}"
    )


def actions(shown: Shown, results: Mapping[str, Any]) -> list[dict[str, str]]:
    """What can be asked now: {"call", "label"} each, what concerns the clicked point first."""
    chosen, found = resolved(shown.chosen, results) if shown.chosen else None, []
    if isinstance(chosen, Special):
        if chosen.kind in LEAVING:
            found.append(("switch", f"branches that leave {chosen.kind}"))
        if chosen.kind in (*KINDS, *RESTS):
            found.append(("locus", f"locus of {chosen.kind}"))
    one = results.get(shown.current)
    if isinstance(one, Orbit):
        found.append(("follow", f"branch of {one.label}"))
        found.append(("margin", f"margin of {one.label}"))
    return [{"call": call, "label": label} for call, label in (*found, *WHOLE.items())]


def points(shown: Shown, results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The special points of the diagram's branches, by value: reference, kind, value, label, what it means."""
    found: list[dict[str, Any]] = []
    for reference, branch in branches(shown, results):
        for k, one in enumerate(branch.special):
            if one.kind == "EP":
                continue
            told = {"of": f"{reference}.special[{k}]", "kind": one.kind, "value": one.value, "label": one.label}
            known = [each for each in found if (each["kind"], each["label"]) == (one.kind, one.label)]
            if not any(abs(each["value"] - one.value) <= 1e-9 * (1.0 + abs(one.value)) for each in known):
                found.append(told | {"meaning": MEANINGS.get(one.kind, "monitor")})
    return sorted(found, key=lambda one: one["value"])
