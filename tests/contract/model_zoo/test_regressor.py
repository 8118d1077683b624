"""Regressors of scikit-learn's interface as models: accuracy, storage without pickle, objects, workers, refusals."""

import io
import json
import subprocess
import sys
import zipfile

import numpy as np
import pandas
import pytest
from sklearn.base import clone
from sklearn.cluster import KMeans
from sklearn.ensemble import (
    BaggingRegressor,
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
    StackingRegressor,
)
from sklearn.feature_selection import SelectKBest, f_regression
from sklearn.linear_model import LinearRegression, MultiTaskLasso, Ridge
from sklearn.model_selection import GridSearchCV
from sklearn.multioutput import MultiOutputRegressor, RegressorChain
from sklearn.neighbors import KNeighborsRegressor, RadiusNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler
from sklearn.utils import all_estimators

from evaluation import compare
from evaluation.chosen_models import with_preset
from model_zoo.auto.candidates import candidates_named
from model_zoo.estimators import MODULES, _regressors, check_lightgbm, read, written
from model_zoo.regressor import Regressor
from sysid_evo import as_model, load_model, make_model, save_model
from sysid_evo.errors import ArtefactError, InvalidArgument, MissingExtra, UnknownName, UnknownParameter
from sysid_evo.models.adapters import as_spec
from tests.fixtures.systems import ONE_STATE, chain

pytestmark = pytest.mark.usefixtures("blank_figures")

skops = pytest.importorskip("skops.io")

NO_LAGS = {"state_lags": 0, "control_lags": 0}
FORMS = {
    "skops": "regressor(estimator=GradientBoostingRegressor, n_estimators=3, state_lags=0, control_lags=1)",
    "lightgbm": "regressor(estimator=LGBMRegressor, n_estimators=3, state_lags=0, control_lags=1)",
    "xgboost": "regressor(estimator=XGBRegressor, n_estimators=3, state_lags=0, control_lags=1)",
}
"""A model for each way to store a regressor."""


def made(form):
    if form != "skops":
        pytest.importorskip(form)
    return make_model(FORMS[form])


@pytest.mark.parametrize("target", ["change", "next_state"])
@pytest.mark.parametrize("estimator", ["LinearRegression", LinearRegression(), make_pipeline(LinearRegression())])
def test_a_linear_regressor_equals_the_linear_family(target, estimator):
    data = chain(seed=1)
    ours = make_model("linear", **NO_LAGS).fit(data)
    found = Regressor(estimator=estimator, target=target, **NO_LAGS).fit(data)
    run = data.episodes[0]
    assert np.allclose(found.simulate(run), ours.simulate(run), rtol=1e-9, atol=1e-9)


def test_a_fitted_regressor_is_used_as_it_is_and_equals_its_own_predictions(throttle_car_data):
    run = throttle_car_data.episodes[0]
    inputs = np.concatenate([run.states[:-1], run.controls], axis=1)
    forest = RandomForestRegressor(n_estimators=4, random_state=0).fit(inputs, run.states[1:])
    model = Regressor(estimator=forest, fitted=True, target="next_state").fit(throttle_car_data)
    low, high = model.state_bounds_
    state, states = run.states[0], []
    for control in run.controls[:50]:
        state = np.clip(forest.predict([[*state, *control]])[0], low, high)
        states.append(state)
    assert np.array_equal(model.simulate(run.states[0], run.controls[:50]), states)
    assert "was fitted in Python before and is used as it is" in model.fit_note
    given = as_model(forest, fitted=True)
    assert "as it is, its outputs as next states; errors are too low where" in given.fit(throttle_car_data).fit_note
    assert np.array_equal(given.simulate(run), model.simulate(run))
    search = GridSearchCV(Ridge(), {"alpha": [1.0, 2.0]}, cv=2).fit(inputs, np.diff(run.states, axis=0))
    assert "its outputs as changes" in as_model(search).fit(throttle_car_data).fit_note
    search.best_estimator_.feature_names_in_ = np.array(throttle_car_data.system.control_names * 3)[: inputs.shape[1]]
    with pytest.raises(InvalidArgument, match=r"expected a fitted one with the inputs .*, got the inputs "):
        as_model(search, fitted=True).fit(throttle_car_data)
    spec = with_preset(as_spec(forest), "quick")
    assert spec.parameters["fitted"]
    assert spec.parameters["control_lags"] is None, "it has the inputs that it has"
    with pytest.raises(InvalidArgument, match=r"RandomForestRegressor is fitted: pass sklearn\.base\.clone"):
        candidates_named([forest])
    assert not as_spec(clone(forest)).parameters.get("fitted")
    with pytest.raises(InvalidArgument, match=r"expected a fitted one with the inputs .*expecting 4 features as input"):
        Regressor(estimator=Ridge().fit(inputs[:, :4], run.states[1:]), fitted=True).fit(throttle_car_data)
    with pytest.raises(InvalidArgument, match=r"and 3 outputs .*, got outputs of shape \(2,\)"):
        Regressor(estimator=Ridge().fit(inputs, run.states[1:, :2]), fitted=True).fit(throttle_car_data)
    with pytest.raises(InvalidArgument, match="fitted=True: expected a fitted regressor"):
        as_model(Ridge(), fitted=True)


def test_names_of_inputs_are_checked_and_later_ignored(throttle_car_data, tmp_path):
    run, system = throttle_car_data.episodes[0], throttle_car_data.system
    table = pandas.DataFrame(
        np.hstack([run.states[:-1], run.controls]), columns=[*system.state_names, *system.control_names]
    )
    for regressor in (Ridge(), KNeighborsRegressor(algorithm="brute")):
        model = as_model(regressor.fit(table, run.states[1:])).fit(throttle_car_data)
        restored = load_model(save_model(model, tmp_path / "model"))
        assert np.array_equal(restored.simulate(run), model.simulate(run))


def test_a_pipeline_with_a_step_for_one_output_is_fitted_for_each_state(throttle_car_data, tmp_path):
    chosen = make_pipeline(SelectKBest(f_regression, k=2), Ridge())
    model = Regressor(estimator=chosen, **NO_LAGS).fit(throttle_car_data)
    run = throttle_car_data.episodes[0]
    assert len(model._regressor.estimators_) == throttle_car_data.system.nx
    assert np.array_equal(load_model(save_model(model, tmp_path / "model")).simulate(run), model.simulate(run))


def test_where_a_regressor_has_no_neighbours_the_simulation_is_at_its_bound(throttle_car_data):
    model = Regressor(estimator=RadiusNeighborsRegressor(radius=1e-9), **NO_LAGS).fit(throttle_car_data)
    assert np.isnan(model.next_state(np.zeros((1, 3)), np.full((1, 2), 0.123))).all()
    assert np.isfinite(model.simulate(throttle_car_data.episodes[0])).all()


def test_lags_are_chosen_by_the_simulation_error():
    delayed = make_model("regressor(estimator=Ridge, alpha=1e-6)").fit(chain(seed=2))
    assert delayed.lags != (0, 0)
    without = make_model("regressor(estimator=Ridge, alpha=1e-6)", **NO_LAGS).fit(chain(seed=2))
    assert delayed.score(chain(seed=3)) > without.score(chain(seed=3))


def test_the_same_seed_gives_the_same_model_and_another_seed_another(throttle_car_data):
    spec = "regressor(estimator=RandomForestRegressor, n_estimators=3, state_lags=0, control_lags=0)"
    stored = [make_model(spec).fit(throttle_car_data, rng=seed).stored_.tobytes() for seed in (0, 0, 1)]
    assert stored[0] == stored[1] != stored[2]


def test_every_regressor_of_scikit_learn_is_found_by_its_name():
    expected = {name for name, _ in all_estimators(type_filter="regressor")}
    found = {name for module in MODULES for name in _regressors(module)}
    ensembles = {"RegressorChain", "MultiOutputRegressor", "StackingRegressor", "VotingRegressor"}
    assert expected <= found | ensembles


SHOWN = [
    (RandomForestRegressor(n_estimators=50), "regressor(estimator=RandomForestRegressor, n_estimators=50)"),
    (HistGradientBoostingRegressor(max_iter=20), "regressor(max_iter=20)"),
]


@pytest.mark.parametrize(("thing", "text"), SHOWN)
def test_an_object_with_plain_settings_becomes_text_that_the_command_line_takes(thing, text):
    assert as_spec(thing).text == text
    assert make_model(text).get_params() == as_model(thing).get_params()


def test_stored_models_give_the_same_bits_in_a_fresh_process(throttle_car_data, tmp_path):
    run, expected = throttle_car_data.episodes[0], {}
    np.savez(tmp_path / "run.npz", x=run.states[:2], u=run.controls[:1], ahead=run.controls[1:])
    program = (
        "import sys, numpy as np; from sysid_evo import load_model; a = np.load('run.npz')\n"
        "for form in sys.argv[1:]: print(form, load_model(form).simulate(a['x'], a['u'], a['ahead']).tobytes().hex())"
    )
    for form in FORMS:
        model = made(form).fit(throttle_car_data)
        save_model(model, tmp_path / form)
        expected[form] = model.simulate(run.states[:2], run.controls[:1], run.controls[1:]).tobytes().hex()
    command = [sys.executable, "-c", program, *FORMS]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert dict(line.split() for line in done.stdout.splitlines()) == expected


def mutated(form, data, count, rng):
    """Yield ``data`` with one to four changed bytes, cut off, or with a repeated part."""
    for _ in range(count):
        changed = bytearray(data)
        kind, at = rng.integers(4), int(rng.integers(len(data)))
        if kind == 0:
            del changed[at:]
        elif kind == 1:
            changed[at:at] = changed[at : at + int(rng.integers(1, 200))]
        else:
            for place in rng.integers(len(data), size=rng.integers(1, 5)):
                changed[place] ^= int(rng.integers(1, 256))
        yield bytes(changed)


@pytest.mark.parametrize("count", [12, pytest.param(500, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("form", FORMS)
def test_a_changed_file_is_refused_or_right(form, count, throttle_car_data, tmp_path, rng):
    model = made(form).fit(throttle_car_data)
    run = throttle_car_data.episodes[0]
    right = model.simulate(run)
    path = save_model(model, tmp_path / "model")
    files = [path, path.with_suffix(".safetensors")]
    contents = [file.read_bytes() for file in files]
    for number, (first, second) in enumerate(zip(*(mutated(form, one, count, rng) for one in contents), strict=True)):
        files[0].write_bytes(first if number % 2 else contents[0])
        files[1].write_bytes(contents[1] if number % 2 else second)
        try:
            found = load_model(path)
        except ArtefactError:
            continue
        assert np.array_equal(found.simulate(run), right)


@pytest.mark.parametrize("count", [12, pytest.param(500, marks=pytest.mark.nightly)])
def test_a_changed_regressor_with_a_right_digest_is_refused_or_right(count, throttle_car_data, rng):
    model = made("skops").fit(throttle_car_data)
    inputs = rng.standard_normal((20, len(model.input_centre_)))
    right = read("skops", model.stored_.tobytes()).predict(inputs)
    for data in mutated("skops", model.stored_.tobytes(), count, rng):
        try:
            assert np.array_equal(read("skops", data).predict(inputs), right)
        except ArtefactError:
            continue


def with_schema(data, change):
    """Return skops bytes with another schema, whose checksum is right."""
    target = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(target, "w") as changed:
        for name in source.namelist():
            content = source.read(name)
            changed.writestr(name, change(content.decode()).encode() if name == "schema.json" else content)
    return target.getvalue()


@pytest.mark.parametrize("module", ["os", "evil"])
def test_a_file_that_names_other_code_is_refused_and_nothing_is_imported(module, tmp_path, monkeypatch):
    (tmp_path / "evil.py").write_text("raise SystemExit('it ran')")
    monkeypatch.syspath_prepend(tmp_path)
    _, data = written(Ridge().fit(np.eye(3), np.eye(3)))

    def change(text):
        schema = json.loads(text)
        schema["__module__"], schema["__class__"] = module, "system"
        return json.dumps(schema)

    with pytest.raises(ArtefactError, match=rf"names {module}\.system, not among the trusted types: not loaded"):
        read("skops", with_schema(data, change))
    assert "evil" not in sys.modules


TREES = [
    RandomForestRegressor(n_estimators=2),
    GradientBoostingRegressor(n_estimators=2),
    HistGradientBoostingRegressor(max_iter=2),
]


@pytest.mark.parametrize("forest", TREES, ids=lambda one: type(one).__name__)
def test_trees_that_would_be_read_beyond_their_end_are_refused(forest, rng):
    inputs = rng.standard_normal((100, 3))
    fitted = forest.fit(inputs, inputs[:, 0])
    assert np.array_equal(read(*written(fitted)).predict(inputs), fitted.predict(inputs))
    for name, value in (("left", 10**6), ("left", 0), ("feature", 3), ("feature", -1)):
        fitted = forest.fit(inputs, inputs[:, 0])
        if hasattr(fitted, "_predictors"):
            fitted._predictors[0][0].nodes["left" if name == "left" else "feature_idx"][0] = value
        else:
            tree = np.ravel(fitted.estimators_)[0].tree_
            (tree.children_left if name == "left" else tree.feature)[0] = value
        with pytest.raises(ArtefactError, match="expected trees whose nodes refer to later nodes and to its inputs"):
            read(*written(fitted))


LIGHTGBM_HEAD = """tree
version=v4
num_class=1
num_tree_per_iteration=1
label_index=0
max_feature_idx=2
objective=regression
feature_names=a b c
feature_infos=[-1:1] [-1:1] [-1:1]
tree_sizes={size} {size}

"""
LIGHTGBM_TREE = """num_leaves=3
num_cat=0
split_feature=0 2
split_gain=3 2
threshold=0.5 -0.25
decision_type=2 2
left_child=1 -1
right_child=-2 -3
leaf_value=1 2 3
leaf_weight=5 5 5
leaf_count=5 5 5
internal_value=0 0
internal_weight=0 0
internal_count=15 10
is_linear=1
leaf_const=1 2 3
num_features=1 0 0
leaf_features=1
leaf_coeff=0.5
shrinkage=1


"""


def lightgbm_text(old="", new=""):
    """Return a text of two trees, with ``old`` replaced by ``new`` and the sizes of the trees set for it."""
    tree = LIGHTGBM_TREE.replace(old, new, 1) if old else LIGHTGBM_TREE
    head = LIGHTGBM_HEAD.replace("{size}", str(len(f"Tree=0\n{tree}")))
    trees = "".join(f"Tree={i}\n{tree}" for i in range(2)) + "end of trees\n"
    return (head if not old or old in LIGHTGBM_TREE else head.replace(old, new, 1)) + trees


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("left_child=1", "left_child="), ("left_child=1", "left_child=0"), ("left_child=1", "left_child=2"),
        ("right_child=-2", "right_child=-4"), ("split_feature=0", "split_feature=3"),
        ("split_feature=0", "split_feature=-1"), ("decision_type=2", "decision_type=3"),
        ("num_cat=0", "num_cat=1"), ("threshold=0.5", "threshold=0_5"),
        ("leaf_value=1", "leaf_value=1 1"), ("leaf_const=1", "leaf_const="), ("leaf_weight=5", "leaf_weight="),
        ("internal_count=15", "internal_count="), ("shrinkage=1", "shrinkage=1\nshrinkage=1"),
        ("shrinkage=1", "more=1"),
        ("num_features=1", "num_features=2"), ("num_features=1 0", "num_features=-1 2"),
        ("leaf_features=1", "leaf_features=3"),
        ("num_leaves=3", "num_leaves=0"), ("num_class=1", "num_class=2"), ("max_feature_idx=2", "max_feature_idx=9"),
        ("feature_infos=", "feature_infos=none "), ("tree_sizes=", "tree_sizes=0 "), ("tree_sizes=", "tree_sizes=9"),
        ("tree_sizes=", "sizes="), ("label_index", "label\r"), ("feature_names=a", "feature_names=\u00fc"),
    ],
)  # fmt: skip
def test_a_text_that_lightgbm_would_read_beyond_its_end_is_refused(old, new):
    pytest.importorskip("lightgbm")
    inputs = np.array([[0.0, 1.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    predictions = read("lightgbm", json.dumps([lightgbm_text()]).encode()).predict(inputs)
    np.testing.assert_array_equal(predictions[:, 0], 2.0 * np.array([1.5, 3.0, 2.0]))
    with pytest.raises((ArtefactError, KeyError, ValueError)):  # `read` makes an ArtefactError of each
        check_lightgbm(lightgbm_text(old, new))


def test_bytes_that_no_regressor_is_stored_as_are_refused(rng):
    inputs = rng.standard_normal((60, 3))
    with pytest.raises(ArtefactError, match="expected the format skops, lightgbm or xgboost, got 'pickle'"):
        read("pickle", b"")
    squeezed = io.BytesIO()
    with zipfile.ZipFile(squeezed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("schema.json", "{}")
    with pytest.raises(ArtefactError, match="expected files without compression"):
        read("skops", squeezed.getvalue())
    boosted = HistGradientBoostingRegressor(max_iter=1).fit(inputs, inputs[:, 0])
    boosted._predictors[0][0].nodes["is_categorical"][0] = 1
    with pytest.raises(ArtefactError, match="expected trees without categories"):
        read(*written(boosted))
    forest = RandomForestRegressor(n_estimators=2).fit(inputs, inputs[:, 0])
    forest.estimators_[1] = RandomForestRegressor(n_estimators=1).fit(inputs[:, :2], inputs[:, 0]).estimators_[0]
    with pytest.raises(ArtefactError, match="expected trees of 3 inputs"):
        read(*written(forest))


def test_a_fit_that_did_not_converge_is_reported(throttle_car_data):
    for iterations, said in ((1, True), (200, False)):
        network = MLPRegressor(hidden_layer_sizes=(2,), max_iter=iterations, tol=0.1, n_iter_no_change=2)
        model = Regressor(estimator=network, **NO_LAGS).fit(throttle_car_data, rng=0)
        assert ("the fit ended before it converged" in model.fit_note) is said


def test_a_booster_that_stopped_early_predicts_as_it_did(throttle_car_data):
    xgboost, run = pytest.importorskip("xgboost"), throttle_car_data.episodes[0]
    inputs, outputs = np.concatenate([run.states[:-1], run.controls], axis=1), run.states[1:]
    found = xgboost.XGBRegressor(n_estimators=30, early_stopping_rounds=1, learning_rate=1.0)
    found.fit(inputs[::2], outputs[::2], eval_set=[(inputs[1::2], outputs[1::2])], verbose=False)
    assert found.best_iteration < 28
    expected = found.predict(inputs)
    model = as_model(found).fit(throttle_car_data)
    assert np.allclose(model.next_state(run.states[:-1], run.controls), expected, atol=1e-6)


def test_a_bag_of_trees_with_some_of_the_inputs_each_is_read(rng):
    inputs = rng.standard_normal((100, 4))
    bag = BaggingRegressor(n_estimators=3, max_features=2).fit(inputs, inputs[:, 0])
    assert np.array_equal(read(*written(bag)).predict(inputs), bag.predict(inputs))


def test_what_cannot_be_stored_is_refused_after_the_fit_with_what_to_do(throttle_car_data):
    with pytest.raises(InvalidArgument, match=r"KDTree is not among the trusted types\. algorithm='brute' avoids it"):
        Regressor(estimator=KNeighborsRegressor(algorithm="kd_tree"), **NO_LAGS).fit(throttle_car_data)
    Regressor(estimator=KNeighborsRegressor(), **NO_LAGS).fit(throttle_car_data)
    inside = make_pipeline(StandardScaler(), GridSearchCV(Ridge(), {"alpha": [1.0, 2.0]}, cv=2))
    with pytest.raises(InvalidArgument, match=r"GridSearchCV\(make_pipeline\(\.\.\.\), .*avoids it"):
        Regressor(estimator=inside, **NO_LAGS).fit(throttle_car_data)
    own = make_pipeline(FunctionTransformer(written), Ridge())
    with pytest.raises(InvalidArgument, match=r"cannot be|estimators\.written is not among the trusted types"):
        Regressor(estimator=own, **NO_LAGS).fit(throttle_car_data)


@pytest.mark.parametrize(
    "estimator", [MultiOutputRegressor(Ridge()), RegressorChain(Ridge()), make_pipeline(MultiTaskLasso(alpha=1e-3))]
)
def test_regressors_of_several_outputs_are_fitted_to_a_single_state(estimator):
    data = ONE_STATE.recording()
    assert Regressor(estimator=estimator, **NO_LAGS).fit(data).score(data) > -1.0


def test_a_booster_in_a_pipeline_is_refused_with_what_to_do():
    lightgbm = pytest.importorskip("lightgbm")
    inside = make_pipeline(StandardScaler(), lightgbm.LGBMRegressor(n_estimators=1, verbosity=-1))
    with pytest.raises(InvalidArgument, match="Pass LGBMRegressor itself: inputs and outputs are scaled anyway"):
        Regressor(estimator=inside, **NO_LAGS).fit(ONE_STATE.recording())


def test_boosters_take_all_parameters_of_their_packages(throttle_car_data, tmp_path):
    xgboost, lightgbm = pytest.importorskip("xgboost"), pytest.importorskip("lightgbm")
    run = throttle_car_data.episodes[0]
    for given in (
        xgboost.XGBRegressor(n_estimators=3, booster="gblinear"),
        xgboost.XGBRegressor(n_estimators=3, booster="dart", rate_drop=0.3),
        xgboost.XGBRFRegressor(n_estimators=3),
        lightgbm.LGBMRegressor(n_estimators=3, linear_tree=True),
    ):
        model = as_model(given).set_params(**NO_LAGS).fit(throttle_car_data, rng=0)
        found = load_model(save_model(model, tmp_path / "model"))
        assert np.array_equal(found.simulate(run), model.simulate(run))


def test_wrong_names_and_settings_are_refused_before_the_fit(monkeypatch):
    with pytest.raises(UnknownName, match=r"called 'RandomForrestRegressor'. Did you mean 'RandomForestRegressor'"):
        make_model("regressor(estimator=RandomForrestRegressor)")
    with pytest.raises(UnknownParameter, match=r"Ridge has no parameter 'alfa'. Did you mean 'alpha'"):
        make_model("regressor(estimator=Ridge, alfa=1)")
    with pytest.raises(InvalidArgument, match=r"StackingRegressor needs estimators: pass the regressor itself"):
        make_model("regressor(estimator=StackingRegressor)")
    with pytest.raises(InvalidArgument, match="fitted=True expects a fitted regressor as estimator, got a class name"):
        Regressor(estimator="Ridge", fitted=True)
    with pytest.raises(InvalidArgument, match="alpha: set the parameters of an object before it is passed"):
        Regressor(estimator=Ridge(), alpha=3)
    with pytest.raises(
        InvalidArgument,
        match=r"recognises \(.*scikit_learn.*\), got an object of the class KMeans. This works: models=",
    ):
        as_model(KMeans())
    model = make_model("regressor(estimator=Ridge, alpha=2.0)")
    with pytest.raises(UnknownParameter):
        model.set_params(alfa=1)
    assert model.set_params(alpha=3.0).get_params()["alpha"] == 3.0
    monkeypatch.setattr("model_zoo.estimators.find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r'pip install "sysid-evo\[boosting\]"'):
        make_model("regressor(estimator=LGBMRegressor)")


def test_a_search_keeps_its_best_estimator(throttle_car_data):
    search = GridSearchCV(make_pipeline(StandardScaler(), Ridge()), {"ridge__alpha": [1e-3, 1e6]}, cv=3)
    model = Regressor(estimator=search, **NO_LAGS).fit(throttle_car_data)
    assert read(model.format_, model.stored_.tobytes()).named_steps["ridge"].alpha == 1e-3


def test_an_object_is_fitted_by_a_worker_process_and_its_results_are_found_without_it(
    throttle_car_data, tmp_path, call, monkeypatch
):
    stack = StackingRegressor([("scaled", make_pipeline(StandardScaler(), Ridge()))], Ridge())
    found = compare(throttle_car_data, models={"stack": stack}, stop_after="prediction", out=tmp_path, jobs=2)
    assert [failure.reason for failure in found.failures] == []
    assert "estimator='<Python object StackingRegressor " in (tmp_path / "experiment.toml").read_text()
    assert "the regressor was given in Python" in (tmp_path / "report.json").read_text()
    stored = {path: path.read_bytes() for path in (tmp_path / "models").iterdir()}
    monkeypatch.setattr("sysid_evo.registry.objects._objects", {})  # as in another process
    call.works("report", tmp_path)
    assert {path: path.read_bytes() for path in (tmp_path / "models").iterdir()} == stored
