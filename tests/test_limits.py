"""What is refused before any work: texts too large or too deep, names that are none, starts beyond a wall."""

import itertools
import random
import string
import tomllib
from importlib import import_module

import jax
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.scene.check import LONGEST, among
from jaxvibro.studies import command, scene_file, schema, text_limits
from tests.scene_files import SCENE


def line_of(call, *given):
    """The one line, not too long, with which a call is refused."""
    with pytest.raises(jv.ArgumentError) as error:
        call(*given)
    line = str(error.value)
    assert "\n" not in line and len(line) <= LONGEST
    return line


def nested(depth, draw):
    """A line of TOML with a key of so many names, some of them dotted, and how deep the deeper of these and of the
    brackets is."""
    names = [draw.choice(["a", '"b.c"', "'d'", "left", "-", "1"]) for _ in range(depth)]
    cut = draw.randrange(depth)
    blank = draw.choice(["", " ", "\t "])
    dotted, rest = f"{blank}.{blank}".join(names[: cut + 1]), names[cut + 1 :]
    return dotted + "=" + "".join(f"{{{name}=" for name in rest) + "1" + "}" * len(rest), max(cut + 1, len(rest))


@pytest.mark.parametrize("depth", [1, 5, 8, 9, 12, 100, 1000, 20_000])
def test_a_key_is_as_deep_as_it_may_be(tmp_path, depth):
    draw = random.Random(depth)
    for _ in range(20):
        text, deep = nested(depth, draw)
        if deep > text_limits.DEEPEST:
            assert "at most 8" in line_of(text_limits.parsed, "it", text)
            (tmp_path / "mine.toml").write_text(SCENE + text)
            line_of(scene_file.read, tmp_path / "mine.toml")
            line_of(scene_file.apply, {}, text)
        else:
            assert text_limits.parsed("it", text) == tomllib.loads(text)


DOTS = ".".join("abcdefghijkl")


@pytest.mark.parametrize(
    "text",
    [
        f"# {DOTS} = 1",
        f'a = "{DOTS}"',
        f"a = '{DOTS}'",
        f'a = """\n{DOTS} = 1\n"""',
        f"a = '''\n{DOTS} = 1\n'''",
        f'"{DOTS}" = 1',
        'a = "' + "[{" * 20 + '"',
        'a = "\\"' + DOTS + '" # "',
        "a = [" + "1.5, " * 100 + "]",
        "a = [" + "[], " * 100 + "]",
        "# " + "[" * 100,
    ],
)
def test_what_only_looks_deep_is_read(text):
    assert text_limits.parsed("it", text) == tomllib.loads(text)


def test_what_follows_a_text_is_still_looked_at():
    quoted = ['"#"', "'#'", '"""\n#"""', "'''\n#'''", '"\\""', "'\\'", '"""\\""""', "'''a'''''", '1 # "', "1 # '''"]
    for one in quoted:
        assert tomllib.loads(f"a = {one}\nb = 1")["b"] == 1
        assert "8 names" in line_of(text_limits.parsed, "it", f"a = {one}\n{DOTS} = 1")


def test_a_large_file_is_refused_unread(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(SCENE + "#" * (text_limits.LARGEST - len(SCENE)))
    assert jv.load_scene(path).amplitude == 4.65
    path.write_text(SCENE + "#" * (text_limits.LARGEST - len(SCENE) + 1))
    assert "must be at most 1,000,000 bytes" in line_of(jv.load_scene, path)
    assert "must be at most 1,000,000 bytes" in line_of(scene_file.content, type(path)("/dev/zero"))
    assert "must be at most 1,000,000 characters" in line_of(
        scene_file.apply, {}, "a='" + "b" * text_limits.LARGEST + "'"
    )


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-8", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp037"])
def test_encodings(tmp_path, encoding):
    path = tmp_path / "mine.toml"
    path.write_bytes(("# \xe9\n" + SCENE).encode(encoding))
    if encoding.startswith("utf-8"):
        assert jv.load_scene(path).amplitude == 4.65
    else:
        assert line_of(jv.load_scene, path).startswith("mine.toml: must be a TOML file")
    assert "KEY=VALUE" in line_of(scene_file.apply, {}, "sweep.legs.0.name = '\udce9'")


LONG = [
    f"'{1000 * 'a'}'=1",
    f"sweep.parameter='{5000 * 'b'}'",
    2000 * "c",
    f"scene.left.{9000 * 'd'}.e=3",
    "scene.amplitude=[" + "1.0," * 10_000 + "]",
    "attractors.at={" + ",".join(f"a{k}=1" for k in range(9000)) + "}",
    f"sweep.legs=[{{name='{400 * 'n'}'}}]",
    "scene=1" + 9000 * "0",
]


@pytest.mark.parametrize("change", LONG, ids=lambda one: one[:20])
def test_messages_end(tmp_path, change, capsys):
    (tmp_path / "mine.toml").write_text(SCENE)
    line_of(scene_file.read, tmp_path / "mine.toml", [change])
    assert command.main(["run", str(tmp_path / "mine.toml"), "--set", change]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and len(told) <= LONGEST + len("jaxvibro: \n")
    assert command.main(["run", str(tmp_path / "mine.toml"), "--" + change]) == 2
    assert command.main(["run", change]) == 2
    assert max(map(len, capsys.readouterr().err.splitlines())) <= LONGEST + len("jaxvibro: ")


def misspelt(name, draw):
    """The name with one letter left out, doubled, exchanged or put in."""
    place, letter = draw.randrange(len(name)), draw.choice(string.ascii_lowercase)
    return draw.choice([name[:place] + name[place + 1 :], name[:place] + letter + name[place:], name[:-1] + letter])


def test_a_name_that_is_none_is_answered_with_the_nearest():
    moving = jv.Wall(1.0, None, motion=jv.Motion(0.1))
    scene, draw = jv.make_scene(2.0, 2.1, 0.05, 0.7, (jv.Wall(-1.0, None, 100.0), moving)), random.Random(1)
    for name in scene.names * 5:
        wrong = misspelt(name, draw)
        if wrong in scene.names:
            continue
        assert f", perhaps {name} (" in line_of(scene.parameter, wrong)
        assert f", perhaps {name} (" in line_of(lambda wrong=wrong: scene.replace(**{wrong: 1.0}))
    assert among("zzz", ("a", "b")) == " (a, b)"
    for kind in (schema.SceneFile, schema.SweepTable, schema.BranchTable):
        for name in kind.__struct_encode_fields__:
            wrong = name + "x"
            where = {"SceneFile": "", "SweepTable": "sweep.", "BranchTable": "branch."}[kind.__name__]
            assert f", perhaps {name} (" in line_of(scene_file.understood, tomllib.loads(f"{where}{wrong} = 1"))


def scenes(draw):
    """Random scenes of one or two rigid walls, that move or stand, and a phase of the drive."""
    while True:
        moves = [draw.choice([None, jv.Motion(draw.uniform(-0.4, 0.4), draw.uniform(0.0, 6.0), 2)]) for _ in range(2)]
        walls = [
            jv.Wall(draw.uniform(*ends), 0.5, motion=move) for ends, move in zip(((-3, -1), (1, 3)), moves, strict=True)
        ]
        if draw.random() < 0.3:
            walls[draw.integers(2)] = None
        scene = jv.make_scene(2.0, draw.uniform(0.3, 5.0), draw.uniform(0.0, 2.0), 0.7, walls)
        yield scene, draw.uniform(0.0, 9.0)


LABOUR = {
    "orbits.find": "iterate",
    "maps.simulate": "_trace",
    "maps.sections": "ends",
    "attractors.sweep": "_run",
    "attractors.spectrum": "_found",
}


@pytest.fixture
def idle(monkeypatch):
    """Nothing may be run."""

    def never(*given, **named):
        raise AssertionError("run")

    for home, name in LABOUR.items():
        monkeypatch.setattr(import_module(f"jaxvibro.{home}"), name, never)


def test_a_start_beyond_a_wall_is_refused_before_any_work(idle):
    draw = np.random.default_rng(1)
    for scene, phase in itertools.islice(scenes(draw), 30):
        for side, sign in (("left", -1.0), ("right", 1.0)):
            wall = getattr(scene, side)
            if wall is None:
                continue
            move = wall.motion
            place = float(wall.position)
            place += 0.0 if move is None else float(move.amplitude * np.cos(move.harmonic * phase + move.phase))
            bad = jv.State(place + sign * draw.choice([1e-12, 0.1, 5.0]), draw.normal(), phase)
            good = jv.State(place - sign * 1e-3, 0.0, phase)
            calls = [
                lambda state, scene=scene: jv.find_orbit(scene, state),
                lambda state, scene=scene: jv.simulate(scene, state),
                lambda state, scene=scene: jv.sections(scene, state),
                lambda state, scene=scene: jv.sweep(scene, "amplitude", np.ones(3), state),
                lambda state, scene=scene: jv.spectrum(scene, "amplitude", np.ones(3), state),
            ]
            for call in calls:
                assert line_of(call, bad).startswith("state.x: must lie between the walls")
                assert line_of(call, jv.State(np.nan, 0.0, phase)).startswith("state.x: must be finite")
                with pytest.raises(AssertionError, match="run"):
                    call(good)


def test_a_start_within_a_soft_wall_is_one(idle):
    scene = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, jv.Wall(1.0, None, 100.0)))
    with pytest.raises(AssertionError, match="run"):
        jv.simulate(scene, jv.State(1.1, 0.0))
    line_of(jv.simulate, scene, jv.State(-1.1, 0.0))
    assert jax.config.jax_enable_x64
