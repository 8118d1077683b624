"""The figures of studies: what is judged together, and by what."""

from tests.mutation.change import Change

CONTROLLERS = "evaluation/study/figures.py"
FORECASTING = "evaluation/study/figures.py"
MODELS = "evaluation/study/figures.py"
TEST_FIGURES = "tests/evaluation/study/test_figures.py"
TEST_ROWS = "tests/evaluation/study/test_rows.py"

CHANGES = (
    Change(
        "the worst controller stands first",
        CONTROLLERS,
        "-(one.share.mean if one.share else -1e9)",
        "(one.share.mean if one.share else -1e9)",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "best in hindsight is the worst",
        CONTROLLERS,
        "return max(known, key=lambda row: row.share",
        "return min(known, key=lambda row: row.share",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "what was evolved on the robot is best in hindsight",
        CONTROLLERS,
        "if row.in_models and row.share is not None]",
        "if row.share is not None]",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "controllers that failed everywhere vanish",
        CONTROLLERS,
        "if not share and not failed:",
        "if not share:",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "controllers on the robot itself claim too much",
        CONTROLLERS,
        "row.achieved is None or not row.in_models:",
        "row.achieved is None:",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "failed ones are not among the planned",
        CONTROLLERS,
        "planned=len(own),",
        "planned=len(share),",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "labels of the reference are not heeded",
        CONTROLLERS,
        "asked.get(axis, label) == label for",
        "label == label for",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "each robot controller is a row of its own",
        CONTROLLERS,
        'name = "one search on the robot" if row.kind == "robot" else row.controller',
        "name = row.controller",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "unfinished points count in hindsight",
        CONTROLLERS,
        "for point in results.finished if point.group == group",
        "for point in results.points if point.group == group",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "without a recommended one the first is the reference",
        CONTROLLERS,
        "polished or [key for key in fitting if key[1] == CHOSEN]",
        "polished or fitting",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "of failed controllers the others are counted",
        CONTROLLERS,
        "failed = sum(bool(row.reason) for row in own)",
        "failed = sum(not row.reason for row in own)",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "prediction errors choose the worst",
        FORECASTING,
        "else -row.error",
        "else row.error",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "errors of predictions miss fitness",
        FORECASTING,
        "if misses and name in FITNESS else None",
        "if misses else None",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "controllers without forecast are judged",
        FORECASTING,
        "row.achieved is not None and row.forecast is not None",
        "row.achieved is not None",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "what was evolved on the robot is judged as a forecast",
        FORECASTING,
        "if row.in_models and row.achieved is not None",
        "if row.achieved is not None",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "unfinished points are judged",
        FORECASTING,
        "for point in results.finished:",
        "for point in results.points:",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "models are sorted at ten steps",
        MODELS,
        "n := one.n[20]",
        "n := one.n[10]",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "failed fits are not counted",
        MODELS,
        "failed=sum(bool(row.reason) for row in once.values())",
        "failed=0",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "an axis that changes errors in some models is none",
        MODELS,
        "if any(len(values) > 1",
        "if all(len(values) > 1",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "the share that is kept is what is achieved",
        MODELS,
        "lambda row: row.kept)",
        "lambda row: row.achieved)",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "models that nothing was evolved in are judged",
        MODELS,
        "        if judged:\n",
        "        if own:\n",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "seeds are taken for axes",
        MODELS,
        "rest = (point.where, point.seed, row.model,",
        "rest = (point.where, row.model,",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "robots are taken for axes",
        MODELS,
        "rest = (point.where, point.seed, row.model,",
        "rest = (point.seed, row.model,",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "seconds of a fit are something else",
        MODELS,
        "seconds=_spread(once, lambda row: row.seconds)",
        "seconds=_spread(once, lambda row: row.kept)",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "a model without errors is best",
        MODELS,
        "np.inf if (n := one.n[20]) is None",
        "-np.inf if (n := one.n[20]) is None",
        (
            TEST_FIGURES,
            TEST_ROWS,
        ),
    ),
    Change(
        "from a robot that stands all parts",
        "evaluation/report/sections/replay.py",
        "np.where(extent > 0.0, extent, np.inf)",
        "extent",
        ("tests/evaluation/test_replay.py",),
    ),
)
