"""A whole diagram: the branches of a scene along a parameter, with what tells how far it was explored."""

import json
import os
import re
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import msgspec
import pandas as pd

from ..output.atomic_write import atomic_file
from ..output.checksums import HEADER_ATTRIBUTES, read_checked, require_format, seal, sha256_hex
from ..output.labels import translate_label
from ..output.table_text import align_columns, column_header
from ..output.units import unit_in_system, unit_of
from ..problem.end import rescale_reason
from ..scene.check import ArgumentError, host_only, shorten
from ..scene.scene import Scene
from ..scene.scene_table import SceneTable, make_scene_table
from .branch import Branch, Special, end_values
from .branch_file import parse_branch
from .branch_tree import is_same_point, mirror_images

INDEX_FILE = "diagram.json"
BRANCH_FILE_NAME = re.compile(r"branch_\d+(_[0-9a-f]{16})?\.nc")  # of a branch's file


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
        return _distinct_points(self.branches)

    def points(self, kind: str) -> tuple[Special, ...]:
        """The special points of a kind."""
        return tuple(special for special in self.special if special.kind == kind)

    def table(self, units: str = "scene", labels: str = "jaxvibro") -> str:
        """The branches, then the special points, as a text, a line each. units, labels: as in `Branch.table`.

        A branch and its mirror image are one line, which names both. Of a closed branch the line has the range.

        Raises ArgumentError for other units and labels, and where the scene has no scales.
        """
        unit, factor = unit_in_system(self.scene, unit_of(self.name), units)
        rows: list[tuple[object, ...]] = [
            ("branch", "orbits", "from", "to", "points", "special", "starts as", "ends as")
        ]
        original_of = mirror_images(self.branches)
        shown_branches = [entry for index, entry in enumerate(self.branches) if index not in original_of]
        number_texts = {
            original_index + 1: f"{original_index + 1} (mirror image: {index + 1})"
            for index, original_index in original_of.items()
        }
        for number, entry in (
            (index + 1, entry) for index, entry in enumerate(self.branches) if index not in original_of
        ):
            reason_texts = entry.reasons if factor == 1.0 else [rescale_reason(item, factor) for item in entry.reasons]
            first_value, last_value = (f"{item * factor:.9g}" for item in end_values(entry))
            kinds = " ".join(translate_label(item.kind, labels) for item in entry.special if item.kind != "EP")
            orbit_labels = " ".join(dict.fromkeys(segment.label for segment in entry.segments))
            rows.append(
                (
                    number_texts.get(number, number),
                    orbit_labels,
                    first_value,
                    last_value,
                    len(entry),
                    kinds or "-",
                    *reason_texts,
                )
            )
        point_rows = [("kind", column_header(self.name, unit, units), "orbit")]
        point_rows += [
            (translate_label(entry.kind, labels), f"{entry.value * factor:.12g}", entry.label)
            for entry in _distinct_points(shown_branches)
        ]
        return f"{align_columns(rows)}\n\n{align_columns(point_rows)}\n\n{self.reason}"

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """All branches' points, a pandas.DataFrame as `Branch.to_frame` gives it, before it the branch's number in the
        table. Raises ArgumentError for other units, and where the scene has no scales."""
        return branches_dataframe(self.branches, units)

    def save(self, folder: str | PathLike[str], force: bool = False) -> None:
        """Write the diagram into a folder, a NetCDF file a branch and an index; `load_diagram` reads the same numbers.

        The branches' files bear their checksums in their names, so that those of a diagram that is there already stay
        as they are until the index, written last, names the new ones. Raises FileExistsError where the index is there
        already, unless force is given.
        """
        folder = Path(folder)
        index_path = folder / INDEX_FILE
        if not force and os.path.lexists(index_path):
            raise FileExistsError(f"{index_path} is there already")
        folder.mkdir(parents=True, exist_ok=True)
        old_files, files = _listed_files(index_path), {}
        for number, branch in enumerate(self.branches):
            content = branch.content
            checksum = sha256_hex(content)
            name = f"branch_{number:03d}_{checksum[:16]}.nc"
            with atomic_file(folder / name, True) as file:
                file.write(content)
            files[name] = checksum
        index_fields = {key: getattr(self, key) for key in ("name", "bounds", "left", "complete", "reason", "settings")}
        index_fields |= {"scene": msgspec.toml.encode(make_scene_table(self.scene)).decode(), "branches": files}
        with atomic_file(index_path, force) as file:
            file.write(seal(json.dumps(HEADER_ATTRIBUTES | index_fields, indent=1).encode()))
        for name in old_files - set(files):
            (folder / name).unlink(missing_ok=True)


def _distinct_points(branches):
    """The special points of branches, but for ends, each orbit once, by value."""
    distinct_points: list[Special] = []
    for special in (special for branch in branches for special in branch.special if special.kind != "EP"):
        if not any(is_same_point(special, known_point) for known_point in distinct_points):
            distinct_points.append(special)
    return tuple(sorted(distinct_points, key=lambda special: special.value))


def branches_dataframe(branches, units):
    """The points of branches behind one another, a pandas.DataFrame, with their numbers from 1."""
    frames = [branch.to_frame(units) for branch in branches]
    for number, branch_frame in enumerate(frames, 1):
        branch_frame.insert(0, "branch", number)
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame({"branch": []})


class DiagramIndex(msgspec.Struct):
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


@host_only("use what was loaded before")
def load_diagram(folder: str | PathLike[str]) -> Diagram:
    """The `Diagram` of a folder that `Diagram.save` wrote.

    A folder of before, without checksums, is read with a warning. Raises ArgumentError where the folder holds none or a
    file is damaged, OSError where one cannot be read.
    """
    path = Path(folder) / INDEX_FILE
    index = read_checked(path, _parse_index)
    digests = index.branches if isinstance(index.branches, dict) else dict.fromkeys(index.branches)
    branches = tuple(_load_branch(path.with_name(name), checksum) for name, checksum in digests.items())
    try:
        scene = branches[0].scene if index.scene is None else msgspec.toml.decode(index.scene, type=SceneTable).make()
        finished_points = tuple(
            (branch_index, point_index)
            for branch_index, point_index in index.left
            if branches[branch_index].special[point_index]
        )
        has_same_name = all(entry.name == index.name for entry in branches)
    except (LookupError, ValueError) as error:
        raise _folder_error(error, path) from None
    if not has_same_name or min((entry for pair in finished_points for entry in pair), default=0) < 0:
        raise _folder_error("its branches are another's", path)
    return Diagram(
        index.name, index.bounds, scene, branches, finished_points, index.complete, index.reason, index.settings
    )


def _parse_index(content, path):
    try:
        index = msgspec.convert(json.loads(content), DiagramIndex)
    except (ValueError, RecursionError) as error:
        raise _folder_error(error, path) from None
    require_format(index.format, path)
    if not all(map(BRANCH_FILE_NAME.fullmatch, index.branches)):
        raise _folder_error("it names files that are no branches'", path)
    return index


def _folder_error(error, path):
    return ArgumentError("folder", f"must be a folder of Diagram.save ({shorten(error)})", str(path.parent))


def _listed_files(index):
    """The files of branches that an index names, none where there is none that can be read."""
    try:
        return set(_parse_index(index.read_bytes(), index).branches)
    except (OSError, ArgumentError):
        return set()


def _load_branch(path, checksum):
    content = path.read_bytes()
    if checksum is not None and sha256_hex(content) != checksum:
        raise ArgumentError("path", "must be the file that the diagram was saved with", str(path))
    return parse_branch(content, path)
