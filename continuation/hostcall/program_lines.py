"""Represent a program as lines, remove unused lines and write them as the text of one Python function.

A line computes variables from other variables. Variables are identified by numbers. Loops and conditionals contain
blocks of lines.
"""

from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

INDENT = "    "


class Block:
    """Block of lines; `known_results` maps keys to variables, also those of the enclosing blocks."""

    def __init__(self, outer_block=None):
        self.lines = []
        self.known_results = outer_block.known_results.new_child() if outer_block else ChainMap()


@dataclass(frozen=True)
class Line:
    """Line that assigns the value of an expression to variables; without variables it is a statement.

    Attributes
    ----------
    results : sequence of int
        Variables to which the value is assigned; empty for a statement, which is never removed.
    operands : sequence of int
        Variables in the expression.
    text : str
        Text of the expression; ``{0}``, ``{1}``, ... stand for the operands.
    returns_list : bool
        True if the value is a sequence with one entry per result.
    """

    results: Sequence[int]
    operands: Sequence[int]
    text: str
    returns_list: bool = False

    def prune(self, needed_numbers: set[int]) -> "Line":
        needed_numbers.update(self.operands)
        return self

    def write(self, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
        result_names = ", ".join(map(variable_name, self.results)) + ("," if self.returns_list else "")
        assignment = f"{result_names} = " if self.results else ""
        yield f"{indent}{assignment}{self.text.format(*map(variable_name, self.operands))}"


@dataclass(frozen=True)
class Loop:
    """Loop that updates carried variables.

    Attributes
    ----------
    results : sequence of int
        Carried variables.
    initial : sequence of int
        Variables with the initial values of the carried variables.
    next_results : sequence of int
        Variables with the values of the carried variables after an iteration.
    lines : sequence of Line, Loop or Conditional
        Lines of an iteration.
    head : str
        Head of the loop. A statement among the lines ends a loop without a number of iterations.
    """

    results: Sequence[int]
    initial: Sequence[int]
    next_results: Sequence[int]
    lines: "Lines"
    head: str = "while True:"

    def prune(self, needed_numbers: set[int]) -> "Loop":
        """Remove unused variables and lines."""
        live_indices = {index for index, number in enumerate(self.results) if number in needed_numbers}
        while True:
            inner_numbers = {self.next_results[index] for index in live_indices}
            lines = prune_lines(self.lines, inner_numbers)
            more_indices = live_indices | {k for k, number in enumerate(self.results) if number in inner_numbers}
            if more_indices == live_indices:
                break
            live_indices = more_indices
        needed_numbers |= inner_numbers | {self.initial[index] for index in live_indices}
        columns = self.results, self.initial, self.next_results
        results, initial, next_results = ([column[index] for index in sorted(live_indices)] for column in columns)
        return replace(self, results=results, initial=initial, next_results=next_results, lines=lines)

    def write(self, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
        for number, initial_number in zip(self.results, self.initial, strict=True):
            yield f"{indent}{variable_name(number)} = {variable_name(initial_number)}"
        yield indent + self.head
        yield f"{indent}{INDENT}spent += {len(self.lines)}"
        yield from write_lines(self.lines, variable_name, indent + INDENT)
        changed = [pair for pair in zip(self.results, self.next_results, strict=True) if pair[0] != pair[1]]
        if changed:
            sides = ("".join(f"{variable_name(number)}, " for number in side) for side in zip(*changed, strict=True))
            yield indent + INDENT + " = ".join(sides)


@dataclass(frozen=True)
class Conditional:
    """Conditional that executes one of several blocks.

    Attributes
    ----------
    results : sequence of int
        Variables that each block assigns.
    branch_number : int
        Variable with the index of the block, which is clipped to the valid range.
    blocks : sequence of sequence
        Lines of each block.
    """

    results: Sequence[int]
    branch_number: int
    blocks: Sequence["Lines"]

    def prune(self, needed_numbers: set[int]) -> "Conditional":
        live_numbers, blocks = needed_numbers.intersection(self.results), []
        for lines in self.blocks:
            inner_numbers = set(live_numbers)
            blocks.append(prune_lines(lines, inner_numbers))
            needed_numbers |= inner_numbers
        needed_numbers.add(self.branch_number)
        return replace(self, blocks=blocks)

    def write(self, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
        for index, lines in enumerate(self.blocks):
            condition = f"{'elif' if index else 'if'} {variable_name(self.branch_number)} <= {index}:"
            yield indent + (condition if index + 1 < len(self.blocks) else "else:")
            yield f"{indent}{INDENT}spent += {len(lines)}"
            yield from write_lines(lines, variable_name, indent + INDENT)


Lines = Sequence[Line | Loop | Conditional]


def prune_lines(lines: Lines, needed_numbers: set[int]) -> list[Line | Loop | Conditional]:
    """Return the lines that compute needed variables, and add the operands of these lines to `needed_numbers`."""
    pruned_lines = []
    for line in reversed(lines):
        if not line.results or not needed_numbers.isdisjoint(line.results):
            pruned_lines.append(line.prune(needed_numbers))
    return pruned_lines[::-1]


def write_lines(lines: Lines, variable_name: Callable[[int], str], indent: str) -> Iterator[str]:
    """Write lines as text with an indent; `variable_name` returns the text of a variable."""
    for line in lines:
        yield from line.write(variable_name, indent)


def count_lines(lines: Lines) -> int:
    """Count lines, including those in loops and conditionals."""
    inner_blocks = ([getattr(line, "lines", ()), *getattr(line, "blocks", ())] for line in lines)
    return len(lines) + sum(map(count_lines, chain.from_iterable(inner_blocks)))
