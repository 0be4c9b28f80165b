"""Limit the size and depth of a TOML text before parsing.

The time of a TOML parser grows with the square of the depth of a key.
"""

import re
import tomllib

import numpy as np

from ..scene.check import SceneError, shorten_text

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
