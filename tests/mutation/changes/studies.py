"""Studies: what is planned, what is refused, how rows and intervals are made."""

from tests.mutation.change import Change

GATHERING = "evaluation/study/results.py"
REPEATS = "evaluation/study/figures.py"
STUDY = "evaluation/study/study.py"
AXES = "evaluation/study/study.py"
STUDYING = "sysid_evo/cli/experiments.py"
TEST_RUNNING_CELLS = "tests/evaluation/study/test_running.py::test_failing_cells_are_rows_with_reasons"
TEST_ROWS = "tests/evaluation/study/test_rows.py"
TEST_RUNNING_OF = "tests/evaluation/study/test_running.py::test_errors_of_models_are_those_that_were_measured"
TEST_REPEATS = "tests/evaluation/study/test_repeats.py"
TEST_STUDY = "tests/evaluation/study/test_study.py"
TEST_STUDYING = "tests/sysid_evo/cli/test_studying.py"

CHANGES = (
    Change(
        "a cell whose needs failed is missing",
        GATHERING,
        'return "missing" if self.store.outcome(cell).reason == WAITING else "failed"',
        'return "missing"',
        (TEST_RUNNING_CELLS,),
    ),
    Change(
        "where all are at the floor shares are infinite",
        GATHERING,
        "yardstick > floor:",
        "yardstick >= floor:",
        (TEST_ROWS,),
    ),
    Change(
        "a share is measured from zero, not from the floor",
        GATHERING,
        "best.get(place[row.point]), row.floor or 0.0",
        "best.get(place[row.point]), 0.0",
        (TEST_ROWS,),
    ),
    Change(
        "tasks share a yardstick",
        GATHERING,
        "(point.where, point.task) for point",
        '(point.where, "") for point',
        (TEST_ROWS,),
    ),
    Change(
        "what diverged is a yardstick",
        GATHERING,
        "if row.achieved is not None and np.isfinite(row.achieved):",
        "if row.achieved is not None:",
        (TEST_ROWS,),
    ),
    Change(
        "a failed fit has seconds",
        GATHERING,
        'seconds=None if record is None or record.status == "failed" else record.seconds',
        "seconds=None if record is None else record.seconds",
        (TEST_RUNNING_CELLS,),
    ),
    Change(
        "in the times of cells none has failed",
        GATHERING,
        'CellTime(cell.kind, record.seconds, record.status == "failed")',
        "CellTime(cell.kind, record.seconds)",
        (TEST_RUNNING_CELLS,),
    ),
    Change(
        "a fit that failed has no row",
        GATHERING,
        'if record is None and self._state(fit) == "missing":',
        'if record is None or record.status == "failed":',
        (TEST_RUNNING_CELLS,),
    ),
    Change(
        "a single model has an aggregate",
        GATHERING,
        "self.comparison.experiment.aggregate if len(members) > 1 else",
        "self.comparison.experiment.aggregate if members else",
        (TEST_RUNNING_OF,),
    ),
    Change(
        "the error of a controller is that of the best of its models",
        GATHERING,
        "error=float(np.mean(known)) if known",
        "error=float(np.min(known)) if known",
        (TEST_RUNNING_OF,),
    ),
    Change(
        "errors are not read",
        GATHERING,
        "_error(score) for score in prediction.at)",
        "_error(score) for score in prediction.at[:1])",
        (TEST_RUNNING_OF,),
    ),
    Change(
        "the ends of an error's interval are exchanged",
        GATHERING,
        "score.interval.low, score.interval.high",
        "score.interval.high, score.interval.low",
        (TEST_RUNNING_OF,),
    ),
    Change("the interval is that of percentiles", REPEATS, " * np.sqrt(count / (count - 1))))", "))", (TEST_REPEATS,)),
    Change(
        "Student's quantile is that of a robot more",
        REPEATS,
        "stdtrit(count - 1, 0.5",
        "stdtrit(count + 20, 0.5",
        (TEST_REPEATS,),
    ),
    Change(
        "seeds are not drawn",
        REPEATS,
        "group[rng.integers(0, len(group), (RESAMPLES, len(groups), len(group)))].mean(2)",
        "np.full((RESAMPLES, len(groups)), group.mean())",
        (TEST_REPEATS,),
    ),
    Change(
        "robots are not drawn",
        REPEATS,
        "robots = rng.integers(0, len(groups), (RESAMPLES, len(groups)))",
        "robots = np.tile(np.arange(len(groups)), (RESAMPLES, 1))",
        (TEST_REPEATS,),
    ),
    Change("the lowest is the mean", REPEATS, "float(values.min())", "float(values.mean())", (TEST_REPEATS,)),
    Change(
        "two points of one name are planned",
        STUDY,
        "if repeated is not None:",
        "if repeated is not None and not names:",
        (TEST_STUDY,),
    ),
    Change(
        "what grids share are two points",
        STUDY,
        "found.setdefault(point.experiment.model_dump_json(), point)",
        "found[point.name] = point",
        (TEST_STUDY,),
    ),
    Change(
        "a reference may be a seed",
        STUDY,
        "if name in REPEATED or (name != CONTROLLER and not known):",
        "if name != CONTROLLER and not known:",
        (TEST_STUDY,),
    ),
    Change(
        "a reference may be of no axis",
        STUDY,
        "if name in REPEATED or (name != CONTROLLER and not known):",
        "if name in REPEATED:",
        (TEST_STUDY,),
    ),
    Change("a title may be a number", STUDY, "if not isinstance(title, str):", "if title is None:", (TEST_STUDY,)),
    Change(
        "a study begins without its title",
        STUDY,
        'cls.of({"title": file.stem, **settings})',
        "cls.of(settings)",
        (TEST_STUDY,),
    ),
    Change("a range of one is refused", AXES, "if last < first:", "if last <= first:", (TEST_STUDY,)),
    Change(
        "a range within a task is a range of the study",
        AXES,
        " and setting in RANGED else None",
        " else None",
        (TEST_STUDY,),
    ),
    Change(
        "two values of one label are taken",
        AXES,
        "if labels.count(label) > 1:",
        "if labels.count(label) > 2:",
        (TEST_STUDY,),
    ),
    Change(
        "what points share is foreseen twice",
        STUDYING,
        "if digest not in seen and digest not in done]",
        "if digest not in done]",
        (TEST_STUDYING,),
    ),
    Change(
        "what is foreseen is corrected the wrong way",
        "evaluation/study/planning.py",
        "took[kind] / expected for",
        "expected / took[kind] for",
        (TEST_STUDYING,),
    ),
    Change(
        "what is done is foreseen",
        STUDYING,
        "for digest in about if digest not in done)",
        "for digest in about)",
        (TEST_STUDYING,),
    ),
)
