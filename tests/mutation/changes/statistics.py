"""Verdicts and the statistics behind them."""

from tests.mutation.change import Change

CLAIMS = "evaluation/transfer/summary.py"
SUMMARY = "evaluation/transfer/summary.py"
TEST_CLAIMS = "tests/evaluation/test_claims.py"
TEST_TRANSFER = "tests/evaluation/test_transfer.py"
TEST_PREDICTION = "tests/evaluation/test_prediction.py"
TEST_VERDICT = "tests/evaluation/test_verdict.py"
TEST_EXPLOITABILITY = "tests/evaluation/test_exploitability.py"

RESIDUALS = "evaluation/prediction/residuals.py"
TEST_RESIDUALS = "tests/evaluation/test_residuals.py"
TEST_WHERE = "tests/evaluation/test_where_errors_are.py"
TEST_ADVICE = "tests/evaluation/test_advice_on_models.py"

CHANGES = (
    Change(
        "a claim is exploited when one of the two rules says so",
        CLAIMS,
        "gap.value > max(LEAST_GAP",
        "gap.value > min(LEAST_GAP",
        (TEST_CLAIMS,),
    ),
    Change("one standard error is enough for an exploited claim", CLAIMS, "SURE = 2.0", "SURE = 1.0", (TEST_CLAIMS,)),
    Change(
        "the error of a claim is that of n instead of n - 1",
        CLAIMS,
        "(RESAMPLES, trials - 1)",
        "(RESAMPLES, trials)",
        (TEST_CLAIMS,),
    ),
    Change(
        "differences between systems are not paired",
        CLAIMS,
        "np.random.default_rng(seed).integers(0, trials",
        "np.random.default_rng().integers(0, trials",
        (TEST_TRANSFER,),
    ),
    Change(
        "the claim is the mean, whatever rule the controller was evolved by",
        CLAIMS,
        "rule = make_aggregate(champion.aggregate)",
        'rule = make_aggregate("mean")',
        (TEST_CLAIMS, TEST_TRANSFER),
    ),
    Change(
        "a controller that was driven on the robot is judged by the other models",
        SUMMARY,
        "gap = self.exploitation_gap if self.achieved is None else self.reality_gap",
        "gap = self.exploitation_gap",
        (TEST_CLAIMS,),
    ),
    Change(
        "the controller to use is picked by a mean of other families",
        SUMMARY,
        "np.median(judged, axis=0)",
        "np.mean(judged, axis=0)",
        (TEST_TRANSFER,),
    ),
    Change(
        "a model of the same family is a judge",
        "evaluation/transfer/summary.py",
        "[column for column in matrix.models if matrix.families[column] not in families]",
        "list(matrix.models)",
        (TEST_TRANSFER,),
    ),
    Change(
        "a controller evolved on the robot is picked without it",
        SUMMARY,
        "if c.against and not c.on_robot]",
        "if c.against]",
        (TEST_TRANSFER,),
    ),
    Change(
        "a correlation of numbers is told as one of ranks",
        "evaluation/transfer/summary.py",
        "np.corrcoef(mean_ranks(first), mean_ranks(second))",
        "np.corrcoef(first, second)",
        (TEST_TRANSFER,),
    ),
    Change(
        "a person who drives is chosen as the best controller",
        "evaluation/transfer/matrix.py",
        "evolved = [champion.name for champion in self.champions if champion.against]",
        "evolved = [champion.name for champion in self.champions]",
        ("tests/evaluation/test_measured.py",),
    ),
    Change(
        "an emulated robot that is driven counts before the physical one",
        "evaluation/transfer/matrix.py",
        "if item.physical or (not physical and (matrix is None or matrix.robot is None)):",
        "if True:",
        ("tests/evaluation/test_measured.py",),
    ),
    Change(
        "a column of measured cells is taken for a model",
        "evaluation/transfer/matrix.py",
        "other_robots=tuple(name for name in robots if name != robot),",
        "other_robots=(),",
        ("tests/evaluation/test_measured.py",),
    ),
    Change(
        "the trials of the matrix are those on which champions were chosen",
        "evaluation/transfer/matrix.py",
        "TRANSFER = 2**31 + 1",
        "TRANSFER = 2**31",
        (TEST_TRANSFER,),
    ),
    Change(
        "Ctrl-C while a controller runs is a failed cell",
        "evaluation/transfer/matrix.py",
        "except Exception as error:  # a plugin or a robot",
        "except BaseException as error:  # a plugin or a robot",
        (TEST_TRANSFER,),
    ),
    Change(
        "Ctrl-C while a model predicts is a failed row",
        "evaluation/prediction/scoring.py",
        "except Exception as error:  # a plugin may fail",
        "except BaseException as error:  # a plugin may fail",
        (TEST_PREDICTION,),
    ),
    Change(
        "a probe finds something in one step of a thousand",
        "evaluation/exploitability/results.py",
        "LEAST_SHARE = 0.01",
        "LEAST_SHARE = 0.001",
        (TEST_EXPLOITABILITY,),
    ),
    Change(
        "a probe finds something at the normal share",
        "evaluation/exploitability/results.py",
        "TIMES_NORMAL = 3.0",
        "TIMES_NORMAL = 1.0",
        (TEST_EXPLOITABILITY,),
    ),
    Change(
        "the limit of a probe is passed by one training step in a hundred",
        "evaluation/exploitability/probes.py",
        "QUANTILE = 0.999",
        "QUANTILE = 0.99",
        (TEST_EXPLOITABILITY,),
    ),
    Change(
        "an interval of 95 % is one of 90 %",
        "evaluation/prediction/cases.py",
        "confidence: float = 0.95",
        "confidence: float = 0.90",
        ("tests/evaluation/test_bootstrap.py",),
    ),
    Change(
        "the tails of an interval are twice as large",
        "sysid_evo/validation/bootstrap.py",
        "tail = 50.0 *",
        "tail = 100.0 *",
        ("tests/evaluation/test_bootstrap.py",),
    ),
    Change(
        "two models meet different draws of blocks",
        "sysid_evo/validation/bootstrap.py",
        "rng = np.random.default_rng(seed)",
        "rng = np.random.default_rng()",
        ("tests/evaluation/test_bootstrap.py",),
    ),
    Change(
        "overlapping windows are drawn one by one instead of in blocks",
        "evaluation/prediction/cases.py",
        "np.repeat(first, count)) // size",
        "np.repeat(first, count)) // 1",
        ("tests/evaluation/test_bootstrap.py", TEST_PREDICTION),
    ),
    Change(
        "samples of a free run are drawn one by one instead of in blocks",
        "evaluation/prediction/scoring.py",
        "// cases.protocol.block_samples",
        "// 1",
        ("tests/evaluation/test_bootstrap.py", TEST_PREDICTION),
    ),
    Change(
        "a history is padded with the last state",
        "evaluation/prediction/cases.py",
        "episode.states[np.maximum(places, oldest)]",
        "episode.states[np.where(places < oldest, starts[:, None], places)]",
        ("tests/evaluation/test_forecasts.py",),
    ),
    Change(
        "a history is padded with controls of zero",
        "evaluation/prediction/cases.py",
        "np.where(made_up, self.system.neutral_control, controls)",
        "np.where(made_up, 0.0, controls)",
        ("tests/evaluation/test_forecasts.py",),
    ),
    Change(
        "the verdict stands at a horizon below one second",
        "evaluation/prediction/cases.py",
        "if horizon <= headline_steps(dt)]",
        "if horizon < headline_steps(dt)]",
        (TEST_VERDICT,),
    ),
    Change(
        "a model no better than a constant is called best",
        "evaluation/sufficiency.py",
        "USELESS = 1.0",
        "USELESS = 1.5",
        (TEST_VERDICT,),
    ),
    Change(
        "a model whose interval holds that of the mean is called best",
        "evaluation/sufficiency.py",
        "score.interval.high < USELESS",
        "score.n < USELESS",
        (TEST_VERDICT,),
    ),
    Change(
        "a claim is kept from four fifths of it on",
        "evaluation/report/sections/controllers.py",
        "KEPT = 0.9",
        "KEPT = 0.8",
        (TEST_VERDICT,),
    ),
    Change(
        "controls are looked for after the step instead of before it",
        RESIDUALS,
        "controls[max(-lag, 0) : rows - max(lag, 0)]",
        "controls[max(lag, 0) : rows - max(-lag, 0)]",
        (TEST_RESIDUALS,),
    ),
    Change(
        "the fit is in the scale of the whole test set",
        "evaluation/prediction/scoring.py",
        "std=system.spread(run.states)",
        "std=cases.std",
        (TEST_WHERE,),
    ),
    Change(
        "what a hidden state explains counts for late controls",
        "evaluation/advice/one_step.py",
        "min(best, max(own)) < SHARE",
        "best < SHARE",
        (TEST_ADVICE,),
    ),
    Change(
        "a recording of other states is another condition",
        "evaluation/advice/generalisation.py",
        "alike = distance <= usual",
        "alike = distance >= 0.0",
        (TEST_ADVICE,),
    ),
    Change(
        "the noise is that of two steps, not of one",
        "evaluation/advice/one_step.py",
        "0.5 * np.mean",
        "1.0 * np.mean",
        (TEST_ADVICE,),
    ),
    Change(
        "what follows from something else is told, too",
        "evaluation/advice/advise.py",
        "if one.topic not in explained), key=",
        "), key=",
        (TEST_ADVICE,),
    ),
)
