"""Random messages of a page of the explorer, many of them with odd values or cut, and the check of their answers."""

import json
import random
from typing import Literal, get_args, get_origin

import msgspec

import jaxvibro as jv
from jaxvibro.explorer.messages import Message, decode_message_number

from .sources import words

NUMBERS = [0, -0.0, 1, -1, 0.5, 2.1, 1e-320, 1e-16, 1e16, 1e100, -1e100, 1e300, 1e308, -1e308, 2**70, -(2**63)]
COUNTS = [0, 1, 2, -1, -7, 0.5, 10**9, -(10**18)]
NAMES = sorted(words("amplitude frequency left.position restitution branch_1 branch_1.special[0] scene_1 speed"))
WORDS = sorted(words("branch_1.special[999999] branch_1[3] branch_1.branches[0] orbit_1 x impact __class__ ../.. nan"))
TEXTS = ["", "\x00", "\u4e00", "\ufffd", "'); drop", "a" * 201, "[scene]", "[scene]\namplitude = 1e308\n"]
CHEAP = ("zoom", "choose", "along", "undo", "stop", "load")  # without computation
ALL = {kind.__struct_config__.tag: msgspec.structs.fields(kind) for kind in Message.__subclasses__()}


def random_number(rng):
    magnitude = 10.0 ** rng.uniform(-300, 300) * rng.choice((1, -1))
    return rng.choice([rng.choice(NUMBERS), rng.uniform(-5.0, 5.0), magnitude])


def random_pair(rng):
    pair = [random_number(rng), random_number(rng)]
    return rng.choice([pair, sorted(pair), sorted(pair), [-1e308, 1e308], None, [1.0], "pair"])


def random_value(rng, field):
    """Return a value of the type of a field; it may be out of range."""
    hint = get_args(field.type)[0] if hasattr(field.type, "__metadata__") else field.type
    if get_origin(hint) is Literal:
        return rng.choice([*get_args(hint), get_args(hint)[0], "door"])
    if hint is str:
        return rng.choice(TEXTS if field.name == "text" else rng.choice([NAMES, NAMES, WORDS, TEXTS]))
    if hint in (bool, int):
        return rng.choice((True, False) if hint is bool else COUNTS)
    return random_number(rng) if hint is float else random_pair(rng)


def random_text(rng, kinds):
    """Return the text of a message of one of some kinds; every fifth has a fault."""
    kind = rng.choice(kinds)
    fields = {field.name: random_value(rng, field) for field in ALL[kind]}
    fields |= {"do": kind, "number": rng.choice([rng.randrange(1000), 2**63 - 1, -3])}
    if rng.random() < 0.1:
        fields[rng.choice(["extra", *fields])] = rng.choice([None, [], {}, "text", True, 1e308, 2**70])
    text = json.dumps(fields)
    if rng.random() < 0.1:
        place = rng.randrange(len(text))
        head, tail = text[:place], text[place:]
        text = rng.choice([head, f"{head}\\ud800{tail}", f"{head}{'9' * 400}{tail}"])
    return text


def check_answers(desk, count, seed, kinds):
    """Send random messages and return how many are valid.

    Each of these must have one answer, after all other records; complaints must be short lines.
    """
    rng, valid = random.Random(seed), 0
    for _ in range(count):
        text = random_text(rng, kinds)
        try:
            records = desk.receive_text(text)
        except jv.ArgumentError:
            assert isinstance(decode_message_number(text), int)
            continue
        while not desk.turns.empty():
            desk.turns.get()()
        answers = [record for record in records if record["kind"] == "answer"]
        assert answers == records[-1:] == [{"kind": "answer", "number": json.loads(text)["number"]}]
        for record in records:
            assert record["kind"] != "told" or (
                record["bad"] and len(record["text"]) <= 300 > record["text"].find("\n")
            )
        valid += 1
        desk.session.close()
    return valid
