"""A program as the text of one Python function: what its lines are, which of them are needed, how they are written.

A line gives values, each known by a number, from others. Loops and choices hold lines of their own, in blocks.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

PLAIN = "    "


class Block:
    """Lines in a row, and what they have given already, by a key: what stands around a block is known within."""

    def __init__(self, around=None):
        self.lines, self.known, self.around = [], {}, around

    def find(self, key):
        block = self
        while block is not None:
            if key in block.known:
                return block.known[key]
            block = block.around
        return None


@dataclass(frozen=True)
class Line:
    """found: what it gives; given: of what; text: of the latter, in braces. several: the text gives them in a row."""

    found: Sequence[int]
    given: Sequence[int]
    text: str
    several: bool = False

    def needed(self, asked: set[int]) -> "Line":
        asked.update(self.given)
        return self

    def written(self, name: Callable[[int], str], indent: str) -> Iterator[str]:
        names = "".join(f"{name(each)}, " for each in self.found) if self.several else name(self.found[0])
        yield f"{indent}{names} = {self.text.format(*map(name, self.given))}"


@dataclass(frozen=True)
class Repeated:
    """A loop. found: the numbers that it carries, at first begin, in the end of each turn after.

    test, going: lines, and the value of theirs that says whether there is another turn, None: one for each row; lines:
    of a turn. rows: (of which value's text the rows are, the values of one); kept: (the name of a list, values that a
    turn adds to it).
    """

    found: Sequence[int]
    begin: Sequence[int]
    after: Sequence[int]
    lines: "Lines"
    test: "Lines" = ()
    going: int | None = None
    length: int = 0
    rows: Sequence[tuple[Line, Sequence[int], bool]] = ()
    kept: Sequence[tuple[int, Sequence[int], bool]] = ()

    def needed(self, asked: set[int]) -> "Repeated":
        """Itself with what is asked alone."""
        kept = [each for each in self.kept if each[0] in asked]
        live = {k for k, one in enumerate(self.found) if one in asked}
        while True:
            inner = {self.after[k] for k in live}.union(*(values for _, values, _ in kept))
            inner.update(() if self.going is None else [self.going])
            lines = needed(self.lines, inner)
            test = needed(self.test, inner)
            more = {k for k, one in enumerate(self.found) if one in inner} - live
            if not more:
                break
            live |= more
        rows = [each for each in self.rows if not inner.isdisjoint(each[1])]
        for line, _, _ in rows:
            inner.update(line.given)
        asked |= inner | {self.begin[k] for k in live}
        found, begin, after = ([each[k] for k in sorted(live)] for each in (self.found, self.begin, self.after))
        return replace(self, found=found, begin=begin, after=after, lines=lines, test=test, rows=rows, kept=kept)

    def written(self, name: Callable[[int], str], indent: str) -> Iterator[str]:
        within = indent + PLAIN
        for one, first in zip(self.found, self.begin, strict=True):
            yield f"{indent}{name(one)} = {name(first)}"
        for one, _, _ in self.kept:
            yield f"{indent}{name(one)} = []"
        yield indent + (self._head(name) if self.going is None else "while True:")
        yield f"{within}spent += {len(self.lines) + len(self.test) + 1}"
        yield from written(self.test, name, within)
        if self.going is not None:
            yield f"{within}if not {name(self.going)}: break"
        yield from written(self.lines, name, within)
        for one, values, whole in self.kept:
            row = name(values[0]) if whole else f"({''.join(f'{name(each)}, ' for each in values)})"
            yield f"{within}{name(one)}.append({row})"
        moved = [each for each in zip(self.found, self.after, strict=True) if each[0] != each[1]]
        if moved:
            yield within + " = ".join(
                "".join(f"{name(each)}, " for each in column) for column in zip(*moved, strict=True)
            )

    def _head(self, name):
        if not self.rows:
            return f"for _ in range({self.length}):"
        texts = (line.text.format(*map(name, line.given)) for line, _, _ in self.rows)
        names = (
            name(one[0]) if whole else f"({''.join(f'{name(each)}, ' for each in one)})" for _, one, whole in self.rows
        )
        return f"for {''.join(f'{each}, ' for each in names)} in zip({', '.join(texts)}):"


@dataclass(frozen=True)
class Chosen:
    """One of some blocks, by the number of which; each with the values that are to be found of it."""

    found: Sequence[int]
    which: int
    blocks: Sequence[tuple["Lines", Sequence[int]]]

    def needed(self, asked: set[int]) -> "Chosen":
        live = [k for k, one in enumerate(self.found) if one in asked]
        blocks = []
        for lines, results in self.blocks:
            results = [results[k] for k in live]
            inner = set(results)
            blocks.append((needed(lines, inner), results))
            asked |= inner
        asked.add(self.which)
        return replace(self, found=[self.found[k] for k in live], blocks=blocks)

    def written(self, name: Callable[[int], str], indent: str) -> Iterator[str]:
        for k, (lines, results) in enumerate(self.blocks):
            test = f"if {name(self.which)} <= {k}:" if k == 0 else f"elif {name(self.which)} == {k}:"
            yield indent + (test if k + 1 < len(self.blocks) else "else:")
            yield from written(lines, name, indent + PLAIN)
            yield f"{indent}{PLAIN}spent += {len(lines)}"
            for one, result in zip(self.found, results, strict=True):
                yield f"{indent}{PLAIN}{name(one)} = {name(result)}"


Lines = Sequence[Line | Repeated | Chosen]


def needed(lines: Lines, asked: set[int]) -> list[Line | Repeated | Chosen]:
    """The lines without which something asked would not be found; asked: then all that these are given, too."""
    kept = []
    for line in reversed(list(lines)):
        if not asked.isdisjoint([*line.found, *(each[0] for each in getattr(line, "kept", ()))]):
            kept.append(line.needed(asked))
    return kept[::-1]


def written(lines: Lines, name: Callable[[int], str], indent: str) -> Iterator[str]:
    """The text of lines, each within an indent; name: the text of a value."""
    for line in lines:
        yield from line.written(name, indent)


def count(lines: Lines) -> int:
    """How many lines there are, those within others among them."""
    total = 0
    for line in lines:
        inner = [*getattr(line, "test", ()), *getattr(line, "lines", ())]
        inner += [one for lines, _ in getattr(line, "blocks", ()) for one in lines]
        total += 1 + count(inner)
    return total
