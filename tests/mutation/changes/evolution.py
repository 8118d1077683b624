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
    Change(
        "the best outcomes count as the risk",
        "sysid_evo/evolution/aggregates.py",
        "worst_first = np.sort(fitness.transpose(1, 0, 2)",
        "worst_first = -np.sort(-fitness.transpose(1, 0, 2)",
        ("tests/sysid_evo/test_aggregates.py",),
    ),
    Change(
        "a model that denies a candidate may forbid everything",
        "sysid_evo/evolution/aggregates.py",
        "np.maximum(means.min(axis=0), median",
        "np.minimum(means.min(axis=0), median",
        ("tests/sysid_evo/test_aggregates.py",),
    ),
    Change(
        "luck is added to the confidence",
        "sysid_evo/evolution/aggregates.py",
        "fitness.mean(axis=2) - self.weight * error",
        "fitness.mean(axis=2) + self.weight * error",
        ("tests/sysid_evo/test_aggregates.py",),
    ),
    Change(
        "all models are run, whatever the aggregate draws",
        "sysid_evo/evolution/ensemble.py",
        "chosen = self._rule.models(len(self.runners), generation)",
        "chosen = np.arange(len(self.runners))",
        ("tests/sysid_evo/test_controller_evolution.py",),
    ),
    Change(
        "evolution climbs the claim, not what the aggregate says of a population",
        "sysid_evo/evolution/ensemble.py",
        "Scores(self._rule.in_population(fitness)",
        "Scores(self._rule(fitness)",
        ("tests/sysid_evo/test_controller_evolution.py",),
    ),
    Change(
        "a restart is as large as the start before it",
        "sysid_evo/evolution/restarts.py",
        "round(size * self.growth**number)",
        "round(size)",
        ("tests/sysid_evo/test_restarts.py",),
    ),
    Change(
        "a restart forgets what was found before",
        "sysid_evo/evolution/restarts.py",
        "self._ended = self._starts()[: REMEMBERED - 1]",
        "self._ended = []",
        ("tests/sysid_evo/test_restarts.py",),
    ),
    Change(
        "what is asked again counts as if it were the first time",
        "sysid_evo/evolution/map_elites.py",
        "share = 1.0 / times[-len(old) :]",
        "share = np.ones(len(old))",
        ("tests/sysid_evo/test_map_elites.py",),
    ),
    Change(
        "models that nobody beats on all at once are not told apart",
        "sysid_evo/evolution/nsga2.py",
        "objectives = fitness[None] if self.by_model is None else self.by_model",
        "objectives = fitness[None]",
        ("tests/sysid_evo/test_nsga2.py",),
    ),
)
