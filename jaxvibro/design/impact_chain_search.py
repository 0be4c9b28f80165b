"""Search for the chain of impacts that explains a record.

A chain starts with a few consecutive impacts of the record and grows in both directions. The motion is continued from
the end of the chain. The errors of the parameters and of the end are propagated to the predicted impacts. A predicted
impact is matched with an impact of the record if the two agree. A predicted impact well before the next impact of
the record is missing from the record. If the errors allow several matches, several chains are continued, and later
impacts decide between them.
"""

from itertools import product

import numpy as np

from .impact_chain_equations import ChainNodes, flight_residuals
from .impact_chains import (
    IMPOSSIBLE_COST,
    SPURIOUS_COST,
    ImpactChain,
    ImpactChainGuess,
    ImpactFitProblem,
    fit_chain,
    guess_from_chain,
    guess_from_record,
    insert_impacts,
    is_acceptable_chain,
    join_guesses,
    rank_insertion_times,
    remove_node,
    squared_speed_mismatches,
    wall_side_codes,
)
from .impact_prediction import Impact, next_impacts

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


def match_impact_record(fit_problem: ImpactFitProblem, allow_flaws: bool) -> ImpactChain | None:
    """Return the `ImpactChain` that explains the most impacts of a record, or None if no first chain is acceptable.

    The cost of the chain is at least `IMPOSSIBLE_COST` if the chain does not explain the whole record. `allow_flaws`
    allows missing and spurious impacts."""
    longest_chain_so_far = None
    for start_chain in _generate_start_chains(fit_problem, allow_flaws):
        chain_after_growth = _grow_chain(fit_problem, allow_flaws, start_chain)
        if is_acceptable_chain(chain_after_growth):
            return chain_after_growth
        longest_chain_so_far = (
            chain_after_growth
            if longest_chain_so_far is None
            or len(chain_after_growth.record_indices) > len(longest_chain_so_far.record_indices)
            else longest_chain_so_far
        )
    return longest_chain_so_far


def _generate_start_chains(fit_problem, allow_flaws):
    """Yield the chains from which the search starts, the most plausible first.

    Chains of consecutive impacts from several positions in the record come first. If `allow_flaws`, chains with
    inserted or removed impacts follow."""
    n_start_impacts, initial_parameters = min(FIRST_IMPACTS, len(fit_problem.times)), fit_problem.free_spec.start_values
    first_chain = fit_chain(fit_problem, guess_from_record(fit_problem, initial_parameters, np.arange(n_start_impacts)))
    is_first_chain_cheap = is_acceptable_chain(first_chain) and first_chain.cost <= EASY_COST
    if is_first_chain_cheap:
        yield first_chain
    chain_candidates = [
        fit_chain(
            fit_problem,
            guess_from_record(
                fit_problem, parameters, np.arange(first_record_index, first_record_index + n_start_impacts)
            ),
        )
        for first_record_index, parameters in _rank_start_windows(fit_problem, n_start_impacts)
    ]
    chain_candidates += [] if is_first_chain_cheap else [first_chain]
    yield from sorted(
        (candidate for candidate in chain_candidates if is_acceptable_chain(candidate)),
        key=lambda candidate: candidate.cost,
    )[:MAX_START_WINDOWS]
    if allow_flaws:
        yield from _start_chains_by_edits(fit_problem, initial_parameters, n_start_impacts)


def _rank_start_windows(fit_problem, n_start_impacts):
    """Return (index of the first impact, parameters) of plausible first chains, sorted by speed mismatch.

    If the frequency is a free parameter, many frequencies are tried, because a small error of the frequency causes a
    large error of the phase of a late impact.
    """
    free_spec, record_times = fit_problem.free_spec, fit_problem.times
    initial_parameters, trial_parameters = free_spec.start_values, [free_spec.start_values]
    if "frequency" in free_spec.names:
        index = free_spec.names.index("frequency")
        frequency_half_width = FREQUENCY_SCALES * free_spec.scales[index]
        n_frequencies = (
            int(
                min(
                    MAX_FREQUENCIES,
                    np.ceil(2.0 * frequency_half_width * (record_times[-1] - min(record_times[0], 0.0)) / PHASE_STEP),
                )
            )
            + 1
        )
        parameter_shifts = np.linspace(-frequency_half_width, frequency_half_width, n_frequencies)[:, None] * (
            np.arange(len(initial_parameters)) == index
        )
        trial_parameters = list(
            initial_parameters + parameter_shifts[initial_parameters[index] + parameter_shifts[:, index] > 0]
        )
    speed_mismatches = np.array(
        [
            squared_speed_mismatches(
                fit_problem, guess_from_record(fit_problem, parameters, np.arange(len(record_times)))
            )
            for parameters in trial_parameters
        ]
    )
    window_mismatches = np.cumsum(np.pad(speed_mismatches, ((0, 0), (1, 0))), axis=1)
    window_mismatches = (
        window_mismatches[:, n_start_impacts - 2 :]
        - window_mismatches[:, : window_mismatches.shape[1] - n_start_impacts + 2]
    )
    padded_mismatches = np.pad(window_mismatches, ((1, 1), (0, 0)), constant_values=np.inf)
    minimum_indices = np.argwhere(
        (window_mismatches <= padded_mismatches[:-2]) & (window_mismatches <= padded_mismatches[2:])
    )
    minimum_indices = sorted(minimum_indices, key=lambda minimum: window_mismatches[minimum[0], minimum[1]])
    return [
        (int(first_record_index), trial_parameters[index])
        for index, first_record_index in minimum_indices[:MAX_FITTED_WINDOWS]
    ]


def _start_chains_by_edits(fit_problem, parameters, n_start_impacts):
    """Yield chains of the first impacts with one or two impacts inserted, or one impact removed, sorted by cost."""
    chain_guess = guess_from_record(fit_problem, parameters, np.arange(n_start_impacts))
    single_insertion_guesses = _guesses_with_insertion(fit_problem, chain_guess, range(n_start_impacts - 1))
    double_insertion_guesses = [
        double_insertion_guess
        for candidate in single_insertion_guesses
        for double_insertion_guess in _guesses_with_insertion(
            fit_problem, candidate, range(_inserted_node_index(candidate) + 1, len(candidate.record_indices) - 1)
        )
    ]
    deletion_guesses = [remove_node(chain_guess, node_index) for node_index in range(1, n_start_impacts - 1)]
    trial_guesses = sorted(
        [*single_insertion_guesses, *double_insertion_guesses, *deletion_guesses],
        key=lambda trial: np.sum(squared_speed_mismatches(fit_problem, trial)),
    )
    candidates = [fit_chain(fit_problem, trial_guess) for trial_guess in trial_guesses[:MAX_FITTED_INSERTIONS]]
    yield from sorted(
        (candidate for candidate in candidates if is_acceptable_chain(candidate)),
        key=lambda candidate: candidate.cost,
    )[:MAX_START_INSERTIONS]


def _guesses_with_insertion(fit_problem, chain_guess, flight_indices):
    """Return the guesses with one impact inserted in one of the given flights, for every flight and wall."""
    flights_and_sides = product(flight_indices, wall_side_codes(fit_problem.free_spec.scene))
    return [
        longer_guess
        for flight_index, side in flights_and_sides
        for longer_guess in insert_impacts(fit_problem, chain_guess, flight_index, (side,))
    ]


def _inserted_node_index(chain_guess):
    """Return the index of the last node whose impact is missing from the record."""
    return int(np.flatnonzero(chain_guess.record_indices < 0)[-1])


def _covered_record_range(chain):
    """Return the range (first, end) of record indices that a chain covers."""
    record_indices = [*chain.record_indices[chain.record_indices >= 0], *chain.spurious_indices]
    return min(record_indices), max(record_indices) + 1


def _grow_chain(fit_problem, allow_flaws, start_chain):
    """Grow a chain until it explains the whole record; return the cheapest `ImpactChain`.

    The cost is increased by `IMPOSSIBLE_COST` if the chain cannot be extended to the whole record.
    """
    chains, n_record_impacts = [start_chain], len(fit_problem.times)
    while True:
        first_record_index, covered_range_end = _covered_record_range(chains[0])
        if first_record_index == 0 and covered_range_end == n_record_impacts:
            return chains[0]
        time_direction = 1 if covered_range_end < n_record_impacts else -1
        longer_chain = (
            _extend_by_sure_impacts(fit_problem, allow_flaws, chains[0], time_direction) if len(chains) == 1 else None
        )
        if longer_chain is not None:
            chains = [longer_chain]
            continue
        longer_chains = _extend_to_next_impact(fit_problem, allow_flaws, chains, time_direction)
        if not longer_chains:
            return chains[0]._replace(cost=chains[0].cost + IMPOSSIBLE_COST)
        chains = longer_chains


def _extend_to_next_impact(fit_problem, allow_flaws, chains, time_direction):
    """Extend chains by the next impact of the record; return the acceptable extensions, sorted by cost."""
    best_chain_by_key = {}
    for chain in chains:
        for extension in _extensions_of_chain(fit_problem, allow_flaws, chain, time_direction):
            chain_key = (tuple(extension.record_indices), tuple(extension.solution.nodes.sides))
            if (
                is_acceptable_chain(extension)
                and extension.cost < best_chain_by_key.get(chain_key, extension._replace(cost=np.inf)).cost
            ):
                best_chain_by_key[chain_key] = extension
    first_record_index, covered_range_end = _covered_record_range(chains[0])
    max_n_spurious = 1 + MAX_SPURIOUS_SHARE * (covered_range_end - first_record_index)
    sorted_extensions = sorted(
        (chain for chain in best_chain_by_key.values() if len(chain.spurious_indices) <= max_n_spurious),
        key=lambda chain: chain.cost,
    )
    return [
        chain for chain in sorted_extensions[:MAX_CHAINS] if chain.cost <= sorted_extensions[0].cost + MAX_EXTRA_COST
    ]


def _predict_impacts(fit_problem, chain, end_time, max_impacts, time_direction):
    """Return [(impact, standard error of its time)] of the motion beyond the end of a chain.

    The prediction ends at `end_time` or after `max_impacts` impacts.
    """
    free_spec, solution = fit_problem.free_spec, chain.solution
    end_node_index, n_params = len(solution.nodes.sides) - 1 if time_direction > 0 else 0, len(solution.parameters)
    chain_end_impact = Impact(*(float(column[end_node_index]) for column in solution.nodes))
    predicted_impacts = next_impacts(
        *free_spec.scene_and_start_phase(solution.parameters), chain_end_impact, end_time, max_impacts, time_direction
    )
    if not predicted_impacts:
        return []
    predicted_nodes = ChainNodes(*np.array([chain_end_impact, *predicted_impacts][::time_direction]).T)
    derivatives = flight_residuals(free_spec, predicted_nodes, solution.parameters)[1][::time_direction]
    near_node_derivatives, far_node_derivatives = (derivatives[:, :, :2], derivatives[:, :, 2:4])[::time_direction]
    covariance, node_sensitivity, time_errors = (
        solution.covariance_with([2 * end_node_index, 2 * end_node_index + 1]),
        np.eye(2, 2 + n_params),
        [],
    )
    for impact_index in range(len(predicted_impacts)):
        parameter_derivatives = np.concatenate([np.zeros((2, 2)), derivatives[impact_index, :, 4:]], 1)
        node_sensitivity = -np.linalg.pinv(far_node_derivatives[impact_index]) @ (
            near_node_derivatives[impact_index] @ node_sensitivity + parameter_derivatives
        )
        time_errors.append(float(np.sqrt(max(node_sensitivity[0] @ covariance @ node_sensitivity[0], 0.0))))
    return list(zip(predicted_impacts, time_errors, strict=True))


def _record_indices_ahead(fit_problem, chain, time_direction, max_indices):
    """Return the indices of the impacts of the record beyond the end of a chain, the nearest first."""
    first_record_index, covered_range_end = _covered_record_range(chain)
    return (
        np.arange(covered_range_end, len(fit_problem.times))[:max_indices]
        if time_direction > 0
        else np.arange(first_record_index - 1, -1, -1)[:max_indices]
    )


def _guess_from_predictions(record_indices, predicted_impacts, time_direction):
    """Return the `ImpactChainGuess` of predicted impacts, in order of time.

    `record_indices` and `predicted_impacts` begin with the impact that is nearest to the end of the chain.
    """
    sides, times, speeds = (
        np.array(column, float) for column in zip(*predicted_impacts[::time_direction], strict=True)
    )
    return ImpactChainGuess(np.array(record_indices[::time_direction], int), sides, times, speeds, (), np.zeros(0))


def _extend_by_sure_impacts(fit_problem, allow_flaws, chain, time_direction):
    """Extend a chain by all impacts whose match is certain.

    Returns None if there is no such impact, or if the extended chain is not acceptable.
    """
    record_indices_ahead = _record_indices_ahead(
        fit_problem, chain, time_direction, max(2, int(GROWTH_FRACTION * len(chain.record_indices)))
    )
    end_time = (
        fit_problem.times[record_indices_ahead[-1]]
        + time_direction * 2.0 * MATCH_ERRORS * SURE_ERRORS * fit_problem.sigma[0]
    )
    predicted_impacts, record_indices, n_matched = [], [], 0
    for predicted_impact, time_error in _predict_impacts(
        fit_problem, chain, end_time, 2 * len(record_indices_ahead), time_direction
    ):
        record_index = record_indices_ahead[n_matched]
        max_time_difference = MATCH_ERRORS * np.hypot(time_error, fit_problem.sigma[record_index])
        time_difference = time_direction * (fit_problem.times[record_index] - predicted_impact.time)
        is_match = (
            predicted_impact.side == fit_problem.sides[record_index] and abs(time_difference) <= max_time_difference
        )
        if time_error > SURE_ERRORS * fit_problem.sigma[record_index] or not (
            is_match or (allow_flaws and time_difference > 2.0 * max_time_difference)
        ):
            break
        predicted_impacts, record_indices, n_matched = (
            [*predicted_impacts, predicted_impact],
            [*record_indices, record_index if is_match else -1],
            n_matched + is_match,
        )
        if n_matched == len(record_indices_ahead):
            break
    while record_indices and record_indices[-1] < 0:
        predicted_impacts, record_indices = predicted_impacts[:-1], record_indices[:-1]
    if not record_indices:
        return None
    longer_chain = fit_chain(
        fit_problem,
        join_guesses(
            guess_from_chain(chain),
            _guess_from_predictions(record_indices, predicted_impacts, time_direction),
            time_direction,
        ),
    )
    return longer_chain if is_acceptable_chain(longer_chain) else None


def _extensions_of_chain(fit_problem, allow_flaws, chain, time_direction):
    """Return the chains that explain the next impact of the record in any plausible way."""
    record_index, chain_guess = (
        int(_record_indices_ahead(fit_problem, chain, time_direction, 1)[0]),
        guess_from_chain(chain),
    )
    record_time, covered_record_range = fit_problem.times[record_index], _covered_record_range(chain)
    time_gap = abs(
        record_time - fit_problem.times[covered_record_range[1] - 1 if time_direction > 0 else covered_record_range[0]]
    )
    extensions, predicted_impacts = [], []
    for predicted_impact, time_error in _predict_impacts(
        fit_problem, chain, record_time + time_direction * time_gap, MAX_LOOKAHEAD, time_direction
    ):
        max_time_difference = MATCH_ERRORS * np.hypot(time_error, fit_problem.sigma[record_index])
        if (
            predicted_impact.side == fit_problem.sides[record_index]
            and abs(predicted_impact.time - record_time) <= max_time_difference
        ):
            predicted_guess = _guess_from_predictions(
                [-1] * len(predicted_impacts) + [record_index],
                [*predicted_impacts, predicted_impact._replace(time=record_time)],
                time_direction,
            )
            extensions.append(fit_chain(fit_problem, join_guesses(chain_guess, predicted_guess, time_direction)))
        predicted_impacts.append(predicted_impact)
        if time_direction * (predicted_impact.time - record_time) > 0 or not allow_flaws:
            break
    guess_without_insertion = join_guesses(
        chain_guess, guess_from_record(fit_problem, chain_guess.parameters, [record_index]), time_direction
    )
    extensions.append(fit_chain(fit_problem, guess_without_insertion))
    if allow_flaws and not any(
        is_acceptable_chain(candidate) and candidate.cost < chain.cost + EXPENSIVE_STEP for candidate in extensions
    ):
        flight_index = len(chain_guess.record_indices) - 1 if time_direction > 0 else 0
        side_sequences = [
            sides
            for n_insertions in (1, 2)
            for sides in product(wall_side_codes(fit_problem.free_spec.scene), repeat=n_insertions)
        ]
        side_sequences.sort(
            key=lambda sides: rank_insertion_times(fit_problem, guess_without_insertion, flight_index, sides)[0]
        )
        extensions += [
            fit_chain(fit_problem, candidate)
            for sides in side_sequences[:MAX_INSERTIONS]
            for candidate in insert_impacts(fit_problem, guess_without_insertion, flight_index, sides)
        ]
        extensions.append(
            chain._replace(spurious_indices=(*chain.spurious_indices, record_index), cost=chain.cost + SPURIOUS_COST)
        )
    return extensions
