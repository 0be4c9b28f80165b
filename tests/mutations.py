"""Hostile scene files and changes, drawn at random: deep, long, of other encodings, with bytes and words exchanged."""

import re

WORDS = re.compile(rb"[A-Za-z_.]+|-?\d[\d.e+-]*|[\[\]{}=,\"']|\s+|#")
ODD = [b"nan", b"-inf", b"1e400", b"-0.0", b"5e-324", b"9" * 400, b"0x" + b"f" * 300, b"1_0", b"true", b"''", b'"""']
ODD += [b"{}", b"[]", b"[[1.0]]", b"1979-05-27", b"\\u0000", b"\x00", b"\xff", "\u202e\u00e9".encode(), b"$x_$", b"\n"]
ODD += [b"1e308", b"-1", b"0", b"1000000", b"1000", b"32", b"hardness", b"left.motion.phase", b"stiffness = 1e9\n"]
THINGS = ["#", " ", "\n", "a = 1\n", "[[sweep.legs]]\n", "[a]\n", '"', "'", "\\", "a.", "[", "0", "a", '"""\\', "="]
THINGS += ["a{k} = 1\n"]
BEGUN = ["", "x = ", 'x = "', "x = '''", "x = [", "[attractors.at]\n", "x = 0x"]
LETTERS = [*"abc.=[]{}'\"#\\ \n\t0123-+e_\x00\u00e9\udc80", "scene", "sweep", "legs", "true", "=", "="]
CODES = ("utf-8-sig", "utf-16", "utf-16-be", "utf-32", "latin-1", "cp037", "utf-7")
LARGE = 1_000_000
CHANGES = ["scene.amplitude=3", "sweep.count=11", "attractors.at.damping=0.1", "sweep.legs.0.to=1", "branch.at={}", "x"]


def one_of(values, draw):
    return values[draw.integers(len(values))]


def mutate(kind, content, draw, changes):
    """Return a content and changes, of which one is mutated in the way of a kind."""
    given = [one_of(changes, draw)] if draw.random() < 0.3 else []
    content, more = KINDS[kind](content, draw)
    return content, given + more


def _bytes(content, draw):
    """A few bytes put in, left out or exchanged."""
    content = bytearray(content)
    for _ in range(draw.integers(1, 9)):
        place = draw.integers(len(content))
        content[place : place + draw.integers(3)] = bytes(draw.integers(0, 256, draw.integers(3)).tolist())
    return bytes(content), []


def _words(content, draw):
    """Some words exchanged for others of the file, or for odd ones."""
    parts = WORDS.findall(content)
    for _ in range(draw.integers(1, 6)):
        other = one_of(ODD if draw.random() < 0.6 else parts, draw)
        parts[draw.integers(len(parts))] = other
    return b"".join(parts), []


def _numbers(content, draw):
    """A number exchanged for one of another size."""
    places = list(re.finditer(rb"-?\d+(\.\d+)?", content))
    one = one_of(places, draw)
    size = 10.0 ** draw.uniform(-320.0, 308.0) * draw.choice([-1.0, 1.0])
    other = repr(size) if draw.random() < 0.5 else str(int(10.0 ** draw.uniform(0.0, 25.0)))
    return content[: one.start()] + other.encode() + content[one.end() :], []


def _lines(content, draw):
    """Lines doubled, left out or in another order."""
    lines = content.split(b"\n")
    for _ in range(draw.integers(1, 5)):
        one, two = draw.integers(len(lines), size=2)
        lines[one : one + draw.integers(2)] = [lines[two]]
    return b"\n".join(lines), []


def _deep(content, draw):
    """A key or a value nested up to a hundred thousand deep, in the file or in a change."""
    depth = int(10.0 ** draw.uniform(0.0, 5.0))
    name = one_of(["a", "scene", '"b"', "left", "at", "0"], draw)
    write = one_of(
        [
            lambda: ".".join([name] * depth) + " = 1",
            lambda: "[" + ".".join([name] * depth) + "]",
            lambda: f"{name} = " + "[" * depth + "]" * depth,
            lambda: "attractors.at = " + f"{{{name} = " * depth + "1" + "}" * depth,
            lambda: "scene.left." + " . ".join([name] * depth) + "=1",
            lambda: f"{name} = " + "[{a=" * depth,
        ],
        draw,
    )
    return (content, [write()]) if draw.random() < 0.5 else (content + b"\n" + write().encode() + b"\n", [])


def _long(content, draw):
    """As much of one thing as goes into a megabyte, or more."""
    size, thing = int(draw.choice([0.02, 0.1, 0.9, 1.1], p=[0.7, 0.2, 0.05, 0.05]) * LARGE), one_of(THINGS, draw)
    text = "".join(thing.replace("{k}", str(k)) for k in range(size // len(thing)))
    return one_of([b"", content + b"\n"], draw) + (one_of(BEGUN, draw) + text).encode(), []


def _values(content, draw):
    """A list or table of many entries where a study has few."""
    count = int(10.0 ** draw.uniform(0.0, 4.3))
    leg = "{{name='{}', from=1, to=2, start={{x=0, v=0}}}},"
    write = one_of(
        [
            lambda: "sweep.legs = [" + leg.format("a") * count + "]",
            lambda: "sweep.legs = [" + "".join(leg.format(k) for k in range(count)) + "]",
            lambda: "attractors.at = {" + ",".join(f"a{k} = 1.0" for k in range(count)) + ", b = 'c'}",
            lambda: "panels = {amplitude = [" + "1.0," * count + "]}",
            lambda: "panels = {" + ",".join(f"a{k} = [1.0]" for k in range(count)) + "}",
            lambda: f"scene.left.motion = {{amplitude = 0.1, harmonic = {count}}}",
            lambda: f"sweep.count = {count}",
            lambda: f"'{'a' * count}' = 1",
            lambda: f"sweep.parameter = '{'b' * count}'",
            lambda: "c" * count,
            lambda: "scene = 1" + "0" * count,
            lambda: "scene.amplitude = [" + "1.0," * count + "]",
            lambda: f"scene.damping = '{'b' * 50 * count}'",
        ],
        draw,
    )
    return content, [write()]


def _codes(content, draw):
    """Another encoding, or a byte order mark."""
    return content.decode().encode(one_of(CODES, draw), "replace"), []


def _change(content, draw):
    """A change as by --set of random characters."""
    changes = ["".join(one_of(LETTERS, draw) for _ in range(draw.integers(1, 30))) for _ in range(draw.integers(1, 4))]
    return content, changes


def _cut(content, draw):
    return content[: draw.integers(len(content))], []


KINDS = {
    "bytes": _bytes,
    "words": _words,
    "numbers": _numbers,
    "lines": _lines,
    "deep": _deep,
    "long": _long,
    "values": _values,
    "encodings": _codes,
    "changes": _change,
    "cut": _cut,
}
