"""Limits on a text before it is parsed as TOML, as a parser's time grows with the square of a key's depth."""

import re
import tomllib

import numpy as np

from ..scene.check import SceneError, short

LARGEST = 1_000_000  # bytes
DEEPEST = 8  # names in a dotted key, and brackets within brackets
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
_DEEP = re.compile(rf"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){{{DEEPEST}}}")


def content(path):
    """The bytes of a scene file. Raises SceneError where it is too large, OSError where it cannot be read."""
    with open(path, "rb") as file:
        found = file.read(LARGEST + 1)
    if len(found) > LARGEST:
        raise SceneError(path.name, f"must be at most {LARGEST:,} bytes long", "more")
    return found


def parsed(key, text):
    """The tables of a text. Raises SceneError for a key or brackets too deep, ValueError where it is no TOML."""
    text.encode()  # no lone surrogates, as of a command line in another encoding
    plain = _QUOTED.sub(lambda found: "" if found[0].startswith("#") else "s", text)
    if deep := _DEEP.search(plain):
        raise SceneError(key, f"must have keys of at most {DEEPEST} names", short(deep[0]))
    codes = np.frombuffer(plain.encode(), np.uint8)
    depth = np.cumsum(np.isin(codes, (91, 123)).astype(int) - np.isin(codes, (93, 125)))
    if depth.max(initial=0) > DEEPEST:
        raise SceneError(key, f"must have at most {DEEPEST} brackets within each other", int(depth.max()))
    return tomllib.loads(text)
