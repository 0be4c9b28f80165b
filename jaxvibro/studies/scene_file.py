"""Read, check and write scene files in TOML, of limited size and depth.

Limit the size and depth of a TOML text before parsing. The time of a TOML parser grows with the square of the depth of
a key.
"""

import re
import tomllib
from os import PathLike
from pathlib import Path

import msgspec
import numpy as np
from jax.typing import DTypeLike

from ..output.atomic_files import atomic_file
from ..scene import scene_table
from ..scene.check import ArgumentError, SceneError, check_types, describe_choices, host_only, shorten_text
from ..scene.scene import Scene
from ..scene.scene_table import make_scene_table
from . import schema
from .schema import SceneFile
from .validate import check_scene_file

MAX_BYTES = 1_000_000
MAX_DEPTH = 8  # names in a dotted key, and nested brackets
_QUOTED = re.compile(
    r"""
    \#[^\n]*                                  # a comment
    | \"{3} (?: [^"\\]++ | \\. | "(?!"") )*+ (?: \"{3} | \\?\Z )
    | '{3} (?: [^']++ | '(?!'') )*+ (?: '{3} | \Z )
    | " (?: [^"\\\n]++ | \\[^\n] )*+ "?
    | ' [^'\n]*+ '?
    """,
    re.VERBOSE | re.DOTALL,
)
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){{{MAX_DEPTH}}}")


def read_limited_file(path):
    """Read the bytes of a file; raise SceneError if it is too large, and OSError if it cannot be read."""
    with open(path, "rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise SceneError(path.name, f"must be at most {MAX_BYTES:,} bytes long", "more")
    return content


def parse_limited_toml(error_key, toml_text):
    """Parse a TOML text; raise SceneError for keys or brackets that are nested too deeply.

    Raises ValueError for invalid TOML. `error_key` is the key that the SceneError names.
    """
    toml_text.encode()  # refuses lone surrogates, as from a command line in another encoding
    unquoted_text = _QUOTED.sub(lambda match: "" if match[0].startswith("#") else "s", toml_text)
    if deep_key_match := _DEEP_KEY.search(unquoted_text):
        raise SceneError(error_key, f"must have keys of at most {MAX_DEPTH} names", shorten_text(deep_key_match[0]))
    byte_codes = np.frombuffer(unquoted_text.encode(), np.uint8)
    bracket_depth = np.cumsum(np.isin(byte_codes, (91, 123)).astype(int) - np.isin(byte_codes, (93, 125)))
    if bracket_depth.max(initial=0) > MAX_DEPTH:
        raise SceneError(
            error_key, f"must have at most {MAX_DEPTH} brackets within each other", int(bracket_depth.max())
        )
    return tomllib.loads(toml_text)


_TABLE_TYPES = {
    "": schema.SceneFile,
    "scene": scene_table.SceneTable,
    "scene.left": scene_table.WallTable,
    "scene.right": scene_table.WallTable,
    "scene.left.motion": scene_table.MotionTable,
    "scene.right.motion": scene_table.MotionTable,
    "scene.drive": scene_table.MotionTable,
    "scene.scales": scene_table.ScalesTable,
    "scene.left.law": scene_table.WallLawTable,
    "scene.right.law": scene_table.WallLawTable,
    "sweep": schema.SweepTable,
    "sweep.legs": schema.SweepLegTable,
    "sweep.legs.start": schema.InitialStateTable,
    "attractors": schema.AttractorsTable,
    "orbits": schema.OrbitsTable,
    "branch": schema.BranchTable,
    "branch.start": schema.InitialStateTable,
    "explore": schema.ExploreTable,
    "locus": schema.LocusTable,
    "map": schema.MapTable,
    "map.start": schema.InitialStateTable,
    "spectrum": schema.SpectrumTable,
    "spectrum.start": schema.InitialStateTable,
    "basins": schema.BasinsTable,
    "view": schema.ViewTable,
}
_TYPE_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "object": "a table",
    "array": "a list",
    "bool": "true or false",
}


@check_types
def load_scene(path: str | PathLike[str], dtype: DTypeLike | None = None) -> Scene:
    """Read the scene of a scene file.

    Parameters
    ----------
    path : path-like
        Scene file.
    dtype : dtype, optional
        Floating-point type, as for `make_scene`.

    Returns
    -------
    Scene
        Scene, as returned by `make_scene`.

    Raises
    ------
    SceneError
        If the scene or another table of the file is invalid.
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
    return read_scene_file(path).scene.make(dtype)


@host_only("return the scene")
def save_scene(scene: Scene, path: str | PathLike[str], force: bool = False) -> None:
    """Write a single scene to a scene file.

    `load_scene` then reads the same numbers, bit for bit.

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
        If the scene is a batch, or has a force or a contact law that is not predefined.
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
    write_scene_file(SceneFile(scene=make_scene_table(scene)), path, force)


def read_scene_file(path, changes=()):
    """Read and check the tables of a scene file.

    Parameters
    ----------
    path : path-like
        Scene file.
    changes : sequence of str, optional
        Changes that are applied before the check, each "key=value" as for `apply_change`.

    Returns
    -------
    SceneFile
        Tables of the file.

    Raises
    ------
    SceneError
        If the file or a change is invalid.
    OSError
        If the file cannot be read.
    """
    path = Path(path)
    return parse_scene_file(path.name, read_limited_file(path), changes)


def parse_scene_file(file_name, content, changes=()):
    """Parse and check the content of a scene file.

    Parameters
    ----------
    file_name : str
        Name of the file, for error messages.
    content : bytes
        Content of the file.
    changes : sequence of str, optional
        Changes that are applied before the check, each "key=value" as for `apply_change`.

    Returns
    -------
    SceneFile
        Tables of the file.

    Raises
    ------
    SceneError
        If the content or a change is invalid.
    """
    try:
        plain_tables = parse_limited_toml(file_name, content.decode("utf-8-sig"))
    except ArgumentError:
        raise
    except (ValueError, RecursionError) as error:
        raise SceneError(file_name, "must be a TOML file", str(error)) from None
    for change in changes:
        plain_tables = apply_change(plain_tables, change)
    return parse_tables(plain_tables)


def write_scene_file(file, path, force=False):
    """Write a `SceneFile` to a file; raise FileExistsError if the file exists and `force` is False."""
    toml_bytes = msgspec.toml.encode(file)
    with atomic_file(path, force) as file:
        file.write(toml_bytes)


def apply_change(plain_tables, change):
    """Apply a change, for example "scene.amplitude=3" or "sweep.legs.0.to=1.0", to the tables of a scene file.

    Key and value are TOML. A table is merged with the existing table. Entries of a list are numbered from 0. Raises
    SceneError if the change is not valid TOML. Unknown keys are not detected here but by `parse_tables`.
    """
    change_key = change.split("=")[0].strip() or "change"
    if len(change) > MAX_BYTES:
        raise SceneError(change_key, f"must be at most {MAX_BYTES:,} characters long", "more")
    try:
        change_tables = parse_limited_toml(change_key, change)
    except ArgumentError:
        raise
    except (ValueError, RecursionError):
        change_tables = {}
    if not change_tables:
        raise SceneError(change_key, "must be KEY=VALUE with a TOML value", change)
    return _merge_tables(plain_tables, change_tables)


def _merge_tables(old_tables, new_tables):
    """Return old tables, or lists of tables, with the values of new tables merged into them."""
    if (
        isinstance(old_tables, list)
        and isinstance(new_tables, dict)
        and all(key in map(str, range(len(old_tables))) for key in new_tables)
    ):
        return [
            _merge_tables(old_entry, new_tables[str(index)]) if str(index) in new_tables else old_entry
            for index, old_entry in enumerate(old_tables)
        ]
    if isinstance(old_tables, dict) and isinstance(new_tables, dict):
        return {**old_tables, **{key: _merge_tables(old_tables.get(key), value) for key, value in new_tables.items()}}
    return new_tables


def parse_tables(plain_tables):
    """Convert parsed TOML tables to a valid `SceneFile`; a SceneError names the full dotted key."""
    _refuse_unknown_keys("", "", plain_tables)
    try:
        scene_file = msgspec.convert(plain_tables, SceneFile)
    except msgspec.ValidationError as error:
        raise _validation_error(plain_tables, str(error)) from None
    return check_scene_file(scene_file)


def _refuse_unknown_keys(type_key, table_location, table):
    """Raise SceneError for the first unknown key.

    The later error messages of msgspec then contain no text of the user.
    """
    known_keys = _TABLE_TYPES[type_key].__struct_encode_fields__
    for key_name, value in table.items():
        if key_name not in known_keys:
            raise SceneError(
                _join_dotted_key(table_location, key_name),
                f"is not a key here{describe_choices(key_name, known_keys)}",
                value,
            )
        inner_type_key, inner_location = (
            _join_dotted_key(type_key, key_name),
            _join_dotted_key(table_location, key_name),
        )
        inner_tables = enumerate(value) if isinstance(value, list) else [(None, value)]
        for table_index, inner_table in inner_tables:
            if inner_type_key in _TABLE_TYPES and isinstance(inner_table, dict):
                _refuse_unknown_keys(
                    inner_type_key,
                    inner_location if table_index is None else f"{inner_location}[{table_index}]",
                    inner_table,
                )


def _join_dotted_key(prefix, name):
    """Join a prefix, which may be empty, and a name to a dotted key."""
    return f"{prefix}.{name}" if prefix else name


def _validation_error(plain_tables, message):
    """Convert an error message of msgspec to a SceneError with the dotted key and its value."""
    rule_of_msgspec, location = re.fullmatch(r"(.*?)(?: - at `\$(.*)`)?", message).groups(default="")
    key_path, value, dotted_key = [], plain_tables, ""
    for location_key, entry_number in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", location):
        key = location_key or (
            _find_invalid_key(plain_tables, key_path, value, message) if entry_number == "..." else int(entry_number)
        )
        key_path, value = [*key_path, key], value[key]
        dotted_key = f"{dotted_key}[{key}]" if isinstance(key, int) else _join_dotted_key(dotted_key, key)
    if missing_match := re.search(r"missing required field `(.*)`", rule_of_msgspec):
        return SceneError(_join_dotted_key(dotted_key, missing_match[1]), "must be given", None)
    return SceneError(dotted_key, _rule_in_plain_words(rule_of_msgspec), value)


def _find_invalid_key(plain_tables, key_path, table, message):
    """Return the key of the entry of a table that alone causes the same error message of msgspec.

    `key_path` is the path of the table in the file.
    """
    for entry_key, value in table.items():
        single_entry_tables = {entry_key: value}
        for key_depth in reversed(range(len(key_path))):
            single_entry_tables = {
                **_table_at(plain_tables, key_path[:key_depth]),
                key_path[key_depth]: single_entry_tables,
            }
        try:
            msgspec.convert(single_entry_tables, SceneFile)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return entry_key
    return next(iter(table))


def _table_at(plain_tables, key_path):
    """Return the table at a path of keys."""
    for key in key_path:
        plain_tables = plain_tables[key]
    return plain_tables


def _rule_in_plain_words(rule_of_msgspec):
    """Convert a message of msgspec such as "Expected `int` >= 1" to a rule in plain words."""
    type_match = re.match(r"Expected `(\w+)[^`]*`([^,]*)", rule_of_msgspec)
    if type_match is None:
        return f"must be valid ({rule_of_msgspec})"
    return f"must be {_TYPE_WORDS[type_match[1]]}{type_match[2]}"
