"""Format numbers as text for tables."""


def align_columns(rows):
    """Format rows of texts and numbers as aligned columns.

    Parameters
    ----------
    rows : sequence of sequence
        Rows of equal length.

    Returns
    -------
    str
        One line per row.
    """
    texts = [[f"{entry:.6g}" if isinstance(entry, float) else str(entry) for entry in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in texts)


def column_header(name, unit, units):
    """Return a column's name, followed by its unit if that is a physical one.

    Parameters
    ----------
    name : str
        Name.
    unit : str
        Unit.
    units : {"scene", "physical"}
        Units of the table.

    Returns
    -------
    str
        Heading.
    """
    return f"{name} ({unit})" if units == "physical" and unit not in ("", "1") else name


def multipliers_text(multipliers, digits=6):
    """Format two multipliers, real ones separately and a complex pair as one text.

    Parameters
    ----------
    multipliers : sequence of complex
        Two multipliers.
    digits : int, optional
        Significant digits.

    Returns
    -------
    str
        Text.
    """
    first, second = multipliers
    if first.imag:
        return f"{first.real:.{digits}g} +- {abs(first.imag):.{digits}g}i"
    return f"{first.real:.{digits}g}, {second.real:.{digits}g}"
