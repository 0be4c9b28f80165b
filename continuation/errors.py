"""What is raised for arguments that cannot be."""

from typing import Any

from .argument_types import check_arguments


class ContinuationError(ValueError):
    """An argument breaks a rule. key: the argument; rule: what it must be; value: what was given."""

    def __init__(self, key: str, rule: str, value: Any) -> None:
        super().__init__(key, rule, value)
        self.key, self.rule, self.value = key, rule, value

    def __str__(self) -> str:
        value_text = " ".join(repr(self.value).split())
        return f"{self.key}: {self.rule}; got {value_text if len(value_text) <= 80 else value_text[:77] + '...'}"


def first_line(error: Exception) -> str:
    """Return the type of an exception and the first line of its message, up to 160 characters."""
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"[:160]


check_types = check_arguments(
    ContinuationError
)  # decorates a public function, which refuses what its annotations do not allow
