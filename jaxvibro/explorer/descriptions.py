"""Describe the current motion, special points and available actions in words."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..attractors.shares import share_text
from ..branches.branch import KIND_NAMES, Branch, Special, neighbour_labels
from ..branches.switch import SWITCHING_KINDS as LEAVING
from ..loci.locus_start import KINDS, STICKING_KINDS
from ..orbits.orbit import Orbit
from .calls import resolve
from .page_state import PageState, branches

SCENE_ACTIONS = {  # actions on the scene, always available
    "explore": "all branches",
    "sweep": "sweep up and down",
    "attractors": "attractors from 200 starts",
    "basins": "basins behind the portrait",
    "map": "map behind the plane",
}


def page_facts(page: PageState, results: Mapping[str, Any]) -> str:
    """Describe the current orbit or motion, the selected special point, and the last result."""
    paragraphs = []
    selection = resolve(page.chosen, results) if page.chosen else None
    if isinstance(selection, Special):
        normal_form = selection.normal_form
        form_text = f", {normal_form.consequence}: {normal_form}" if normal_form else ""
        neighbours_text = f", where {' and '.join(neighbour_labels(selection))} meet" if selection.joins else ""
        paragraphs.append(
            f"{selection.kind} ({KIND_NAMES.get(selection.kind, 'a monitor')}) at"
            f" {selection.value:.12g}{neighbours_text}{form_text}"
        )
    elif page.place is not None and isinstance(selection, Branch):
        paragraphs.append(
            f"point {page.place} of {len(selection)} at {selection.name} {selection.values[page.place]:.12g}"
        )
    motion = results.get(page.current)
    if isinstance(motion, Orbit):
        paragraphs.append(motion.table())
    elif isinstance(motion, xr.Dataset):
        paragraphs.append(_describe_motion(motion))
    for line in page.lines[-1:]:
        value = results[line.name]
        if line.call == "margin":
            paragraphs.append(value.table())
        elif line.call == "attractors":
            paragraphs.append("\n".join(f"{attractor.label}, {share_text(attractor)}" for attractor in value))
    return "\n\n".join(paragraphs)


def portrait_title(page: PageState, results: Mapping[str, Any]) -> str:
    """Return the title of the portrait."""
    motion = results.get(page.current)
    if isinstance(motion, Orbit):
        return f"{motion.label}, {'stable' if motion.stable else 'unstable'}"
    return "" if motion is None else "no orbit"


def action_label(call: str, page: PageState, results: Mapping[str, Any]) -> str:
    """Return the label of an action."""
    return next((action["label"] for action in available_actions(page, results) if action["call"] == call), call)


def _describe_motion(motion):
    x, v = (motion[name].values for name in ("x", "v"))
    n_impacts = motion.sizes["impact"]
    n_periods = (motion["phase"].values[-1] - motion["phase"].values[0]) / (2.0 * np.pi)
    return (
        f"no periodic orbit of up to 32 periods found; the portrait shows {n_periods:.0f} periods with"
        f" {n_impacts} impacts;\n"
        f"x from {x.min():.6g} to {x.max():.6g}, v from {v.min():.6g} to {v.max():.6g}"
    )


def available_actions(page: PageState, results: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the available actions as {"call", "label"}, those of the selection first."""
    selection, choices = resolve(page.chosen, results) if page.chosen else None, []
    if isinstance(selection, Special):
        if selection.kind in LEAVING:
            choices.append(("switch", f"branches from {selection.kind}"))
        if selection.kind in (*KINDS, *STICKING_KINDS):
            choices.append(("locus", f"locus of {selection.kind}"))
    motion = results.get(page.current)
    if isinstance(motion, Orbit):
        choices.append(("follow", f"branch of {motion.label}"))
        choices.append(("margin", f"margin of {motion.label}"))
    return [{"call": call, "label": label} for call, label in (*choices, *SCENE_ACTIONS.items())]


def special_points(page: PageState, results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return records of the special points of the branches in the diagram, sorted by value.

    Each has the reference, kind, value, label and meaning. Points that several branches share are listed once.
    """
    records: list[dict[str, Any]] = []
    for reference, branch in branches(page, results):
        for k, special in enumerate(branch.special):
            if special.kind == "EP":
                continue
            record = {
                "of": f"{reference}.special[{k}]",
                "kind": special.kind,
                "value": special.value,
                "label": special.label,
            }
            same_kind = [
                other_record
                for other_record in records
                if (other_record["kind"], other_record["label"]) == (special.kind, special.label)
            ]
            if not any(
                abs(other_record["value"] - special.value) <= 1e-9 * (1.0 + abs(special.value))
                for other_record in same_kind
            ):
                records.append(record | {"meaning": KIND_NAMES.get(special.kind, "monitor")})
    return sorted(records, key=lambda record: record["value"])
