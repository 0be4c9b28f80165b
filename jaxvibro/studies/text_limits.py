"""Limits on a text before it is parsed as TOML, as a parser's time grows with the square of a key's depth."""

import re
import tomllib

import numpy as np

from ..scene.check import SceneError, shorten

MAX_BYTES = 1_000_000  # bytes
MAX_DEPTH = 8  # names in a dotted key, and brackets within brackets
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
    """The bytes of a scene file. Raises SceneError where it is too large, OSError where it cannot be read."""
    with open(path, "rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise SceneError(path.name, f"must be at most {MAX_BYTES:,} bytes long", "more")
    return data


def parse_toml(key, text):
    """The tables of a text. Raises SceneError for a key or brackets too deep, ValueError where it is no TOML."""
    text.encode()  # no lone surrogates, as of a command line in another encoding
    stripped_text = _QUOTED.sub(lambda match: "" if match[0].startswith("#") else "s", text)
    if deep_key := _DEEP_KEY.search(stripped_text):
        raise SceneError(key, f"must have keys of at most {MAX_DEPTH} names", shorten(deep_key[0]))
    codes = np.frombuffer(stripped_text.encode(), np.uint8)
    depth = np.cumsum(np.isin(codes, (91, 123)).astype(int) - np.isin(codes, (93, 125)))
    if depth.max(initial=0) > MAX_DEPTH:
        raise SceneError(key, f"must have at most {MAX_DEPTH} brackets within each other", int(depth.max()))
    return tomllib.loads(text)
