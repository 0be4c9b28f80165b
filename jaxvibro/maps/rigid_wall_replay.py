"""Replay at rigid walls, which have no contact phases.

`linear_contact_replay` and `force_law_contact_replay` define the same functions for soft walls; see
`contact_law_replays`.
"""


def replay_initial_contact(coeffs, current_state, start_contact_code, path_end, order):
    """Return (`ExpansionPoint`, pending contact) for an initial state with a contact code, up to the
    `EndTimeAndContact`."""
    return current_state, None


def complete_pending_contact(coeffs, current_state, pending_contact, path_end, order):
    """Return the state at the end of the pending contact phase; rigid walls have none, so that nothing changes."""
    return current_state


def replay_wall_entry(coeffs, current_state, side, entry_delay, path_end, order):
    """Return (`ExpansionPoint`, pending contact) of lanes that hit a wall after a delay; side 0 means none."""
    return current_state, None


def state_after_delay(coeffs, current_state, contact_code, free_flight_state, delay, order):
    """Return (x, v) after a delay; `free_flight_state` is (x, v) after the delay for lanes outside soft walls."""
    return free_flight_state
