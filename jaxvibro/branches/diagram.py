"""Diagram of the branches of a scene along a parameter."""

import json
import os
import re
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import msgspec
import pandas as pd

from ..output.atomic_files import atomic_file
from ..output.checksums import HEADER_ATTRIBUTES, fill_in_checksum, parse_checked_file, require_known_format, sha256_hex
from ..output.label_codes import translate_label
from ..output.table_text import align_columns, column_header
from ..output.units import unit_in_system, unit_of
from ..problem.curve_ends import rescale_reason_text
from ..scene.check import ArgumentError, host_only, shorten_text
from ..scene.scene import Scene
from ..scene.scene_table import SceneTable, make_scene_table
from .branch import Branch, Special, end_values
from .branch_file import parse_branch
from .branch_tree import is_same_point, originals_of_mirrors

INDEX_FILE = "diagram.json"
BRANCH_FILE_NAME = re.compile(r"branch_\d+(_[0-9a-f]{16})?\.nc")


@dataclass(frozen=True, eq=False)
class Diagram:
    """Branches of periodic orbits of a scene along a parameter.

    Attributes
    ----------
    name : str
        Name of the parameter.
    bounds : tuple of float
        Bounds of the parameter.
    scene : Scene
        The scene.
    branches : tuple of Branch
        Branches in the order in which they were found.
    left : tuple of tuple of int
        Indices (branch, special point) of the points whose emanating branches have been followed.
    complete : bool
        True if no limit ended the exploration.
    reason : str
        Reason for stopping.
    settings : dict
        Largest period, seed and largest step.

    See Also
    --------
    explore : Explore the periodic orbits of a scene along a parameter.

    Examples
    --------
    >>> diagram = jv.explore(scene, "amplitude", (1.8, 2.2), max_period=1, budget=1)
    >>> diagram.complete, diagram.reason
    (False, 'the budget of 1 branches is spent')
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
        """Special points of all branches except ends, without duplicates, sorted by parameter value."""
        return _distinct_special_points(self.branches)

    def points(self, kind: str) -> tuple[Special, ...]:
        """Return the special points of a kind.

        Parameters
        ----------
        kind : str
            Kind, such as ``"PD"``.

        Returns
        -------
        tuple of Special
            Points sorted by parameter value.
        """
        return tuple(special for special in self.special if special.kind == kind)

    def table(self, units: str = "scene", labels: str = "jaxvibro") -> str:
        """Format the branches and the special points.

        A branch and its mirror image share one line, which names both. The line of a closed branch gives the range of
        the parameter.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Unit system. ``"physical"`` needs a scene with scales.
        labels : {"jaxvibro", "auto", "matcont"}, optional
            Names of the kinds, as in `Branch.table`.

        Returns
        -------
        str
            One line per branch, then one line per special point, then the reason for stopping.

        Raises
        ------
        ArgumentError
            If `units` or `labels` is unknown, or the scene has no scales.
        """
        unit, unit_factor = unit_in_system(self.scene, unit_of(self.name), units)
        rows: list[tuple[object, ...]] = [
            ("branch", "orbits", "from", "to", "points", "special", "starts as", "ends as")
        ]
        original_of = originals_of_mirrors(self.branches)
        original_branches = [branch for index, branch in enumerate(self.branches) if index not in original_of]
        numbers_with_mirror = {
            original_index + 1: f"{original_index + 1} (mirror image: {index + 1})"
            for index, original_index in original_of.items()
        }
        for branch_number, branch in (
            (index + 1, branch) for index, branch in enumerate(self.branches) if index not in original_of
        ):
            reason_texts = (
                branch.reasons
                if unit_factor == 1.0
                else [rescale_reason_text(item, unit_factor) for item in branch.reasons]
            )
            first_value, last_value = (f"{item * unit_factor:.9g}" for item in end_values(branch))
            kinds = " ".join(translate_label(item.kind, labels) for item in branch.special if item.kind != "EP")
            orbit_labels = " ".join(dict.fromkeys(segment.label for segment in branch.segments))
            rows.append(
                (
                    numbers_with_mirror.get(branch_number, branch_number),
                    orbit_labels,
                    first_value,
                    last_value,
                    len(branch),
                    kinds or "-",
                    *reason_texts,
                )
            )
        special_rows = [("kind", column_header(self.name, unit, units), "orbit")]
        special_rows += [
            (
                translate_label(special_point.kind, labels),
                f"{special_point.value * unit_factor:.12g}",
                special_point.label,
            )
            for special_point in _distinct_special_points(original_branches)
        ]
        return f"{align_columns(rows)}\n\n{align_columns(special_rows)}\n\n{self.reason}"

    def to_frame(self, units: str = "scene") -> pd.DataFrame:
        """Convert the points of all branches to a pandas DataFrame.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Unit system. ``"physical"`` needs a scene with scales.

        Returns
        -------
        pandas.DataFrame
            Rows as in `Branch.to_frame`, preceded by the number of the branch in the table.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or the scene has no scales.
        """
        return branches_dataframe(self.branches, units)

    def save(self, folder: str | PathLike[str], force: bool = False) -> None:
        """Write the diagram to a folder: one NetCDF file per branch, and an index.

        The names of the branch files contain their checksums. The files of an existing diagram therefore remain valid
        until the index, which is written last, names the new files.

        Parameters
        ----------
        folder : str or path-like
            Folder, from which `load_diagram` reads the diagram.
        force : bool, optional
            True to replace an existing diagram.

        Raises
        ------
        FileExistsError
            If the index already exists and `force` is False.
        """
        folder = Path(folder)
        index_path = folder / INDEX_FILE
        if not force and os.path.lexists(index_path):
            raise FileExistsError(f"{index_path} already exists; force overwrites it")
        folder.mkdir(parents=True, exist_ok=True)
        old_file_names, checksums_by_name = _listed_file_names(index_path), {}
        for branch_number, branch in enumerate(self.branches):
            content = branch.content
            checksum = sha256_hex(content)
            file_name = f"branch_{branch_number:03d}_{checksum[:16]}.nc"
            with atomic_file(folder / file_name, True) as file:
                file.write(content)
            checksums_by_name[file_name] = checksum
        index_fields = {key: getattr(self, key) for key in ("name", "bounds", "left", "complete", "reason", "settings")}
        index_fields |= {
            "scene": msgspec.toml.encode(make_scene_table(self.scene)).decode(),
            "branches": checksums_by_name,
        }
        with atomic_file(index_path, force) as file:
            file.write(fill_in_checksum(json.dumps(HEADER_ATTRIBUTES | index_fields, indent=1).encode()))
        for file_name in old_file_names - set(checksums_by_name):
            (folder / file_name).unlink(missing_ok=True)


def _distinct_special_points(branches):
    """Return the special points of branches except ends, without duplicates, sorted by value."""
    distinct_points: list[Special] = []
    for special in (special for branch in branches for special in branch.special if special.kind != "EP"):
        if not any(is_same_point(special, known_point) for known_point in distinct_points):
            distinct_points.append(special)
    return tuple(sorted(distinct_points, key=lambda special: special.value))


def branches_dataframe(branches, units):
    """Concatenate the points of branches in a pandas DataFrame, with branch numbers from 1."""
    frames = [branch.to_frame(units) for branch in branches]
    for branch_number, branch_frame in enumerate(frames, 1):
        branch_frame.insert(0, "branch", branch_number)
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame({"branch": []})


class DiagramIndex(msgspec.Struct):
    """Index of a diagram's folder.

    Attributes
    ----------
    name, bounds, left, complete, reason, settings
        As in `Diagram`.
    branches : dict of str to str, or list of str
        SHA-256 sum of each branch file, by file name. A list of file names in format 1.
    scene : str or None
        Scene as TOML text, None in format 1.
    format : int
        Version of the file format.
    """

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
    """Read a diagram from a folder that `Diagram.save` wrote.

    A folder of an older version, without checksums, is read with a warning.

    Parameters
    ----------
    folder : str or path-like
        Folder.

    Returns
    -------
    Diagram
        The diagram.

    Raises
    ------
    ArgumentError
        If the folder contains no diagram, or a file is damaged.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> diagram = jv.explore(scene, "amplitude", (1.8, 2.2), max_period=1, budget=1)
    >>> folder = tempfile.mkdtemp()
    >>> diagram.save(folder)
    >>> len(jv.load_diagram(folder))
    1
    """
    index_path = Path(folder) / INDEX_FILE
    diagram_index = parse_checked_file(index_path, _parse_index)
    checksums_by_name = (
        diagram_index.branches if isinstance(diagram_index.branches, dict) else dict.fromkeys(diagram_index.branches)
    )
    branches = tuple(_load_branch(index_path.with_name(name), checksum) for name, checksum in checksums_by_name.items())
    try:
        scene = (
            branches[0].scene
            if diagram_index.scene is None
            else msgspec.toml.decode(diagram_index.scene, type=SceneTable).make()
        )
        processed_indices = tuple(
            (branch_index, point_index)
            for branch_index, point_index in diagram_index.left
            if branches[branch_index].special[point_index]
        )
        has_same_parameter = all(branch.name == diagram_index.name for branch in branches)
    except (LookupError, ValueError) as error:
        raise _invalid_folder_error(error, index_path) from None
    if (
        not has_same_parameter
        or min((index for index_pair in processed_indices for index in index_pair), default=0) < 0
    ):
        raise _invalid_folder_error("its branches have another parameter", index_path)
    return Diagram(
        diagram_index.name,
        diagram_index.bounds,
        scene,
        branches,
        processed_indices,
        diagram_index.complete,
        diagram_index.reason,
        diagram_index.settings,
    )


def _parse_index(content, path):
    try:
        diagram_index = msgspec.convert(json.loads(content), DiagramIndex)
    except (ValueError, RecursionError) as error:
        raise _invalid_folder_error(error, path) from None
    require_known_format(diagram_index.format, path)
    if not all(map(BRANCH_FILE_NAME.fullmatch, diagram_index.branches)):
        raise _invalid_folder_error("it names files that are not branch files", path)
    return diagram_index


def _invalid_folder_error(reason, path):
    return ArgumentError(
        "folder", f"must be a folder that Diagram.save wrote ({shorten_text(reason)})", str(path.parent)
    )


def _listed_file_names(index_path):
    """Return the branch files that an index names, empty if the index cannot be read."""
    try:
        return set(_parse_index(index_path.read_bytes(), index_path).branches)
    except (OSError, ArgumentError):
        return set()


def _load_branch(path, checksum):
    content = path.read_bytes()
    if checksum is not None and sha256_hex(content) != checksum:
        raise ArgumentError("path", "must be the file that the diagram was saved with", str(path))
    return parse_branch(content, path)
