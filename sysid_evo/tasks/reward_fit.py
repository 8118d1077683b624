"""Fit of the reward and the end of episodes to the recording of an environment, with held-out errors."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.data.trajectory import TERMINATED, TRUNCATED, recording
from sysid_evo.errors import InvalidData
from sysid_evo.system import System
from sysid_evo.tasks.learned_reward import (
    DEPTH,
    NODES,
    TREE,
    LearnedReward,
    RewardQuality,
    distance_values,
    is_over,
    n_terms,
    network,
    polynomial,
    raw_features,
    terms_of,
)
from sysid_evo.types import Array, BoolArray, IntArray

FOLDS = 5
EPISODES = 2 * FOLDS
"""Minimum number of episodes from which whole ones are held out; blocks of time are held out of fewer."""
MOST_STEPS = 20_000
"""Number of steps that are used; of more, a random part, but every step that ended an episode."""
MOST_TERMS = 800
"""Products are left out of polynomials with more terms."""
STEPS_PER_TERM = 3
RIDGES = (1e-6, 1e-3, 1e-1)
"""Penalties of the coefficients of scaled features, times the number of steps."""
MARGIN = 1.0
"""Range of learned rewards beyond the recorded ones, on both sides, as a share of their range."""
SIMPLER = 1.02
"""A simpler form is used if its held-out error is at most this multiple of the lowest."""
FEWEST_ENDS = 3
HORIZON = 20.0
"""Steps over which wrong ends are counted when forms of the end are compared."""


@dataclass(frozen=True)
class _Steps:
    """N steps: scaled ``features`` (N, m), ``rewards``, whether they ``ended`` the episode, and their ``fold`` (N,).

    ``before`` (N, nx), ``control`` (N, nu) and ``after`` (N, nx) are those of ``system``; ``late`` (N,) are at the
    time limit.
    """

    system: System
    before: Array
    control: Array
    after: Array
    features: Array
    rewards: Array
    ended: BoolArray
    late: BoolArray
    fold: IntArray
    n_reached: int

    @property
    def reached(self) -> Array:
        return self.features[:, : self.n_reached]


def fit_reward(dataset: Dataset, limit: int = 0) -> tuple[LearnedReward, RewardQuality]:
    """Return reward and end of the episodes of ``dataset``, and their held-out errors.

    Steps that terminated an episode are modelled apart: where episodes end, and the reward there. Truncated episodes
    have no end; the last step of those with ``limit`` steps is modelled apart if it is not paid as others are. Every
    part is the form with the lowest error in cross-validation over episodes. Raises `InvalidData`
    without recorded rewards.
    """
    steps, centre, scale = _steps_of(dataset, limit)
    going = ~(steps.ended | steps.late)
    (step, distances, inner, outer), step_form, error = _step(steps, going)
    end, trees, limits, end_form, found, wrong = _end(steps)
    last, levels, last_form, last_error = _last(steps, None if len(outer) or len(distances) else step)
    paid, final = steps.rewards[going], steps.rewards[steps.ended]
    last_error *= float(final.std() / max(final.std(), steps.rewards.std(), 1e-12)) if len(final) else 1.0
    low, high = (paid.min(), paid.max()) if len(paid) else (final.min(), final.max())
    final_low, final_high = (final.min(), final.max()) if len(final) else (low, high)
    wider, final_wider = MARGIN * (high - low), 0.5 * MARGIN * (final_high - final_low)
    bounds = np.array([low - wider, high + wider, final_low - final_wider, final_high + final_wider])
    reward = LearnedReward(centre, scale, step, distances, inner, outer, end, trees, last, limits, levels, bounds)
    late, late_form, late_error = _late(steps, reward, error * float(paid.std()) if len(paid) else 0.0)
    reward = replace(reward, late=late)
    forms, ends = (step_form, end_form, last_form, late_form), int(steps.ended.sum())
    quality = RewardQuality(
        len(steps.rewards), len(dataset), ends, error, last_error, late_error, found=found, wrong=wrong, forms=forms
    )
    return LearnedReward.from_text(reward.to_text()), quality  # as it will be read


def _step(steps: _Steps, rows: BoolArray) -> tuple[tuple[Array, Array, Array, Array], str, float]:
    """Return terms, distances, inner and outer weights, form and held-out error of the reward of the steps ``rows``."""
    step, form, error = _fitted(steps.features[rows], steps.rewards[rows], steps.fold[rows])
    distances, inner, outer = np.zeros((0, 4)), np.zeros((0, 1 + steps.features.shape[1])), np.zeros(0)
    if error > ROUGH:
        with_distances = _with_distances(steps, rows, error)
        if with_distances is not None:
            step, distances, form, error = with_distances
    if error > ROUGH:
        found = _network(steps.features[rows], steps.rewards[rows], steps.fold[rows], error)
        if found is not None:
            step, inner, outer, error = found
            distances, form = np.zeros((0, 4)), f"linear terms and a network of {len(outer)} units"
    return (step, distances, inner, outer), form, error


def _late(steps: _Steps, reward: LearnedReward, error: float) -> tuple[LearnedReward | None, str, float]:
    """Return reward, form and held-out error of the step at the time limit; None if it is paid as others are.

    ``error`` is the held-out one of ``reward``, in which the steps at the time limit have no part.
    """
    rows, paid, spread = steps.late, steps.rewards[steps.late], float(steps.rewards.std())
    as_others, over = reward.judge(steps.system, steps.before[rows], steps.control[rows], steps.after[rows])
    off = float(np.sqrt(np.mean((as_others - paid)[~over] ** 2))) if not over.all() else 0.0
    if off <= max(OTHERS * error, ROUGH * spread):
        return None, "", np.nan
    size = max(float(paid.std()), spread)
    if rows.sum() >= EPISODES:
        # there are few of these steps, and what counts is where they lead
        (few, distances, inner, outer), form, own = _step(replace(steps, features=steps.reached), rows)
        own *= float(paid.std())
        if own <= BETTER * off:
            m, r = len(reward.centre), reward.n_reached
            step, (_, second) = np.zeros(n_terms(m)), np.triu_indices(m)
            step[np.concatenate([[True], np.arange(m) < r, second < r])] = few
            inner = np.pad(inner, ((0, 0), (0, m - r)))
            wider = MARGIN * float(np.ptp(paid))
            limits = np.array([paid.min() - wider, paid.max() + wider, *reward.range[2:]])
            paid_late = replace(reward, step=step, distances=distances, inner=inner, outer=outer, range=limits)
            return paid_late, form, own / size
    return None, "as of any other step", off / size


def _steps_of(dataset: Dataset, limit: int) -> tuple[_Steps, Array, Array]:
    """Return the steps of all episodes with rewards, scaled, and the centre and scale of their features."""
    system, parts = dataset.system, []
    paid = [episode for episode in dataset if episode.rewards is not None]
    if not paid:
        raise InvalidData(
            "the reward of the environment cannot be learned: the recording has no rewards. Record the environment "
            "again (sysid-evo record --robot 'gymnasium(id=...)'), or give the table a column named reward"
        )
    lengths = Counter[str]()
    for episode in paid:
        lengths[recording(episode.name)] += len(episode)
    for number, episode in enumerate(paid):
        rewards, count = episode.rewards, len(episode)
        assert rewards is not None
        ended = np.zeros(count, dtype=bool)
        ended[-1] = episode.ending == TERMINATED
        late = np.zeros(count, dtype=bool)
        late[-1] = episode.ending == TRUNCATED and lengths[recording(episode.name)] == limit
        fold = np.full(count, number % FOLDS) if len(paid) >= EPISODES else FOLDS * np.arange(count) // count
        moved = episode.states[:-1], episode.controls, episode.states[1:]
        parts.append((*moved, raw_features(system, *moved), rewards, ended, late, fold.astype(np.int64)))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    last, count = columns[5] | columns[6], len(columns[5])
    if count > MOST_STEPS:
        kept = np.random.default_rng(0).random(count) < MOST_STEPS / count
        columns = [column[kept | last] for column in columns]
    before, control, after, features, rewards, ended, late, fold = columns
    centre, spread = features.mean(axis=0), features.std(axis=0)
    scale: Array = np.where(spread > 1e-9 * np.maximum(1.0, np.abs(centre)), spread, 1.0)
    n_reached = system.nx + len(system.periods)
    features = (features - centre) / scale
    return _Steps(system, before, control, after, features, rewards, ended, late, fold, n_reached), centre, scale


FORMS = ("constant", "linear", "polynomial of degree 2 without products", "polynomial of degree 2")


def _columns(form: int, n: int) -> IntArray:
    """Return the terms of a form, by its place in `FORMS`."""
    rows, columns = np.triu_indices(n)
    products = np.flatnonzero(rows == columns) if form == 2 else np.arange(len(rows))
    parts = [np.zeros(1), 1 + np.arange(n), 1 + n + products]
    return np.concatenate(parts[: min(form, 2) + 1]).astype(np.int64)


def _usable_forms(n: int, count: int) -> list[int]:
    sizes = [1, 1 + n, 1 + 2 * n, n_terms(n)]
    return [
        form
        for form, size in enumerate(sizes)
        if form == 0 or (size * STEPS_PER_TERM <= count and (form < 3 or size <= MOST_TERMS))
    ]


def _fitted(features: Array, targets: Array, fold: IntArray) -> tuple[Array, str, float]:
    """Return coefficients, form and held-out error of a polynomial, chosen by that error."""
    n = features.shape[1]
    coefficients = np.zeros(n_terms(n))
    if not len(targets):
        return coefficients, FORMS[0], np.nan
    spread = float(targets.std())
    if spread <= 1e-9 * max(1.0, float(np.abs(targets).max())):
        coefficients[0] = targets.mean()
        return coefficients, FORMS[0], 0.0
    whole = terms_of(features)
    found = [
        (error, form, ridge)
        for form in _usable_forms(n, len(targets))
        for ridge, error in _ridge_errors(whole[:, _columns(form, n)], targets, fold)
    ]
    lowest = min(error for error, *_ in found)
    error, form, ridge = next(
        one for one in sorted(found, key=lambda one: (one[1], one[0])) if one[0] <= SIMPLER * lowest
    )
    columns = _columns(form, n)
    coefficients[columns] = _ridge(whole[:, columns], targets, ridge)
    return coefficients, FORMS[form], error / spread


def _solved(gram: Array, products: Array, ridge: float, count: int) -> Array:
    """Return the coefficients of a ridge regression; that of 1, the first, is hardly penalised."""
    penalty = np.full(len(gram), ridge * count)
    penalty[0] = 1e-9 * count
    return np.asarray(np.linalg.solve(gram + np.diag(penalty), products), dtype=np.float64)


def _ridge(terms: Array, targets: Array, ridge: float) -> Array:
    return _solved(terms.T @ terms, terms.T @ targets, ridge, len(targets))


def _ridge_errors(terms: Array, targets: Array, fold: IntArray) -> Iterator[tuple[float, float]]:
    """Yield each penalty and its root mean square error over the folds."""
    rows = [np.flatnonzero(fold == k) for k in np.unique(fold)]
    grams = [(terms[held].T @ terms[held], terms[held].T @ targets[held]) for held in rows]
    gram, products = sum(one for one, _ in grams), sum(one for _, one in grams)
    for ridge in RIDGES:
        squares = 0.0
        for held, (own, own_products) in zip(rows, grams, strict=True):
            if len(held) == len(targets):
                continue
            w = _solved(gram - own, products - own_products, ridge, len(targets) - len(held))
            squares += float(((terms[held] @ w - targets[held]) ** 2).sum())
        yield ridge, float(np.sqrt(squares / len(targets)))


ROUGH = 0.02
"""Held-out error of a polynomial from which a network is tried."""
BETTER = 0.8
"""Another form is used if its held-out error is at most this multiple of the polynomial's."""
OTHERS = 2.0
"""The step at the time limit is paid as others are if the error there is at most this multiple of their error."""


def _with_distances(steps: _Steps, going: BoolArray, error: float) -> tuple[Array, Array, str, float] | None:
    """Return terms, distances, form and held-out error of a polynomial with distances; None if hardly better.

    Candidates are the size of each control, and of each state and each pair of states the distance from neutral and its
    change in the step. Of these, those with the largest weights are kept, as few as have the same held-out error.
    """
    system, n = steps.system, steps.features.shape[1]
    rows, columns = np.triu_indices(system.nx)
    if 1 + n + system.nu + 2 * len(rows) > MOST_TERMS:
        rows = columns = np.arange(system.nx)
    own = system.nx + np.arange(system.nu)
    first, second = np.concatenate([own, rows, rows]), np.concatenate([own, columns, columns])
    change = np.arange(len(first)) >= len(own) + len(rows)
    table = np.stack([np.ones(len(first)), first, second, change], axis=1).astype(np.float64)
    values = distance_values(table, system, steps.before[going], steps.control[going], steps.after[going])
    size = values.std(axis=0)
    table, values, size = table[size > 0.0], values[:, size > 0.0], size[size > 0.0]
    values, whole = values / size, terms_of(steps.features[going])
    targets, fold = steps.rewards[going], steps.fold[going]
    found = []
    for form in (1, 3):
        used = whole[:, _columns(form, n)]
        if used.shape[1] + len(size) > min(MOST_TERMS, len(targets) // STEPS_PER_TERM):
            continue
        off, ridge = min((off, ridge) for ridge, off in _ridge_errors(np.hstack([used, values]), targets, fold))
        found.append((off, form, ridge))
    if not found or min(found)[0] > BETTER * error * targets.std():
        return None
    lowest, form, ridge = next(one for one in found if one[0] <= SIMPLER * min(found)[0])
    used = whole[:, _columns(form, n)]
    weights = _ridge(np.hstack([used, values]), targets, ridge)[used.shape[1] :]
    kept, off = np.argsort(-np.abs(weights), kind="stable"), lowest
    for count in 2 ** np.arange(int(np.log2(len(size))) + 1):
        terms = np.hstack([used, values[:, kept[:count]]])
        off = dict(_ridge_errors(terms, targets, fold))[ridge]
        if off <= SIMPLER * lowest:
            kept = kept[:count]
            break
    else:
        off = lowest
    weights = _ridge(np.hstack([used, values[:, kept]]), targets, ridge)
    step = np.zeros(n_terms(n))
    step[_columns(form, n)] = weights[: used.shape[1]]
    table = table[kept]
    table[:, 0] = weights[used.shape[1] :] / size[kept]
    terms_name = "linear terms" if form == 1 else FORMS[form]
    return step, table, f"{terms_name} and {len(table)} distance{'s' * (len(table) > 1)}", off / float(targets.std())


UNITS, WEIGHT_PENALTY, ITERATIONS = 24, 1e-4, 400
OF_NETWORK = 6000
"""Number of steps that a network is fitted to."""


def _network(features: Array, targets: Array, fold: IntArray, error: float) -> tuple[Array, Array, Array, float] | None:
    """Return linear terms, inner and outer weights and held-out error; None if it is hardly better than ``error``.

    The error is that of two folds.
    """
    squares, count = 0.0, 0
    for k in np.unique(fold)[:2]:
        held = fold == k
        if held.all():
            return None
        step, inner, outer = _trained(features[~held], targets[~held])
        off = polynomial(step, features[held]) + network(inner, outer, features[held]) - targets[held]
        squares, count = squares + float((off**2).sum()), count + int(held.sum())
    found = float(np.sqrt(squares / count) / targets.std())
    return (*_trained(features, targets), found) if found <= BETTER * error else None


def _trained(features: Array, targets: Array) -> tuple[Array, Array, Array]:
    """Return linear terms, and inner and outer weights of a network fitted to what they leave."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor

    n = features.shape[1]
    rows = np.random.default_rng(0).permutation(len(targets))[:OF_NETWORK]
    x, columns = features[rows], _columns(1, n)
    terms, step = terms_of(x)[:, columns], np.zeros(n_terms(n))
    step[columns] = _solved(terms.T @ terms, terms.T @ targets[rows], RIDGES[0], len(rows))
    left = targets[rows] - polynomial(step, x)
    size = max(float(left.std()), 1e-12)
    settings = {"activation": "tanh", "solver": "lbfgs", "alpha": WEIGHT_PENALTY, "max_iter": ITERATIONS}
    law = MLPRegressor(hidden_layer_sizes=(UNITS,), **settings, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        law.fit(x, left / size)
    step[0] += size * float(law.intercepts_[1][0])
    inner = np.concatenate([law.intercepts_[0][:, None], law.coefs_[0].T], axis=1)
    return step, inner, size * law.coefs_[1][:, 0]


NEVER = "none"


def _end(steps: _Steps) -> tuple[Array, Array, Array, str, float, float]:
    """Return score, trees, limits, form, share of the ends found and wrong ends in 1,000 steps.

    Trees are tried where the cost of the simple forms is above `ROUGH_END`; it is the share of the ends that are not
    found, plus the wrong ends in `HORIZON` steps.
    """
    r, ended = steps.n_reached, steps.ended
    never = np.zeros(n_terms(r))
    never[0] = -1.0
    if ended.sum() < FEWEST_ENDS:
        return never, NO_TREES, np.zeros((0, 3)), NEVER, 0.0 if ended.any() else np.nan, 0.0
    results = [_held_out_end(form, steps) for form in END_FORMS]
    lowest = min(results)[0]
    chosen = next(one for one in results if one[0] <= lowest + 0.01)
    if lowest > ROUGH_END:
        trees = _held_out_end(BOOSTED, steps)
        chosen = trees if trees[0] <= BETTER * lowest else chosen
    _, form, found, wrong = chosen
    return (*_end_of(form, steps.reached, ended), form, found, 1000.0 * wrong)


def _held_out_end(form: str, steps: _Steps) -> tuple[float, str, float, float]:
    """Return cost, form, share of the ends found and share of wrong ends, in cross-validation."""
    ended, over = steps.ended, np.zeros(len(steps.ended), dtype=bool)
    for k in np.unique(steps.fold):
        held = steps.fold == k
        if held.all() or not ended[~held].any():
            continue
        over[held] = is_over(*_end_of(form, steps.reached[~held], ended[~held]), steps.reached[held])
    found, wrong = float(over[ended].mean()), float(over[~ended].mean()) if (~ended).any() else 0.0
    return 1.0 - found + HORIZON * wrong, form, found, wrong


END_FORMS, BOOSTED = ("limits of states", "linear limit", "quadratic limit"), "boosted trees"
ROUGH_END = 0.1
"""Cost of the simple forms of an end from which trees are tried."""
NO_TREES = np.zeros((0, TREE))


def _end_of(form: str, reached: Array, ended: BoolArray) -> tuple[Array, Array, Array]:
    """Return score, trees and limits of a form of the end."""
    r = reached.shape[1]
    score = np.zeros(n_terms(r))
    score[0] = -1.0
    if form == END_FORMS[0]:
        return score, NO_TREES, _limits(reached, ended)
    if form == BOOSTED:
        score[0], trees = _boosted(reached, ended)
        return score, trees, np.zeros((0, 3))
    return _classified(reached, ended, 1 if form == END_FORMS[1] else 3), NO_TREES, np.zeros((0, 3))


def _limits(reached: Array, ended: BoolArray) -> Array:
    """Return the limits (k, 3) beyond which all recorded steps ended an episode, until all ends are beyond one."""
    left, limits = ended.copy(), list[tuple[float, float, float]]()
    enough = max(FEWEST_ENDS - 1, int(0.05 * ended.sum()))
    while left.any() and len(limits) < 2 * reached.shape[1]:
        best: tuple[int, int, float, float] | None = None
        for place in range(reached.shape[1]):
            for sign in (1.0, -1.0):
                inside = sign * reached[~ended, place]
                edge = inside.max() if len(inside) else -np.inf
                beyond = sign * reached[left, place]
                beyond = beyond[beyond > edge]
                if len(beyond) and (best is None or len(beyond) > best[0]):
                    best = (len(beyond), place, sign, 0.5 * (edge + beyond.min()))
        if best is None or best[0] < enough:
            break
        _, place, sign, edge = best
        limits.append((place, sign, sign * edge))
        left &= ~(sign * reached[:, place] > edge)
    return np.array(limits).reshape(-1, 3)


SHARPNESS = 1e4
"""Inverse penalty of logistic regression: limits are sharp."""
MOST_OTHERS = 5000
"""Number of steps without an end that a limit is fitted to."""


TREES, RATE, OF_EACH, FEWEST_IN_LEAF = 100, 0.15, 0.7, 5
"""Number of trees, learning rate, share of the steps for each tree, and minimum number of steps in a leaf."""
NOWHERE = 1e30
"""Threshold of a node that is no decision."""


def _boosted(reached: Array, ended: BoolArray) -> tuple[float, Array]:
    """Return the intercept and the trees (t, 22) of gradient boosting that minimise the cost of the end.

    Steps have the weights that they have in the cost: the end is at positive values.
    """
    from sklearn.ensemble import GradientBoostingClassifier

    others = np.flatnonzero(~ended)
    kept = np.random.default_rng(0).permutation(others)[:MOST_OTHERS]
    rows = np.concatenate([np.flatnonzero(ended), kept])
    weights = np.where(ended[rows], 1.0 / ended.sum(), HORIZON / max(len(kept), 1))
    settings = {"n_estimators": TREES, "max_depth": DEPTH, "learning_rate": RATE, "subsample": OF_EACH}
    law = GradientBoostingClassifier(**settings, min_samples_leaf=FEWEST_IN_LEAF, random_state=0)
    law.fit(reached[rows], ended[rows], sample_weight=weights * len(rows) / weights.sum())
    prior = float(law.init_.class_prior_[1])
    return float(np.log(prior / (1.0 - prior))), np.array([_complete(one.tree_) for one in law.estimators_[:, 0]])


def _complete(tree: Any) -> Array:
    """Return a tree of scikit-learn as a complete one of `DEPTH`, see `tree_values`."""
    table = np.zeros(TREE)
    table[NODES : 2 * NODES] = NOWHERE

    def fill(place: int, node: int) -> None:
        is_leaf = tree.children_left[node] < 0
        if place >= NODES:
            table[NODES + place] = RATE * tree.value[node, 0, 0]
            return
        if not is_leaf:
            table[place], table[NODES + place] = tree.feature[node], tree.threshold[node]
        fill(2 * place + 1, node if is_leaf else tree.children_left[node])
        fill(2 * place + 2, node if is_leaf else tree.children_right[node])

    fill(0, 0)
    return table


def _classified(reached: Array, positive: BoolArray, form: int) -> Array:
    """Return the coefficients of a polynomial that is positive where ``positive`` (N,), by logistic regression."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import LogisticRegression

    r = reached.shape[1]
    columns = _columns(form, r)
    coefficients = np.zeros(n_terms(r))
    if positive.all() or not positive.any():
        coefficients[0] = 1.0 if positive.all() else -1.0
        return coefficients
    others = np.flatnonzero(~positive)
    kept = np.random.default_rng(0).permutation(others)[:MOST_OTHERS]
    rows = np.concatenate([np.flatnonzero(positive), kept])
    weights = np.where(positive[rows], 1.0, len(others) / len(kept))
    terms = terms_of(reached[rows])[:, columns[1:]]
    law = LogisticRegression(C=SHARPNESS, max_iter=2000, tol=1e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        law.fit(terms, positive[rows], sample_weight=weights)
    coefficients[columns[1:]] = law.coef_[0]
    coefficients[0] = law.intercept_[0]
    return coefficients


def _last(steps: _Steps, step: Array | None) -> tuple[Array, Array, str, float]:
    """Return polynomial, levels, form and held-out error of the reward of the step that ends an episode."""
    ended = steps.ended
    reached, rewards, fold = steps.reached[ended], steps.rewards[ended], steps.fold[ended]
    last, form, error = _fitted(reached, rewards, fold)
    if error > 0.0 and step is not None:
        off = polynomial(step, steps.features[ended]) - rewards
        of_step = float(np.sqrt(np.mean(off**2)) / rewards.std())
        if of_step <= error:
            return step, np.zeros(0), "as of any other step", of_step
    if len(rewards) < 2 * FEWEST_ENDS or error == 0.0:
        return last, np.zeros(0), form, error
    order = np.sort(rewards)
    gap = int(np.argmax(np.diff(order)))
    edge = 0.5 * (order[gap] + order[gap + 1])
    upper = rewards > edge
    if min(upper.sum(), (~upper).sum()) < FEWEST_ENDS:
        return last, np.zeros(0), form, error
    held_out = np.zeros(len(rewards))
    for k in np.unique(fold):
        held = fold == k
        if held.all():
            return last, np.zeros(0), form, error
        law = _classified(reached[~held], upper[~held], 1)
        levels = _levels(rewards[~held], edge)
        held_out[held] = np.where(polynomial(law, reached[held]) > 0.0, levels[1], levels[0])
    of_two = float(np.sqrt(np.mean((held_out - rewards) ** 2)) / rewards.std())
    if of_two >= error:
        return last, np.zeros(0), form, error
    law = _classified(reached, upper, 1)
    levels = _levels(rewards, edge)
    return law, levels, f"{levels[0]:.4g} or {levels[1]:.4g} by a linear limit", of_two


def _levels(rewards: Array, edge: float) -> Array:
    """Return the mean rewards below and above ``edge``, which are equal if there are none on one side."""
    sides = [rewards[rewards <= edge], rewards[rewards > edge]]
    return np.array([side.mean() if len(side) else rewards.mean() for side in sides])
