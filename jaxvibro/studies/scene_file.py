"""Scene files: TOML in, strictly, and TOML out."""

import re
from os import PathLike
from pathlib import Path

import msgspec
from jax.typing import DTypeLike

from ..output.atomic_write import whole
from ..scene import scene_table
from ..scene.check import ArgumentError, SceneError, among, host, typed
from ..scene.scene import Scene
from ..scene.scene_table import table_of
from . import schema
from .schema import SceneFile
from .text_limits import LARGEST, content, parsed
from .validate import checked

_KINDS = {
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
_WORDS = {"float": "a number", "int": "a whole number", "str": "a text", "object": "a table", "array": "a list"}


@typed
def load_scene(path: str | PathLike[str], dtype: DTypeLike | None = None) -> Scene:
    """The scene of a scene file, as `make_scene` would make it (dtype as there).

    Raises SceneError on the first thing in the file that breaks a rule, be it in the scene or in what else the file
    asks for, and OSError where the file cannot be read.
    """
    return read(path).scene.make(dtype)


@host("return the scene")
def save_scene(scene: Scene, path: str | PathLike[str], force: bool = False) -> None:
    """Write a single scene to a scene file, from which `load_scene` reads the same numbers bit for bit.

    Raises SceneError for a batch, FileExistsError where the file is there already, unless force is given.
    """
    dump(SceneFile(scene=table_of(scene)), path, force)


def read(path, changes=()):
    """A scene file's tables, checked, as a `SceneFile`; changes, each "key=value" as in `apply`, go in first.

    Raises SceneError and OSError as `load_scene` does.
    """
    path = Path(path)
    return of_content(path.name, content(path), changes)


def of_content(name, content, changes=()):
    """The same of the bytes of a file of this name."""
    try:
        found = parsed(name, content.decode("utf-8-sig"))
    except ArgumentError:
        raise
    except (ValueError, RecursionError) as error:
        raise SceneError(name, "must be a TOML file", str(error)) from None
    for change in changes:
        found = apply(found, change)
    return understood(found)


def dump(file, path, force=False):
    """Write a `SceneFile` to a file, whole or not at all. Raises FileExistsError unless force is given."""
    text = msgspec.toml.encode(file)
    with whole(path, force) as file:
        file.write(text)


def apply(found, change):
    """The plain tables of a scene file with one change put in, such as "scene.amplitude=3" or "sweep.legs.0.to=1.0".

    Key and value are TOML; a table is merged with the one that stands there, a list's entries go by number from 0.
    Raises SceneError where the change is no TOML; a key that no scene file has is refused by `understood`.
    """
    key = change.split("=")[0].strip() or "change"
    if len(change) > LARGEST:
        raise SceneError(key, f"must be at most {LARGEST:,} characters long", "more")
    try:
        new = parsed(key, change)
    except ArgumentError:
        raise
    except (ValueError, RecursionError):
        new = {}
    if not new:
        raise SceneError(key, "must be KEY=VALUE, the value as in TOML", change)
    return _merged(found, new)


def _merged(old, new):
    if isinstance(old, list) and isinstance(new, dict) and all(key in map(str, range(len(old))) for key in new):
        return [_merged(entry, new[str(place)]) if str(place) in new else entry for place, entry in enumerate(old)]
    if isinstance(old, dict) and isinstance(new, dict):
        return {**old, **{key: _merged(old.get(key), value) for key, value in new.items()}}
    return new


def understood(found):
    """Plain tables as a checked `SceneFile`. Raises SceneError naming the key, dotted from the top."""
    _refuse_unknown("", "", found)
    try:
        file = msgspec.convert(found, SceneFile)
    except msgspec.ValidationError as error:
        raise _told(found, str(error)) from None
    return checked(file)


def _refuse_unknown(kind, place, table):
    """Refuse the first key that its table may not have; after that msgspec's complaints hold no text of the user's."""
    names = _KINDS[kind].__struct_encode_fields__
    for name, value in table.items():
        if name not in names:
            raise SceneError(_joined(place, name), f"is not a key here{among(name, names)}", value)
        below, there = _joined(kind, name), _joined(place, name)
        entries = enumerate(value) if isinstance(value, list) else [(None, value)]
        for number, entry in entries:
            if below in _KINDS and isinstance(entry, dict):
                _refuse_unknown(below, there if number is None else f"{there}[{number}]", entry)


def _joined(path, name):
    return f"{path}.{name}" if path else name


def _told(found, message):
    """msgspec's complaint as a SceneError: it names the place; the value there is looked up."""
    complaint, place = re.fullmatch(r"(.*?)(?: - at `\$(.*)`)?", message).groups(default="")
    parts, value, path = [], found, ""
    for name, number in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", place):
        part = name or (_entry(found, parts, value, message) if number == "..." else int(number))
        parts, value = [*parts, part], value[part]
        path = f"{path}[{part}]" if isinstance(part, int) else _joined(path, part)
    if missing := re.search(r"missing required field `(.*)`", complaint):
        return SceneError(_joined(path, missing[1]), "must be given", None)
    return SceneError(path, _rule(complaint), value)


def _entry(found, parts, table, message):
    """The key, below some others, of the entry that msgspec complains of but does not name: alone it is the same."""
    for name, value in table.items():
        alone = {name: value}
        for depth in reversed(range(len(parts))):
            alone = {**_below(found, parts[:depth]), parts[depth]: alone}
        try:
            msgspec.convert(alone, SceneFile)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return name
    return next(iter(table))


def _below(found, parts):
    for part in parts:
        found = found[part]
    return found


def _rule(complaint):
    """ "Expected `int` >= 1" in plain words."""
    expected = re.match(r"Expected `(\w+)[^`]*`([^,]*)", complaint)
    if expected is None:
        return f"must be valid ({complaint})"
    return f"must be {_WORDS[expected[1]]}{expected[2]}"
