"""Define the error for invalid arguments and the decorator that checks the types of arguments."""

from typing import Any

from .argument_checks import check_arguments


class ContinuationError(ValueError):
    """Error for an invalid argument.

    Attributes
    ----------
    key : str
        Name of the argument.
    rule : str
        Rule that the argument breaks.
    value : Any
        Value of the argument.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] - u)
    >>> try:
    ...     co.trace(system, [0.0], {"a": 0.0}, "a", bounds=(1.0, 2.0))
    ... except co.ContinuationError as error:
    ...     print(error.key)
    bounds
    """

    def __init__(self, key: str, rule: str, value: Any) -> None:
        super().__init__(key, rule, value)
        self.key, self.rule, self.value = key, rule, value

    def __str__(self) -> str:
        value_text = " ".join(repr(self.value).split())
        return f"{self.key}: {self.rule}; got {value_text if len(value_text) <= 80 else value_text[:77] + '...'}"


def error_summary(error: Exception) -> str:
    """Return the type of an exception and the first line of its message.

    Parameters
    ----------
    error : Exception
        The exception.

    Returns
    -------
    str
        Type and first line, at most 160 characters.
    """
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"[:160]


# Decorator of public functions that refuses arguments of types that their annotations do not allow.
check_types = check_arguments(ContinuationError)
