"""Limit a text before TOML parsing, because the time of a parser grows with the square of the depth of a key."""

import re
import tomllib

import numpy as np

from ..scene.check import SceneError, shorten

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


def read_content(path):
    """Read the bytes of a scene file; raise SceneError if it is too large, OSError if it cannot be read."""
    with open(path, "rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise SceneError(path.name, f"must be at most {MAX_BYTES:,} bytes long", "more")
    return data


def parse_toml(key, text):
    """Parse a TOML text; raise SceneError for keys or brackets that are too deep, ValueError for invalid TOML."""
    text.encode()  # refuses lone surrogates, as from a command line in another encoding
    stripped_text = _QUOTED.sub(lambda match: "" if match[0].startswith("#") else "s", text)
    if deep_key := _DEEP_KEY.search(stripped_text):
        raise SceneError(key, f"must have keys of at most {MAX_DEPTH} names", shorten(deep_key[0]))
    codes = np.frombuffer(stripped_text.encode(), np.uint8)
    depth = np.cumsum(np.isin(codes, (91, 123)).astype(int) - np.isin(codes, (93, 125)))
    if depth.max(initial=0) > MAX_DEPTH:
        raise SceneError(key, f"must have at most {MAX_DEPTH} brackets within each other", int(depth.max()))
    return tomllib.loads(text)
