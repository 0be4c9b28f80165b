"""Search the chain that explains a record. It starts with a few consecutive impacts and grows in both directions.

The motion is continued from the end of a chain, with the error propagated from the parameters and the end. A predicted
impact near an impact of the record is identified with it. A predicted impact well before the next one is missing from
the record. Where errors leave several possibilities, several chains are kept, and later impacts decide.
"""

from itertools import product

import numpy as np

from .impact_chains import (
    IMPOSSIBLE_COST,
    SPURIOUS_COST,
    ChainGuess,
    ImpactChain,
    Record,
    fit_chain,
    guess_from_record,
    insert_impacts,
    is_acceptable,
    join_guesses,
    rate_insertions,
    remove_node,
    residual_derivatives,
    scene_and_phase,
    speed_mismatch,
    wall_sides,
)
from .impact_chains import guess_from_chain as as_found
from .next_impact import Impact, Motion

FIRST_IMPACTS, GROWTH_FRACTION = 6, 0.4  # impacts of the first chain; relative growth of a certain chain at once
EASY_COST = 6.0  # a cheaper first chain is accepted without alternatives
MAX_FITTED_WINDOWS, MAX_START_WINDOWS = 16, 6  # largest numbers of first chains that are fitted, and grown
MAX_FITTED_INSERTIONS, MAX_START_INSERTIONS = 10, 4  # the same for chains with inserted impacts
MAX_SPURIOUS_SHARE = 0.1  # fraction of the impacts of a record
FREQUENCY_SCALES = 2.0  # half-width of the frequency search, in scales
PHASE_STEP, MAX_FREQUENCIES = 0.5, 400  # change of the phase of the last impact per frequency, in rad; largest number
MATCH_ERRORS = 5.0  # in standard errors: largest distance between a predicted impact and its match in the record
SURE_ERRORS = 10.0  # in errors of the record: largest error of a certain time
MAX_LOOKAHEAD = 5  # impacts by which an uncertain chain is predicted
MAX_CHAINS, MAX_EXTRA_COST = 6, 24.0  # number of chains that are kept, and their largest cost above the best
EXPENSIVE_STEP = 10.0  # a more expensive step is compared with alternatives
MAX_INSERTIONS = 4  # ways of inserting impacts before a new one, ranked by the mismatch of the speeds
MAX_STRAINED_FLIGHTS = 3  # flights in which an impact is inserted where a chain breaks off


def match_record(record: Record, flawed: bool) -> ImpactChain | None:
    """Return the `ImpactChain` of a whole record; its cost is at least `IMPOSSIBLE_COST` if there is none.

    `flawed` allows missing and spurious impacts.
    """
    best = None
    for start_chain in _start_chains(record, flawed):
        full_chain = _grow_chain(record, flawed, start_chain)
        if is_acceptable(record, full_chain):
            return full_chain
        best = full_chain if best is None or len(full_chain.record_indices) > len(best.record_indices) else best
    return best


def _start_chains(record, flawed):
    """Yield first chains in order of plausibility.

    Consecutive impacts from several positions come first, then chains with inserted impacts.
    """
    n_impacts, start_values = min(FIRST_IMPACTS, len(record.times)), record.free_params.start_values
    first_chain = fit_chain(record, guess_from_record(record, start_values, np.arange(n_impacts)))
    is_easy = is_acceptable(record, first_chain) and first_chain.cost <= EASY_COST
    if is_easy:
        yield first_chain
    candidates = [
        fit_chain(record, guess_from_record(record, parameters, np.arange(k, k + n_impacts)))
        for k, parameters in _start_windows(record, n_impacts)
    ]
    candidates += [] if is_easy else [first_chain]
    yield from sorted(
        (candidate for candidate in candidates if is_acceptable(record, candidate)),
        key=lambda candidate: candidate.cost,
    )[:MAX_START_WINDOWS]
    if flawed:
        yield from _start_with_insertions(record, start_values, n_impacts)


def _start_windows(record, n_impacts):
    """Return (index in the record, parameters) of plausible first chains, sorted by the mismatch of their speeds.

    A small error of the frequency is a large error of the phase of a late impact. Therefore many frequencies are tried.
    """
    free_params, times = record.free_params, record.times
    start_values, trial_values = free_params.start_values, [free_params.start_values]
    if "frequency" in free_params.names:
        index = free_params.names.index("frequency")
        frequency_range = FREQUENCY_SCALES * free_params.scales[index]
        n_trials = (
            int(min(MAX_FREQUENCIES, np.ceil(2.0 * frequency_range * (times[-1] - min(times[0], 0.0)) / PHASE_STEP)))
            + 1
        )
        shifts = np.linspace(-frequency_range, frequency_range, n_trials)[:, None] * (
            np.arange(len(start_values)) == index
        )
        trial_values = list(start_values + shifts[start_values[index] + shifts[:, index] > 0])
    mismatches = np.array(
        [
            speed_mismatch(record, guess_from_record(record, parameters, np.arange(len(times))))
            for parameters in trial_values
        ]
    )
    window_sums = np.cumsum(np.pad(mismatches, ((0, 0), (1, 0))), axis=1)
    window_sums = window_sums[:, n_impacts - 2 :] - window_sums[:, : window_sums.shape[1] - n_impacts + 2]
    padded_sums = np.pad(window_sums, ((1, 1), (0, 0)), constant_values=np.inf)
    minima = np.argwhere((window_sums <= padded_sums[:-2]) & (window_sums <= padded_sums[2:]))
    minima = sorted(minima, key=lambda minimum: window_sums[minimum[0], minimum[1]])
    return [(int(first_impact), trial_values[index]) for index, first_impact in minima[:MAX_FITTED_WINDOWS]]


def _start_with_insertions(record, parameters, n_impacts):
    """Yield chains of the first impacts with one or two inserted or one removed, sorted by cost."""
    guess = guess_from_record(record, parameters, np.arange(n_impacts))
    single_insertions = _insert_one(record, guess, range(n_impacts - 1))
    double_insertions = [
        double_insertion
        for candidate in single_insertions
        for double_insertion in _insert_one(
            record, candidate, range(_last_inserted(candidate) + 1, len(candidate.record_indices) - 1)
        )
    ]
    deletions = [remove_node(guess, k) for k in range(1, n_impacts - 1)]
    trials = sorted(
        [*single_insertions, *double_insertions, *deletions], key=lambda trial: np.sum(speed_mismatch(record, trial))
    )
    candidates = [fit_chain(record, trial) for trial in trials[:MAX_FITTED_INSERTIONS]]
    yield from sorted(
        (candidate for candidate in candidates if is_acceptable(record, candidate)),
        key=lambda candidate: candidate.cost,
    )[:MAX_START_INSERTIONS]


def _insert_one(record, guess, flights):
    """Return the chains with one impact inserted in one of several flights."""
    flight_sides = product(flights, wall_sides(record.scene))
    return [insertion for flight, side in flight_sides for insertion in insert_impacts(record, guess, flight, (side,))]


def _last_inserted(guess):
    """Return the index of the last inserted node."""
    return int(np.flatnonzero(guess.record_indices < 0)[-1])


def _matched_range(chain):
    """Return the range (first, end) of record indices that a chain covers."""
    record_indices = [*chain.record_indices[chain.record_indices >= 0], *chain.spurious_indices]
    return min(record_indices), max(record_indices) + 1


def _grow_chain(record, flawed, start_chain):
    """Grow a chain to the cheapest `ImpactChain` of the whole record.

    Its cost is at least `IMPOSSIBLE_COST` if it breaks off.
    """
    chains, n_impacts = [start_chain], len(record.times)
    while True:
        first_matched, end_matched = _matched_range(chains[0])
        if first_matched == 0 and end_matched == n_impacts:
            return chains[0]
        direction = 1 if end_matched < n_impacts else -1
        longer_chain = _extend_by_many(record, flawed, chains[0], direction) if len(chains) == 1 else None
        if longer_chain is not None:
            chains = [longer_chain]
            continue
        longer_chains = _extend_by_one(record, flawed, chains, direction)
        if not longer_chains:
            return chains[0]._replace(cost=chains[0].cost + IMPOSSIBLE_COST)
        chains = longer_chains


def _extend_by_one(record, flawed, chains, direction):
    """Return the acceptable chains with one more impact of the record, sorted by cost."""
    best_by_key = {}
    for chain in chains:
        for extension in _extend_chain(record, flawed, chain, direction):
            key = (tuple(extension.record_indices), tuple(extension.solution.nodes.sides))
            if (
                is_acceptable(record, extension)
                and extension.cost < best_by_key.get(key, extension._replace(cost=np.inf)).cost
            ):
                best_by_key[key] = extension
    first_matched, end_matched = _matched_range(chains[0])
    max_spurious = 1 + MAX_SPURIOUS_SHARE * (end_matched - first_matched)
    extension = sorted(
        (chain for chain in best_by_key.values() if len(chain.spurious_indices) <= max_spurious),
        key=lambda chain: chain.cost,
    )
    return [chain for chain in extension[:MAX_CHAINS] if chain.cost <= extension[0].cost + MAX_EXTRA_COST]


def _predict_impacts(record, chain, end_time, max_impacts, direction):
    """Return [(impact, error of its time)] of the motion beyond the end of a chain.

    The prediction ends at a time or at a number of impacts.
    """
    solution = chain.solution
    nodes, end_node, n_params = (
        solution.nodes,
        (len(solution.nodes.sides) - 1 if direction > 0 else 0),
        len(solution.parameters),
    )
    scene, phase = scene_and_phase(record, solution.parameters)
    start_impact = Impact(nodes.sides[end_node], nodes.first_unknown[end_node], nodes.second_unknown[end_node])
    impacts = Motion(scene, phase, direction).next_impacts(start_impact, end_time, max_impacts)
    if not impacts:
        return []
    sides, times, speeds = (np.array(column) for column in zip(*[start_impact, *impacts][::direction], strict=True))
    derivatives = residual_derivatives(
        record,
        nodes._replace(sides=sides, state_times=0.0 * sides, first_unknown=times, second_unknown=speeds),
        solution.parameters,
    )[::direction]
    node_derivatives, next_derivatives = (derivatives[:, :, :2], derivatives[:, :, 2:4])[::direction]
    covariance, sensitivity, errors = (
        solution.covariance_with([2 * end_node, 2 * end_node + 1]),
        np.eye(2, 2 + n_params),
        [],
    )
    for k in range(len(impacts)):
        parameter_terms = np.concatenate([np.zeros((2, 2)), derivatives[k, :, 4:]], 1)
        sensitivity = -np.linalg.pinv(next_derivatives[k]) @ (node_derivatives[k] @ sensitivity + parameter_terms)
        errors.append(float(np.sqrt(max(sensitivity[0] @ covariance @ sensitivity[0], 0.0))))
    return list(zip(impacts, errors, strict=True))


def _impacts_ahead(record, chain, direction, max_count):
    """Return the indices of the impacts of the record beyond the end of a chain, the nearest first."""
    first_matched, end_matched = _matched_range(chain)
    return (
        np.arange(end_matched, len(record.times))[:max_count]
        if direction > 0
        else np.arange(first_matched - 1, -1, -1)[:max_count]
    )


def _guess_from_impacts(record_indices, impacts, direction):
    """Return the `ChainGuess` of predicted impacts, the nearest first."""
    sides, times, speeds = (np.array(column, float) for column in zip(*impacts[::direction], strict=True))
    return ChainGuess(np.array(record_indices[::direction], int), sides, times, speeds, (), np.zeros(0))


def _extend_by_many(record, flawed, chain, direction):
    """Extend a chain by all impacts that are certain, or return None if none is."""
    indices_ahead = _impacts_ahead(record, chain, direction, max(2, int(GROWTH_FRACTION * len(chain.record_indices))))
    end_time = record.times[indices_ahead[-1]] + direction * 2.0 * MATCH_ERRORS * SURE_ERRORS * record.sigma[0]
    impacts, record_indices, n_matched = [], [], 0
    for impact, time_error in _predict_impacts(record, chain, end_time, 2 * len(indices_ahead), direction):
        record_index = indices_ahead[n_matched]
        max_delay = MATCH_ERRORS * np.hypot(time_error, record.sigma[record_index])
        delay = direction * (record.times[record_index] - impact.time)
        is_match = impact.side == record.sides[record_index] and abs(delay) <= max_delay
        if time_error > SURE_ERRORS * record.sigma[record_index] or not (
            is_match or (flawed and delay > 2.0 * max_delay)
        ):
            break
        impacts, record_indices, n_matched = (
            [*impacts, impact],
            [*record_indices, record_index if is_match else -1],
            n_matched + is_match,
        )
        if n_matched == len(indices_ahead):
            break
    while record_indices and record_indices[-1] < 0:
        impacts, record_indices = impacts[:-1], record_indices[:-1]
    if not record_indices:
        return None
    longer_chain = fit_chain(
        record, join_guesses(as_found(chain), _guess_from_impacts(record_indices, impacts, direction), direction)
    )
    return longer_chain if is_acceptable(record, longer_chain) else None


def _extend_chain(record, flawed, chain, direction):
    """Return the chains with the next impact of the record, in all plausible ways."""
    record_index, guess = int(_impacts_ahead(record, chain, direction, 1)[0]), as_found(chain)
    time, matched_range = record.times[record_index], _matched_range(chain)
    time_gap = abs(time - record.times[matched_range[1] - 1 if direction > 0 else matched_range[0]])
    extensions, impacts = [], []
    for impact, time_error in _predict_impacts(record, chain, time + direction * time_gap, MAX_LOOKAHEAD, direction):
        max_delay = MATCH_ERRORS * np.hypot(time_error, record.sigma[record_index])
        if impact.side == record.sides[record_index] and abs(impact.time - time) <= max_delay:
            addition = _guess_from_impacts(
                [-1] * len(impacts) + [record_index], [*impacts, impact._replace(time=time)], direction
            )
            extensions.append(fit_chain(record, join_guesses(guess, addition, direction)))
        impacts.append(impact)
        if direction * (impact.time - time) > 0 or not flawed:
            break
    direct_guess = join_guesses(guess, guess_from_record(record, guess.parameters, [record_index]), direction)
    extensions.append(fit_chain(record, direct_guess))
    if flawed and not any(
        is_acceptable(record, candidate) and candidate.cost < chain.cost + EXPENSIVE_STEP for candidate in extensions
    ):
        flight = len(guess.record_indices) - 1 if direction > 0 else 0
        side_choices = [
            sides for n_inserted in (1, 2) for sides in product(wall_sides(record.scene), repeat=n_inserted)
        ]
        side_choices.sort(key=lambda sides: rate_insertions(record, direct_guess, flight, sides)[0])
        extensions += [
            fit_chain(record, candidate)
            for sides in side_choices[:MAX_INSERTIONS]
            for candidate in insert_impacts(record, direct_guess, flight, sides)
        ]
        extensions.append(
            chain._replace(spurious_indices=(*chain.spurious_indices, record_index), cost=chain.cost + SPURIOUS_COST)
        )
    return extensions
