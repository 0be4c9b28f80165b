"""Messages and requests that no page sends: `python -m tests.explorer_fuzz COUNT` sends so many to a session.

Every message must be answered, whatever it holds, and the session must go on.
"""

import json
import os
import random
import sys
import time

import msgspec

from jaxvibro.explorer import messages
from jaxvibro.scene.check import ArgumentError

NUMBERS = [
    0,
    -0.0,
    1,
    -1,
    0.5,
    2.1,
    1e-320,
    1e-16,
    1e16,
    1e100,
    -1e100,
    1e300,
    1e308,
    -1e308,
    2**53 + 1,
    -(2**63),
    2**70,
]
WORDS = [
    *("", "amplitude", "frequency", "left.position", "restitution", "scene_1", "branch_1", "branch_1.special[0]"),
    *(
        "branch_1.special[999999]",
        "branch_1[3]",
        "orbit_1",
        "x",
        "v",
        "speed",
        "impact",
        "__class__",
        "a" * 201,
        "\x00",
    ),
    *(
        "\u4e00",
        "'); drop",
        "branch_1.branches[0]",
        "../..",
        "nan",
        "[scene]",
        "[scene]\namplitude = 1e308\n",
        "\ufffd",
    ),
]
PANELS = ["diagram", "plane", "portrait", "trace", "door"]
CHEAP = ("zoom", "choose", "along", "undo", "stop", "load")  # nothing is computed
DEAR = ("size", "pick", "move", "set", "start", "ask", "hello")
CALLS = ["follow", "switch", "locus", "margin", "attractors", "dance"]


def number(rng):
    return rng.choice(
        [rng.choice(NUMBERS), rng.uniform(-5.0, 5.0), 10.0 ** rng.uniform(-300, 300) * rng.choice((1, -1))]
    )


def pair(rng):
    found = rng.choice([[number(rng), number(rng)], sorted([number(rng), number(rng)]), [-1e308, 1e308]])
    return rng.choice([found, found, found, None, [1.0], "pair"])


def fields(rng, do):
    """Plausible fields of a message with odd values."""
    if do == "zoom":
        return {"panel": rng.choice(PANELS), "x": pair(rng), "y": pair(rng)}
    if do == "size":
        return {"panel": rng.choice(PANELS), "width": number(rng), "height": number(rng), "ratio": number(rng)}
    if do == "pick":
        return {"panel": "diagram", "x": rng.choice([number(rng), 1e308]), "y": number(rng)}
    if do == "move":
        return {"by": rng.choice([1, -1, 10**9, -(10**18), 0.5]), "branch": rng.choice([0, 1, -7, 10**18])}
    if do == "choose":
        return {"of": rng.choice(WORDS)}
    if do == "along":
        names = rng.choice(WORDS[1:5]), rng.choice(WORDS[1:5])
        bounds = {"bounds": pair(rng), "second_bounds": pair(rng)}
        return {"parameter": names[0], "second": names[1], "variable": rng.choice(WORDS), **bounds}
    if do in ("load", "hello"):
        return {"text": rng.choice(WORDS[-5:])}
    if do == "set":
        return {"name": rng.choice(WORDS[1:5]), "value": number(rng), "last": rng.random() < 0.5}
    if do == "start":
        return {"x": number(rng), "v": number(rng)}
    if do == "ask":
        return {"call": rng.choice(CALLS), "count": rng.choice([1, 2, 0]), "max_period": rng.choice([1, 0])}
    return {}


def message(rng, kinds):
    """The text of a message, now and then one with a fault."""
    do = rng.choice(kinds)
    found = {"do": do, "number": rng.choice([rng.randrange(1000), 2**63 - 1, -3]), **fields(rng, do)}
    if rng.random() < 0.1:
        found[rng.choice(["extra", "number", "do", *found])] = rng.choice([None, [], {}, "text", True, 1e308, 2**70])
    text = json.dumps(found)
    if rng.random() < 0.1:
        place = rng.randrange(len(text))
        text = rng.choice(
            [text[:place], text[:place] + "\\ud800" + text[place:], text[:place] + "9" * 400 + text[place:]]
        )
    return text


def sent(desk, text):
    """What a session is told by a text from outside, as the server has it read; None if it is no message."""
    try:
        read = messages.decode_message(text)
    except ArgumentError:
        assert isinstance(messages.decode_message_number(text), int)
        return None
    told = desk.receive(read)
    while not desk.turns.empty():
        desk.turns.get()()
    return read, told


def require_answered(read, told):
    """One answer, to this message, after all else that it is told; complaints are short lines."""
    answers = [one for one in told if one["kind"] == "answer"]
    assert answers == [{"kind": "answer", "number": read.number}] and told[-1] == answers[0]
    for one in told:
        msgspec.json.decode(messages.encode_record(one))
        assert one["kind"] != "told" or (one["bad"] and len(one["text"]) <= 300 and "\n" not in one["text"])


def draw(desk, count, seed, kinds, slow=10.0):
    """How many messages could be read, of so many; each of them is answered. Prints those that take long."""
    rng, read = random.Random(seed), 0
    for _ in range(count):
        text, began = message(rng, kinds), time.monotonic()
        found = sent(desk, text)
        if found is not None:
            require_answered(*found)
            read += 1
        if time.monotonic() - began > slow:
            print(f"{time.monotonic() - began:.1f} s: {text[:200]}", flush=True)
        desk.session.close()
    return read


if __name__ == "__main__":
    import jax

    from .explorer_pages import Desk

    jax.config.update("jax_enable_x64", True)
    one = Desk()
    one.resize()
    one.run("hello")
    how_many = int((sys.argv[1:] or ["300"])[0])
    print(draw(one, how_many, 58, CHEAP), "messages answered, of", how_many, flush=True)
    print(draw(one, how_many // 5, 59, CHEAP + DEAR), "messages answered, of", how_many // 5, flush=True)
    os._exit(0)  # work that was stopped may still be within a long step of compiled code
