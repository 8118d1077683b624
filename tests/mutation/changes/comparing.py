"""What is said of controllers: figures over trials, forecasts, manners, studies."""

from tests.mutation.change import Change

UNCERTAINTY = "evaluation/transfer/uncertainty.py"
PAIRED = ("tests/evaluation/test_uncertainty.py",)
STANDING = ("tests/evaluation/test_standing.py",)
FORECASTS = ("tests/evaluation/forecast/test_forecasting.py", "tests/evaluation/forecast/test_credibility.py")
SHOWN = (*FORECASTS, "tests/evaluation/forecast/test_shown.py")
MANNERS = ("tests/evaluation/test_manners.py",)
REPEATS = ("tests/evaluation/study/test_repeats.py",)

CHANGES = (
    Change(
        "a 90 % interval reaches as far as one of 80 %",
        UNCERTAINTY,
        "stdtrit(self.degrees, 0.5 + share / 2.0)",
        "stdtrit(self.degrees, share)",
        PAIRED,
    ),
    Change(
        "a share is as certain as if its denominator were known",
        UNCERTAINTY,
        "(-share / other.value, other)",
        "(0.0 * share, other)",
        PAIRED,
    ),
    Change(
        "regret is what a controller has beyond the worst of the others",
        "evaluation/transfer/summary.py",
        "max(others, key=lambda other: other.value) - own",
        "min(others, key=lambda other: other.value) - own",
        STANDING,
    ),
    Change(
        "the best controller is regretted by less than nothing",
        "evaluation/transfer/summary.py",
        "regret=_estimate(figures.regret(champion), least=0.0)",
        "regret=_estimate(figures.regret(champion))",
        STANDING,
    ),
    Change(
        "whether a forecast holds does not ask how well the achieved fitness was measured",
        "evaluation/transfer/forecast.py",
        "error = achieved.standard_error if np.isfinite(achieved.standard_error) else 0.0",
        "error = 0.0",
        FORECASTS,
    ),
    Change(
        "one model alone makes a forecast",
        "evaluation/transfer/forecast.py",
        "if len(cells) < 2 or",
        "if len(cells) < 1 or",
        FORECASTS,
    ),
    Change(
        "a model whose error nobody knows is not asked",
        "evaluation/transfer/forecast.py",
        "        return 1.0\n",
        "        return 0.0\n",
        FORECASTS,
    ),
    Change(
        "a controller that was written by hand is chosen",
        "evaluation/transfer/summary.py",
        "if one.name in found and one.against and not one.on_robot]",
        "if one.name in found]",
        SHOWN,
    ),
    Change(
        "a model in which nothing is claimed keeps a share of it",
        "evaluation/transfer/forecast.py",
        "if self.claimed <= 0.0:",
        "if self.claimed == 1e9:",
        SHOWN,
    ),
    Change(
        "a waypoint that was passed at any distance was missed",
        "evaluation/behaviour.py",
        "if radius <= nearest < NEAR * radius:",
        "if radius <= nearest:",
        MANNERS,
    ),
    Change(
        "who goes on in the same direction turned back",
        "evaluation/behaviour.py",
        "np.sign(moving[-1]) != np.sign(moving[0])",
        "np.sign(moving[-1]) == np.sign(moving[0])",
        MANNERS,
    ),
    Change(
        "an angle a turn away from its target is outside the tolerance",
        "evaluation/behaviour.py",
        "if target.channel.period is not None:",
        "if target.channel.period is None and False:",
        MANNERS,
    ),
    Change(
        "two robots make an interval",
        "evaluation/study/figures.py",
        "if count < FEWEST:",
        "if count < 2:",
        REPEATS,
    ),
    Change(
        "a robot with more seeds counts more",
        "evaluation/study/figures.py",
        "float(np.mean([group.mean() for group in groups]))",
        "float(values.mean())",
        REPEATS,
    ),
)
