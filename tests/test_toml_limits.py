"""What is refused before any work: texts too large or too deep, unknown names, starts beyond a wall."""

import random
import string
import tomllib

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.studies import command
from jaxvibro.studies.toml_limits import parse_limited_toml
from tests.scene_files import SCENE

MAX_LENGTH = 300  # of a message
DOTS = ".".join("abcdefghijkl")
SHALLOW = [
    f"# {DOTS} = 1",
    f'a = "{DOTS}"',
    f"a = '{DOTS}'",
    f'a = """\n{DOTS} = 1\n"""',
    f"a = '''\n{DOTS} = 1\n'''",
    f'"{DOTS}" = 1',
    'a = "' + "[{" * 20 + '"',
    'a = "\\"' + DOTS + '" # "',
    "a = [" + "[], " * 100 + "]",
    "# " + "[" * 100,
]
QUOTED = ['"#"', "'#'", '"""\n#"""', "'''\n#'''", '"\\""', "'\\'", '"""\\""""', "'''a'''''", '1 # "', "1 # '''"]


def message(call, *given):
    """Return the message of a refused call, which is one line that is not too long."""
    with pytest.raises(jv.ArgumentError) as error:
        call(*given)
    line = str(error.value)
    assert "\n" not in line and len(line) <= MAX_LENGTH
    return line


@pytest.mark.parametrize("depth", [1, 5, 8, 9, 12, 100, 20_000])
def test_a_key_is_at_most_eight_names_deep(depth):
    draw = random.Random(depth)
    for _ in range(20):
        names = [draw.choice(["a", '"b.c"', "'d'", "left", "-", "1"]) for _ in range(depth)]
        cut, blank = draw.randrange(depth), draw.choice(["", " ", "\t "])
        dotted, rest = f"{blank}.{blank}".join(names[: cut + 1]), names[cut + 1 :]
        text = dotted + "=" + "".join(f"{{{name}=" for name in rest) + "1" + "}" * len(rest)
        if max(cut + 1, len(rest)) > 8:
            assert "at most 8" in message(parse_limited_toml, "it", text)
        else:
            assert parse_limited_toml("it", text) == tomllib.loads(text)


def test_quoted_and_commented_texts_are_not_deep_and_hide_nothing():
    for text in SHALLOW:
        assert parse_limited_toml("it", text) == tomllib.loads(text)
    for text in QUOTED:
        assert "8 names" in message(parse_limited_toml, "it", f"a = {text}\n{DOTS} = 1")


def test_large_files_and_other_encodings_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(SCENE + "#" * (1_000_000 - len(SCENE)))
    assert jv.load_scene(path).amplitude == 4.65
    path.write_text(SCENE + "#" * (1_000_001 - len(SCENE)))
    assert "must be at most 1,000,000 bytes" in message(jv.load_scene, path)
    for encoding in ("utf-8-sig", "utf-8", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp037"):
        path.write_bytes(("# \xe9\n" + SCENE).encode(encoding))
        if encoding.startswith("utf-8"):
            assert jv.load_scene(path).amplitude == 4.65
        else:
            assert message(jv.load_scene, path).startswith("mine.toml: must be a TOML file")


@pytest.mark.parametrize(
    "change",
    [
        f"'{1000 * 'a'}'=1",
        f"sweep.parameter='{5000 * 'b'}'",
        2000 * "c",
        "scene.amplitude=[" + "1.0," * 10_000 + "]",
        "attractors.at={" + ",".join(f"a{k}=1" for k in range(9000)) + "}",
        f"sweep.legs=[{{name='{400 * 'n'}'}}]",
        "scene=1" + 9000 * "0",
        "scene.damping='" + "b" * 1_000_000 + "'",
    ],
    ids=range(8),
)
def test_messages_of_the_command_end(tmp_path, change, capsys):
    (tmp_path / "mine.toml").write_text(SCENE)
    for arguments in (["--set", change], ["--" + change]):
        assert command.main(["run", str(tmp_path / "mine.toml"), *arguments]) == 2
        assert max(map(len, capsys.readouterr().err.splitlines())) <= MAX_LENGTH + len("jaxvibro: ")


def test_an_unknown_name_is_answered_with_the_nearest():
    walls = jv.Wall(-1.0, None, 100.0), jv.Wall(1.0, None, motion=jv.Motion(0.1))
    scene, draw = jv.make_scene(2.0, 2.1, 0.05, 0.7, walls), random.Random(1)
    for name in scene.names:
        place, letter = draw.randrange(len(name)), draw.choice(string.ascii_lowercase)
        wrong = draw.choice([name[:place] + name[place + 1 :], name[:place] + letter + name[place:]])
        assert wrong in scene.names or f", perhaps {name} (" in message(scene.parameter, wrong)


def test_a_start_beyond_a_rigid_wall_is_refused():
    draw = np.random.default_rng(1)
    for _ in range(10):
        motion, phase = jv.Motion(draw.uniform(-0.4, 0.4), draw.uniform(0.0, 6.0), 2), draw.uniform(0.0, 9.0)
        scene = jv.make_scene(2.0, draw.uniform(0.3, 5.0), 0.1, 0.7, (None, jv.Wall(1.0, 0.5, motion=motion)))
        position = 1.0 + motion.amplitude * np.cos(2.0 * phase + motion.phase)
        for x, rule in ((position + draw.choice([1e-12, 0.1, 5.0]), "lie between the walls"), (np.nan, "be finite")):
            state = jv.State(float(x), draw.normal(), phase)
            for call in (jv.find_orbit, jv.simulate, jv.sections):
                assert message(call, scene, state).startswith(f"state.x: must {rule}")
            for call in (jv.sweep, jv.spectrum):
                assert message(call, scene, "amplitude", np.ones(3), state).startswith(f"state.x: must {rule}")
