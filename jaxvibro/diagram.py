"""A whole diagram: the branches of a scene along a parameter, with what tells how far it was explored."""

import json
from dataclasses import dataclass, field
from pathlib import Path

from .branch import Branch, load_branch
from .check import SceneError
from .scene import Scene
from .text import columns
from .tree import is_same
from .whole import whole

INDEX = "diagram.json"


@dataclass(frozen=True, eq=False)
class Diagram:
    """The branches of periodic orbits of a scene along a parameter.

    name: the parameter; bounds: of it; scene; branches: a tuple of `Branch`, in the order in which they were found;
    left: (branch, special point) of each point that has been left by all its branches, places in the tuples; complete:
    whether nothing was left to follow; reason: why it stopped; settings: max_period, seed and steps.
    """

    name: str
    bounds: tuple[float, float]
    scene: Scene = field(repr=False)
    branches: tuple[Branch, ...] = field(repr=False)
    left: tuple[tuple[int, int], ...] = field(repr=False)
    complete: bool
    reason: str
    settings: dict

    def __len__(self):
        return len(self.branches)

    @property
    def special(self):
        """The special points of all branches, but for ends, each orbit once, by value."""
        found = []
        for one in (one for branch in self.branches for one in branch.special if one.kind != "EP"):
            if not any(is_same(one, two) for two in found):
                found.append(one)
        return tuple(sorted(found, key=lambda one: one.value))

    def points(self, kind):
        """The special points of a kind."""
        return tuple(one for one in self.special if one.kind == kind)

    def table(self):
        """The branches, then the special points, as a text, a line each."""
        rows = [("branch", "orbits", "from", "to", "points", "special", "starts as", "ends as")]
        for place, one in enumerate(self.branches, 1):
            first, last = (f"{one.values[k]:.9g}" for k in (0, -1))
            kinds = " ".join(each.kind for each in one.special if each.kind != "EP")
            orbits = " ".join(dict.fromkeys(part.label for part in one.segments))
            rows.append((place, orbits, first, last, len(one), kinds or "-", *one.reasons))
        points = [("kind", self.name, "orbit")]
        points += [(one.kind, f"{one.value:.12g}", one.label) for one in self.special]
        return f"{columns(rows)}\n\n{columns(points)}\n\n{self.reason}"

    def save(self, folder, force=False):
        """Write the diagram into a folder, a NetCDF file a branch and an index; `load_diagram` reads the same numbers.

        Raises FileExistsError where the index is there already, unless force is given.
        """
        folder = Path(folder)
        if not force and (folder / INDEX).exists():
            raise FileExistsError(f"{folder / INDEX} is there already")
        folder.mkdir(parents=True, exist_ok=True)
        files = [f"branch_{place:03d}.nc" for place in range(len(self))]
        for name, one in zip(files, self.branches, strict=True):
            one.save(folder / name, True)
        told = {key: getattr(self, key) for key in ("name", "bounds", "left", "complete", "reason", "settings")}
        with whole(folder / INDEX, force) as part:
            part.write_text(json.dumps(told | {"branches": files}, indent=1))


def load_diagram(folder):
    """The `Diagram` of a folder that `Diagram.save` wrote.

    Raises SceneError where the folder holds none, OSError where it cannot be read.
    """
    told = (Path(folder) / INDEX).read_text()
    try:
        told = json.loads(told)
        branches = tuple(load_branch(Path(folder) / Path(name).name) for name in told["branches"])
        left = tuple((int(k), int(j)) for k, j in told["left"])
        plain = (told[key] for key in ("complete", "reason", "settings"))
        return Diagram(told["name"], tuple(told["bounds"]), branches[0].scene, branches, left, *plain)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise SceneError("folder", f"must be a folder of Diagram.save ({error})", str(folder)) from None
