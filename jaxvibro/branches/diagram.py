"""A whole diagram: the branches of a scene along a parameter, with what tells how far it was explored."""

import json
import os
import re
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import msgspec
import pandas as pd

from ..output.atomic_write import whole
from ..output.checksums import MARKS, digest, is_format, opened, sealed
from ..output.labels import name_in
from ..output.table_text import columns, headed
from ..output.units import unit_in, unit_of
from ..problem.end import scaled
from ..scene.check import ArgumentError, host, short
from ..scene.scene import Scene
from ..scene.scene_table import SceneTable, table_of
from .branch import Branch, Special, ends
from .branch_file import branch_of
from .branch_tree import is_same, mirror_images

INDEX = "diagram.json"
NAME = re.compile(r"branch_\d+(_[0-9a-f]{16})?\.nc")  # of a branch's file


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
    settings: dict[str, int | float]

    def __len__(self):
        return len(self.branches)

    @property
    def special(self) -> tuple[Special, ...]:
        """The special points of all branches, but for ends, each orbit once, by value."""
        return _special(self.branches)

    def points(self, kind: str) -> tuple[Special, ...]:
        """The special points of a kind."""
        return tuple(one for one in self.special if one.kind == kind)

    def table(self, units: str = "scene", labels: str = "jaxvibro") -> str:
        """The branches, then the special points, as a text, a line each. units, labels: as in `Branch.table`.

        A branch and its mirror image are one line, which names both. Of a closed branch the line has the range.

        Raises ArgumentError for other units and labels, and where the scene has no scales.
        """
        unit, size = unit_in(self.scene, unit_of(self.name), units)
        rows: list[tuple[object, ...]] = [
            ("branch", "orbits", "from", "to", "points", "special", "starts as", "ends as")
        ]
        images = mirror_images(self.branches)
        listed = [one for k, one in enumerate(self.branches) if k not in images]
        twins = {j + 1: f"{j + 1} (mirror image: {k + 1})" for k, j in images.items()}
        for place, one in ((k + 1, one) for k, one in enumerate(self.branches) if k not in images):
            why = one.reasons if size == 1.0 else [scaled(each, size) for each in one.reasons]
            first, last = (f"{each * size:.9g}" for each in ends(one))
            kinds = " ".join(name_in(each.kind, labels) for each in one.special if each.kind != "EP")
            orbits = " ".join(dict.fromkeys(part.label for part in one.segments))
            rows.append((twins.get(place, place), orbits, first, last, len(one), kinds or "-", *why))
        points = [("kind", headed(self.name, unit, units), "orbit")]
        points += [(name_in(one.kind, labels), f"{one.value * size:.12g}", one.label) for one in _special(listed)]
        return f"{columns(rows)}\n\n{columns(points)}\n\n{self.reason}"

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """All branches' points, a pandas.DataFrame as `Branch.to_frame` gives it, before it the branch's number in the
        table. Raises ArgumentError for other units, and where the scene has no scales."""
        return frame_of(self.branches, units)

    def save(self, folder: str | PathLike[str], force: bool = False) -> None:
        """Write the diagram into a folder, a NetCDF file a branch and an index; `load_diagram` reads the same numbers.

        The branches' files bear their checksums in their names, so that those of a diagram that is there already stay
        as they are until the index, written last, names the new ones. Raises FileExistsError where the index is there
        already, unless force is given.
        """
        folder = Path(folder)
        index = folder / INDEX
        if not force and os.path.lexists(index):
            raise FileExistsError(f"{index} is there already")
        folder.mkdir(parents=True, exist_ok=True)
        before, files = _named(index), {}
        for place, one in enumerate(self.branches):
            content = one.content
            known = digest(content)
            name = f"branch_{place:03d}_{known[:16]}.nc"
            with whole(folder / name, True) as file:
                file.write(content)
            files[name] = known
        told = {key: getattr(self, key) for key in ("name", "bounds", "left", "complete", "reason", "settings")}
        told |= {"scene": msgspec.toml.encode(table_of(self.scene)).decode(), "branches": files}
        with whole(index, force) as file:
            file.write(sealed(json.dumps(MARKS | told, indent=1).encode()))
        for name in before - set(files):
            (folder / name).unlink(missing_ok=True)


def _special(branches):
    """The special points of branches, but for ends, each orbit once, by value."""
    found: list[Special] = []
    for one in (one for branch in branches for one in branch.special if one.kind != "EP"):
        if not any(is_same(one, two) for two in found):
            found.append(one)
    return tuple(sorted(found, key=lambda one: one.value))


def frame_of(branches, units):
    """The points of branches behind one another, a pandas.DataFrame, with their numbers from 1."""
    frames = [one.to_frame(units) for one in branches]
    for place, each in enumerate(frames, 1):
        each.insert(0, "branch", place)
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame({"branch": []})


class Index(msgspec.Struct):
    """What the index of a diagram's folder says; branches: {file: its SHA-256}, a list of files in format 1, which had
    no scene."""

    name: str
    bounds: tuple[float, float]
    left: list[tuple[int, int]]
    complete: bool
    reason: str
    settings: dict[str, int | float]
    branches: dict[str, str] | list[str]
    scene: str | None = None
    format: int = 1


@host("use what was loaded before")
def load_diagram(folder: str | PathLike[str]) -> Diagram:
    """The `Diagram` of a folder that `Diagram.save` wrote.

    A folder of before, without checksums, is read with a warning. Raises ArgumentError where the folder holds none or a
    file is damaged, OSError where one cannot be read.
    """
    path = Path(folder) / INDEX
    index = opened(path, _index)
    digests = index.branches if isinstance(index.branches, dict) else dict.fromkeys(index.branches)
    branches = tuple(_branch(path.with_name(name), known) for name, known in digests.items())
    try:
        scene = branches[0].scene if index.scene is None else msgspec.toml.decode(index.scene, type=SceneTable).make()
        left = tuple((k, j) for k, j in index.left if branches[k].special[j])
        alike = all(one.name == index.name for one in branches)
    except (LookupError, ValueError) as error:
        raise _refused(error, path) from None
    if not alike or min((one for pair in left for one in pair), default=0) < 0:
        raise _refused("its branches are another's", path)
    return Diagram(index.name, index.bounds, scene, branches, left, index.complete, index.reason, index.settings)


def _index(content, path):
    try:
        index = msgspec.convert(json.loads(content), Index)
    except (ValueError, RecursionError) as error:
        raise _refused(error, path) from None
    is_format(index.format, path)
    if not all(map(NAME.fullmatch, index.branches)):
        raise _refused("it names files that are no branches'", path)
    return index


def _refused(error, path):
    return ArgumentError("folder", f"must be a folder of Diagram.save ({short(error)})", str(path.parent))


def _named(index):
    """The files of branches that an index names, none where there is none that can be read."""
    try:
        return set(_index(index.read_bytes(), index).branches)
    except (OSError, ArgumentError):
        return set()


def _branch(path, known):
    content = path.read_bytes()
    if known is not None and digest(content) != known:
        raise ArgumentError("path", "must be the file that the diagram was saved with", str(path))
    return branch_of(content, path)
