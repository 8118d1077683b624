"""Strategies, aggregates, and the choice of the champion."""

from tests.mutation.change import Change

STRATEGY = "sysid_evo/evolution/mu_plus_lambda.py"
TEST_STRATEGY = ("tests/sysid_evo/test_mu_plus_lambda.py",)
TEST_EVOLUTION = ("tests/sysid_evo/test_controller_evolution.py",)

CHANGES = (
    Change(
        "the worst survive",
        STRATEGY,
        "np.argsort(-fitness[newest_first]",
        "np.argsort(fitness[newest_first]",
        TEST_STRATEGY,
    ),
    Change(
        "among equals the oldest survive",
        STRATEGY,
        "newest_first = np.arange(len(fitness))[::-1]",
        "newest_first = np.arange(len(fitness))",
        TEST_STRATEGY,
    ),
    Change(
        "every generation draws the same mutations",
        STRATEGY,
        "self._normal(self.generation + 1, self.n_children)",
        "self._normal(1, self.n_children)",
        TEST_STRATEGY,
    ),
    Change(
        "a restored strategy begins at the first generation",
        STRATEGY,
        'self._parents, self._parents_fitness, self.generation = parents.copy(), fitness, int(state["generation"])',
        "self._parents, self._parents_fitness, self.generation = parents.copy(), fitness, 0",
        TEST_STRATEGY,
    ),
    Change(
        "a strategy takes nan for a fitness",
        "sysid_evo/evolution/strategy.py",
        "if np.isnan(fitness).any():",
        "if np.isnan(fitness).all() and not len(fitness):",
        TEST_STRATEGY,
    ),
    Change(
        "the lowest fitness counts over trials, too",
        "sysid_evo/evolution/aggregates.py",
        "np.min(fitness.mean(axis=2), axis=0)",
        "np.min(fitness, axis=(0, 2))",
        ("tests/sysid_evo/test_aggregates.py",),
    ),
    Change(
        "every generation meets the same trials",
        "sysid_evo/evolution/ensemble.py",
        "trial_seeds(self.seed, self.trials, generation=generation)",
        "trial_seeds(self.seed, self.trials, generation=0)",
        TEST_EVOLUTION,
    ),
    Change(
        "the champion is whoever stands first",
        "sysid_evo/evolution/controllers.py",
        "winner = int(np.argmax(fitness))",
        "winner = 0",
        TEST_EVOLUTION,
    ),
    Change(
        "the champion is chosen on trials that evolution has met",
        "sysid_evo/evolution/controllers.py",
        "trial_seeds(seed, settings.selection_trials, generation=SELECTION)",
        "trial_seeds(run_seed, settings.selection_trials, generation=0)",
        TEST_EVOLUTION,
    ),
    Change(
        "the last run gives the champion, not the best",
        "sysid_evo/evolution/controllers.py",
        "best = max(champions, key=lambda pair: pair[0])[1]",
        "best = champions[-1][1]",
        TEST_EVOLUTION,
    ),
    Change(
        "a controller runs on a system that it was not evolved for",
        "sysid_evo/evolution/champion.py",
        "differences = () if self.system is None else self.system.differences(system)",
        "differences = ()",
        ("tests/evaluation/test_found_again.py::test_a_champion_is_refused_on_another_system",),
    ),
    Change(
        "the state is observed one sample too early",
        "sysid_evo/wrappers/delayed_estimate.py",
        "self._between(states[:, -1 - m], states[:, -2 - m])",
        "self._between(states[:, -1], states[:, -2 - m])",
        ("tests/sysid_evo/wrappers/test_delayed_estimate.py",),
    ),
)
