"""Read and write scene files in TOML, with strict rules."""

import re
from os import PathLike
from pathlib import Path

import msgspec
from jax.typing import DTypeLike

from ..output.atomic_write import atomic_file
from ..scene import scene_table
from ..scene.check import ArgumentError, SceneError, check_types, describe_choices, host_only
from ..scene.scene import Scene
from ..scene.scene_table import make_scene_table
from . import schema
from .schema import SceneFile
from .text_limits import MAX_BYTES, parse_toml, read_content
from .validate import check_scene_file

_TABLE_TYPES = {
    "": schema.SceneFile,
    "scene": scene_table.SceneTable,
    "scene.left": scene_table.WallTable,
    "scene.right": scene_table.WallTable,
    "scene.left.motion": scene_table.MotionTable,
    "scene.right.motion": scene_table.MotionTable,
    "scene.drive": scene_table.MotionTable,
    "scene.scales": scene_table.ScalesTable,
    "scene.left.law": scene_table.PushTable,
    "scene.right.law": scene_table.PushTable,
    "sweep": schema.SweepTable,
    "sweep.legs": schema.LegTable,
    "sweep.legs.start": schema.StartTable,
    "attractors": schema.AttractorsTable,
    "orbits": schema.OrbitsTable,
    "branch": schema.BranchTable,
    "branch.start": schema.StartTable,
    "explore": schema.ExploreTable,
    "locus": schema.LocusTable,
    "map": schema.MapTable,
    "map.start": schema.StartTable,
    "spectrum": schema.SpectrumTable,
    "spectrum.start": schema.StartTable,
    "basins": schema.BasinsTable,
    "view": schema.ViewTable,
}
_TYPE_WORDS = {"float": "a number", "int": "a whole number", "str": "a text", "object": "a table", "array": "a list"}


@check_types
def load_scene(path: str | PathLike[str], dtype: DTypeLike | None = None) -> Scene:
    """Read the scene of a scene file.

    Parameters
    ----------
    path : path-like
        Scene file.
    dtype : dtype, optional
        Floating-point type, as in `make_scene`.

    Returns
    -------
    Scene
        The scene, as `make_scene` makes it.

    Raises
    ------
    SceneError
        If anything in the file breaks a rule, in the scene or in another table.
    OSError
        If the file cannot be read.

    See Also
    --------
    save_scene : Write a scene to a scene file.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> path = mkdtemp() + "/driven.toml"
    >>> jv.save_scene(scene, path)
    >>> float(jv.load_scene(path).frequency)
    2.1
    """
    return read(path).scene.make(dtype)


@host_only("return the scene")
def save_scene(scene: Scene, path: str | PathLike[str], force: bool = False) -> None:
    """Write a single scene to a scene file.

    `load_scene` reads the same numbers from it, bit for bit.

    Parameters
    ----------
    scene : Scene
        Single scene.
    path : path-like
        Scene file.
    force : bool, optional
        Overwrite an existing file.

    Raises
    ------
    ArgumentError
        If the scene is a batch, or its force or a contact law is not predefined.
    FileExistsError
        If the file exists and `force` is False.

    See Also
    --------
    load_scene : Read the scene of a scene file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "driven.toml"
    >>> jv.save_scene(scene, path)
    >>> path.read_text().splitlines()[1]
    'amplitude = 2.0'
    """
    dump(SceneFile(scene=make_scene_table(scene)), path, force)


def read(path, changes=()):
    """Read and check the tables of a scene file.

    Parameters
    ----------
    path : path-like
        Scene file.
    changes : sequence of str, optional
        Changes, each "key=value" as in `apply_change`, which are made before the check.

    Returns
    -------
    SceneFile
        The tables.

    Raises
    ------
    SceneError
        If the file or a change breaks a rule.
    OSError
        If the file cannot be read.
    """
    path = Path(path)
    return parse_content(path.name, read_content(path), changes)


def parse_content(name, content, changes=()):
    """Parse and check the content of a scene file.

    Parameters
    ----------
    name : str
        Name of the file, for messages.
    content : bytes
        Content of the file.
    changes : sequence of str, optional
        Changes, each "key=value" as in `apply_change`, which are made before the check.

    Returns
    -------
    SceneFile
        The tables.

    Raises
    ------
    SceneError
        If the content or a change breaks a rule.
    """
    try:
        tables = parse_toml(name, content.decode("utf-8-sig"))
    except ArgumentError:
        raise
    except (ValueError, RecursionError) as error:
        raise SceneError(name, "must be a TOML file", str(error)) from None
    for change in changes:
        tables = apply_change(tables, change)
    return parse_tables(tables)


def dump(file, path, force=False):
    """Write a `SceneFile` completely or not at all; raise FileExistsError for an existing file without `force`."""
    text = msgspec.toml.encode(file)
    with atomic_file(path, force) as file:
        file.write(text)


def apply_change(tables, change):
    """Return the plain tables of a scene file with one change, such as "scene.amplitude=3" or "sweep.legs.0.to=1.0".

    Key and value are TOML. A table is merged with the existing one. Entries of a list are numbered from 0. Raises
    SceneError if the change is not TOML; `parse_tables` refuses unknown keys.
    """
    key = change.split("=")[0].strip() or "change"
    if len(change) > MAX_BYTES:
        raise SceneError(key, f"must be at most {MAX_BYTES:,} characters long", "more")
    try:
        change_tables = parse_toml(key, change)
    except ArgumentError:
        raise
    except (ValueError, RecursionError):
        change_tables = {}
    if not change_tables:
        raise SceneError(key, "must be KEY=VALUE with a TOML value", change)
    return _merge_tables(tables, change_tables)


def _merge_tables(old, new):
    """Return old tables, or lists of them, with the values of new ones."""
    if isinstance(old, list) and isinstance(new, dict) and all(key in map(str, range(len(old))) for key in new):
        return [
            _merge_tables(entry, new[str(index)]) if str(index) in new else entry for index, entry in enumerate(old)
        ]
    if isinstance(old, dict) and isinstance(new, dict):
        return {**old, **{key: _merge_tables(old.get(key), value) for key, value in new.items()}}
    return new


def parse_tables(tables):
    """Convert plain tables to a checked `SceneFile`; a SceneError names the key, dotted from the top."""
    _refuse_unknown("", "", tables)
    try:
        file = msgspec.convert(tables, SceneFile)
    except msgspec.ValidationError as error:
        raise _validation_error(tables, str(error)) from None
    return check_scene_file(file)


def _refuse_unknown(table_key, location, table):
    """Refuse the first unknown key; msgspec's messages then contain no text of the user's."""
    names = _TABLE_TYPES[table_key].__struct_encode_fields__
    for name, value in table.items():
        if name not in names:
            raise SceneError(_join_key(location, name), f"is not a key here{describe_choices(name, names)}", value)
        inner_key, inner_location = _join_key(table_key, name), _join_key(location, name)
        entries = enumerate(value) if isinstance(value, list) else [(None, value)]
        for index, entry in entries:
            if inner_key in _TABLE_TYPES and isinstance(entry, dict):
                _refuse_unknown(inner_key, inner_location if index is None else f"{inner_location}[{index}]", entry)


def _join_key(prefix, name):
    """Return a dotted key."""
    return f"{prefix}.{name}" if prefix else name


def _validation_error(tables, message):
    """Convert msgspec's message, which names the location, to a SceneError with the value there."""
    complaint, location = re.fullmatch(r"(.*?)(?: - at `\$(.*)`)?", message).groups(default="")
    keys, value, path = [], tables, ""
    for name, number in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", location):
        key = name or (_invalid_entry(tables, keys, value, message) if number == "..." else int(number))
        keys, value = [*keys, key], value[key]
        path = f"{path}[{key}]" if isinstance(key, int) else _join_key(path, key)
    if missing_field := re.search(r"missing required field `(.*)`", complaint):
        return SceneError(_join_key(path, missing_field[1]), "must be given", None)
    return SceneError(path, _plain_rule(complaint), value)


def _invalid_entry(tables, keys, table, message):
    """Return the key of the entry, below some others, for which msgspec gives the same message alone."""
    for name, value in table.items():
        single_entry = {name: value}
        for depth in reversed(range(len(keys))):
            single_entry = {**_table_at(tables, keys[:depth]), keys[depth]: single_entry}
        try:
            msgspec.convert(single_entry, SceneFile)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return name
    return next(iter(table))


def _table_at(tables, keys):
    """Return the table below some keys."""
    for key in keys:
        tables = tables[key]
    return tables


def _plain_rule(complaint):
    """Convert "Expected `int` >= 1" to a rule in plain words."""
    match = re.match(r"Expected `(\w+)[^`]*`([^,]*)", complaint)
    if match is None:
        return f"must be valid ({complaint})"
    return f"must be {_TYPE_WORDS[match[1]]}{match[2]}"
