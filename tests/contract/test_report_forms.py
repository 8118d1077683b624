"""Document, page and terminal of the same run: whole when parts are missing, the same every time."""

import json
import re
from datetime import date

import pytest

from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from evaluation.report.report import load_report, save_report, tables, to_json
from evaluation.running import gather_results, report_of
from sysid_evo.plan import Store, execute
from tests.fixtures.faulty_recordings import Fault, drive
from tests.fixtures.known_models import Broken, Exploding, Known, Weak, fitted
from tests.fixtures.reports import make_report, printed

nightly = pytest.mark.nightly


@pytest.mark.parametrize(
    ("models", "options"),
    [
        pytest.param([Known], {"robot": False}, id="one model, no robot", marks=nightly),
        pytest.param([Known, Broken], {}, id="a broken model", marks=nightly),
        pytest.param([Known, Weak], {"unplugged": True}, id="an unplugged robot", marks=nightly),
        pytest.param([Broken, Exploding], {"unplugged": True}, id="a broken model, one that diverges, no answer"),
        pytest.param([Broken], {"unplugged": True}, id="nothing works"),
        pytest.param([Exploding], {"robot": False}, id="it diverges", marks=nightly),
    ],
)
def test_a_report_is_whole_when_parts_are_missing(models, options, tmp_path):
    report = make_report({model.__name__.lower(): fitted(model()) for model in models}, **options)
    document, page = save_report(report, tmp_path)
    assert json.dumps(json.loads(document.read_text()), allow_nan=False)
    assert "Prediction" in page.read_text()
    text = "\n".join(printed(tables(report)))
    for failure in report.all_failures:
        assert failure.reason.split(":")[0] in text


@pytest.mark.usefixtures("blank_figures")
def test_two_equal_runs_give_the_same_files(tmp_path):
    folders = tmp_path / "one", tmp_path / "two"
    for folder in folders:
        save_report(make_report({"known": fitted(Known())}), folder)
    for file in ("report.json", "report.html"):
        one, two = ((folder / file).read_bytes() for folder in folders)
        assert one == two


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A comparison of two models and its store."""
    experiment = Experiment.of({"models": ("near=nearest_neighbour", "late=linear"), "stop_after": "prediction"})
    comparison = plan_comparison(experiment, dataset=drive(Fault(late=6)))
    store = Store(tmp_path_factory.mktemp("compared"))
    execute(comparison.plan, store)
    return comparison, store


@pytest.mark.usefixtures("blank_figures")
def test_a_page_has_the_day_of_the_run_and_is_drawn_again_with_the_same_bytes(compared):
    comparison, store = compared
    log = store.path / "log.jsonl"
    log.write_text(re.sub(r'"time": [\d.]+', '"time": 1e9', log.read_text()))
    pages = []
    for _ in range(2):
        report_of(comparison, store, afresh=True)
        pages.append((store.path / "report.html").read_bytes())
    assert b"9 Sep 2001" in pages[0]
    assert load_report(store.path).timings.finished_on == date(2001, 9, 9)
    assert pages[0] == pages[1]


def test_a_comparison_advises_on_the_model_that_predicts_best_and_documents_its_errors(compared):
    made = gather_results(*compared)
    assert made.advice.model == made.prediction.ranking(20)[0].name == "late"
    assert made.advice.evaluated_on == "the test part"
    assert made.advice.remarks[0].topic == "late controls"
    document = to_json(made)
    assert len(document["prediction"]["models"][1]["curve_interval"]) == 2
    document = document["error_analysis"]["models"][1]
    assert document["residuals"]["channels"]["speed"]["controls"]["push"]["p"] < 0.05
    assert document["residuals"]["control_lags"] == list(range(-5, 21))
    assert document["episodes"][0]["name"] == "day 1[600:800]"
    assert set(document["episodes"][0]["fit_percent"]) == {"speed", "turn"}
    assert document["regions"][0]["region"]["channel"] in document["regions"][0]["words"]
