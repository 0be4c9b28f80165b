"""Format tables and numbers as text."""


def align_columns(rows):
    """Format the rows of a table as text with aligned columns.

    Parameters
    ----------
    rows : sequence of sequence
        Rows of equal length, with texts and numbers as cells.

    Returns
    -------
    str
        One line per row.
    """
    cell_texts = [[f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    column_widths = [max(map(len, column)) for column in zip(*cell_texts, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, column_widths)).rstrip() for row in cell_texts)


def column_header(name, unit, units):
    """Return the name of a column, followed by its unit in brackets if the table has physical units.

    Parameters
    ----------
    name : str
        Name of the column.
    unit : str
        Unit of the column, ``""`` or ``"1"`` for none.
    units : {"scene", "physical"}
        Unit system of the table.

    Returns
    -------
    str
        Column header.
    """
    return f"{name} ({unit})" if units == "physical" and unit not in ("", "1") else name


def multipliers_text(multipliers, n_digits=6):
    """Format two Floquet multipliers: two real numbers, or a complex pair as ``a +- bi``.

    Parameters
    ----------
    multipliers : sequence of complex
        Two real multipliers or a complex-conjugate pair.
    n_digits : int, optional
        Number of significant digits.

    Returns
    -------
    str
        Text.
    """
    first_multiplier, second_multiplier = multipliers
    if first_multiplier.imag:
        return f"{first_multiplier.real:.{n_digits}g} +- {abs(first_multiplier.imag):.{n_digits}g}i"
    return f"{first_multiplier.real:.{n_digits}g}, {second_multiplier.real:.{n_digits}g}"
