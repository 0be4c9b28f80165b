"""What other programs call special points: AUTO-07p and MatCont."""

from ..scene import check

# Where a program has no such point, ours stays: GR, CH and RL are known to none of them.
FOREIGN_LABELS = {
    "auto": {"SN": "LP", "SB": "BP", "NS": "TR", "NSA": "NSA"},
    "matcont": {"SN": "LPC", "SB": "BPC", "BP": "BPC", "NSA": "NS", "CP": "CPC"},
}
LABEL_SYSTEMS = ("jaxvibro", *FOREIGN_LABELS)


def translate_label(kind: str, label_system: str) -> str:
    """A kind of special point as "jaxvibro", "auto" (AUTO-07p) or "matcont" (MatCont, of cycles) calls it.

    Raises ArgumentError for other programs.
    """
    if not isinstance(label_system, str) or label_system not in LABEL_SYSTEMS:
        raise check.ArgumentError("labels", f"must be one of {', '.join(LABEL_SYSTEMS)}", label_system)
    return FOREIGN_LABELS.get(label_system, {}).get(kind, kind)
