"""What other programs call special points: AUTO-07p and MatCont."""

from ..scene import check

# Where a program has no such point, ours stays: GR, CH and RL are known to none of them.
OTHERS = {
    "auto": {"SN": "LP", "SB": "BP", "NS": "TR", "NSA": "NSA"},
    "matcont": {"SN": "LPC", "SB": "BPC", "BP": "BPC", "NSA": "NS", "CP": "CPC"},
}
NAMES = ("jaxvibro", *OTHERS)


def name_in(kind: str, labels: str) -> str:
    """A kind of special point as "jaxvibro", "auto" (AUTO-07p) or "matcont" (MatCont, of cycles) calls it.

    Raises ArgumentError for other programs.
    """
    if not isinstance(labels, str) or labels not in NAMES:
        raise check.ArgumentError("labels", f"must be one of {', '.join(NAMES)}", labels)
    return OTHERS.get(labels, {}).get(kind, kind)
