"""Translate kinds of special points to the labels of AUTO-07p and MatCont."""

from ..scene import check

# Kinds without a counterpart keep their label: neither program has GR, CH or RL.
FOREIGN_LABELS = {
    "auto": {"SN": "LP", "SB": "BP", "NS": "TR", "NSA": "NSA"},
    "matcont": {"SN": "LPC", "SB": "BPC", "BP": "BPC", "NSA": "NS", "CP": "CPC"},
}
LABEL_SYSTEMS = ("jaxvibro", *FOREIGN_LABELS)


def translate_label(kind: str, label_system: str) -> str:
    """Translate a kind of special point into the label of another program.

    Parameters
    ----------
    kind : str
        Kind of special point.
    label_system : {"jaxvibro", "auto", "matcont"}
        Program whose labels are used. For MatCont these are the labels for limit cycles.

    Returns
    -------
    str
        Label. Kinds without a counterpart are unchanged.

    Raises
    ------
    ArgumentError
        If `label_system` is unknown.
    """
    if not isinstance(label_system, str) or label_system not in LABEL_SYSTEMS:
        raise check.ArgumentError("labels", f"must be one of {', '.join(LABEL_SYSTEMS)}", label_system)
    return FOREIGN_LABELS.get(label_system, {}).get(kind, kind)
