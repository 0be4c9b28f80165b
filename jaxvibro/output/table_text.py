"""Numbers as texts, for tables."""


def align_columns(rows):
    """Rows of texts and numbers in columns."""
    texts = [[f"{entry:.6g}" if isinstance(entry, float) else str(entry) for entry in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in texts)


def column_header(name, unit, units):
    """A column's name, with its unit where that is a physical one."""
    return f"{name} ({unit})" if units == "physical" and unit not in ("", "1") else name


def multipliers_text(multipliers, digits=6):
    """Two real numbers, or two complex ones as one text."""
    first, second = multipliers
    if first.imag:
        return f"{first.real:.{digits}g} +- {abs(first.imag):.{digits}g}i"
    return f"{first.real:.{digits}g}, {second.real:.{digits}g}"
