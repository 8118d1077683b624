"""Models and champions on disk: bit for bit, or refused with a reason."""

import hashlib
import json
import pickle
import re
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from sysid_evo.artefacts import is_stored_artefact
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import ArtefactError, InvalidArgument, NotFitted
from sysid_evo.evolution import Champion
from sysid_evo.evolution.champion import load_champion, save_champion
from sysid_evo.files import write_atomically
from sysid_evo.models import DynamicsModel, family_name, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec, models
from sysid_evo.system import System
from sysid_evo.testing.examples import switched_car

CHAMPION = Champion(
    name="mm1",
    parameters=np.array([0.1, np.pi, -1e-300, 1 / 3]),
    against=("linear", "nearest_neighbour"),
    aggregate="min",
    seed=2**40 + 1,
    history=np.array([[3.0, 2.0, 1.0], [4.0, 2.5, 1.5]]),
    controller=Spec("recurrent", {"hidden": 3}),
    task=Spec("point_to_point", {"horizon": 100, "waypoint_radius": 0.1 + 0.2}),
    system=switched_car(),
    seed_fitness=(0.1 + 0.2, 1 / 3),
    estimator_delay=0.0221,
    noise="domain_randomisation(sensor=0.2)",
)


class Scrapbook(DynamicsModel):
    """Learns one thing of every kind that can be stored, and whatever ``also`` says."""

    def __init__(self, *, also=None):
        self.also = also

    def fit(self, dataset, *, rng, progress=None):
        self.layers_ = [rng.standard_normal((2, 3)), rng.standard_normal(4)] + [np.full(1, float(i)) for i in range(10)]
        self.counts_ = np.arange(5)
        self.single_ = np.float32([0.1, 0.2])
        self.name_ = "first"
        self.score_ = 0.1 + 0.2
        self.nested_ = [[1, 2], ["a", None, True]]
        self.empty_ = []
        self.scratch = "not learned"
        if self.also is not None:
            self.extra_ = EXTRAS[self.also]
        return self

    def next_state(self, carry, control):
        return carry


EXTRAS = {"object": object(), "mapping": {"a": 1}, "nan": float("nan"), "numpy number": np.float64(1.0)}


@pytest.fixture
def scrapbook(register):
    return register(models, "scrapbook", Scrapbook)


@pytest.fixture(scope="module")
def linear(car_data):
    return make_model("linear", ridge=0.1, state_lags=1).fit(car_data, rng=0)


@pytest.fixture
def stored(linear, tmp_path):
    save_model(linear, tmp_path / "model", seed=3, data="abc")
    return tmp_path / "model"


def manifest_of(path):
    return json.loads(path.with_suffix(".json").read_text())


def rewrite(path, change):
    """Change the manifest as someone with an editor would."""
    manifest = manifest_of(path)
    change(manifest)
    path.with_suffix(".json").write_text(json.dumps(manifest))


@pytest.mark.parametrize("family", ["linear", "nearest_neighbour"])
def test_a_model_comes_back_bit_for_bit(family, car_data, tmp_path):
    model = make_model(family).fit(car_data, rng=0)
    written = save_model(model, tmp_path / "a" / "model.v2", seed=5, data=car_data.fingerprint)
    assert written == tmp_path / "a" / "model.v2.json"
    loaded = load_model(tmp_path / "a" / "model.v2")
    assert type(loaded) is type(model)
    assert loaded.get_params() == model.get_params()
    assert (loaded.system, loaded.system.name) == (model.system, model.system.name)
    learned = {key for key in vars(model) if key.endswith("_")}
    assert {key for key in vars(loaded) if key.endswith("_")} == learned
    for key in learned - {"system_"}:
        assert getattr(loaded, key).dtype == getattr(model, key).dtype
        np.testing.assert_array_equal(getattr(loaded, key), getattr(model, key))
    windows = car_data.windows(20, stride=50)
    arguments = (windows.past_states, windows.past_controls, windows.controls)
    np.testing.assert_array_equal(loaded.simulate(*arguments), model.simulate(*arguments))


def test_every_kind_of_learned_thing_comes_back(scrapbook, car_data, tmp_path):
    model = scrapbook().fit(car_data, rng=0)
    save_model(model, tmp_path / "book")
    loaded = load_model(tmp_path / "book.json")
    assert isinstance(loaded, Scrapbook)
    assert len(loaded.layers_) == len(model.layers_) == 12
    for mine, theirs in zip(loaded.layers_, model.layers_, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for name in ("name_", "score_", "nested_", "empty_"):
        assert getattr(loaded, name) == getattr(model, name)
    assert (loaded.counts_.dtype, loaded.single_.dtype) == (np.int64, np.float32)
    assert not hasattr(loaded, "scratch")


def test_a_champion_comes_back_bit_for_bit(tmp_path):
    save_champion(CHAMPION, tmp_path / "mm1-3")
    loaded = load_champion(tmp_path / "mm1-3")
    for name in (
        "name", "against", "aggregate", "seed", "controller", "task", "estimator_delay", "noise", "system",
        "seed_fitness",
    ):  # fmt: skip
        assert getattr(loaded, name) == getattr(CHAMPION, name)
    np.testing.assert_array_equal(loaded.parameters, CHAMPION.parameters)
    np.testing.assert_array_equal(loaded.history, CHAMPION.history)


def test_the_manifest_records_the_origin_of_the_file(stored):
    manifest = manifest_of(stored)
    assert (manifest["kind"], manifest["name"], manifest["module"]) == ("model", "linear", "model_zoo.linear")
    assert (manifest["seed"], manifest["data"]) == (3, "abc")
    assert set(manifest["versions"]) == {"python", "sysid-evo", "numpy", "scipy", "scikit-learn"}
    assert manifest["sha256"] == hashlib.sha256(stored.with_suffix(".safetensors").read_bytes()).hexdigest()
    assert sorted(path.name for path in stored.parent.iterdir()) == ["model.json", "model.safetensors"]


@pytest.mark.parametrize(
    ("suffix", "damaged", "reason"),
    [
        (".json", lambda _: None, r"model\.json: expected one half of a stored model, found no such file"),
        (".safetensors", lambda _: None, r"model\.safetensors: expected one half of a stored model, found no such"),
        (
            ".safetensors",
            lambda old: old[:-1],
            "model.safetensors: its SHA-256 is not the one in model.json: damaged",
        ),
        (".json", lambda old: old[:-20], "model.json: not a manifest of schema sysid-evo/artefact/4: the file: Inv"),
        (".safetensors", lambda old: old[:-1] + bytes([old[-1] ^ 1]), "model.safetensors: its SHA-256"),
        (".json", lambda _: b" " * (4 * 2**20 + 1), "a manifest has at most 4194304 bytes, this is larger"),
    ],
)
def test_a_damaged_half_or_none_is_refused(stored, suffix, damaged, reason):
    file = stored.with_suffix(suffix)
    content = damaged(file.read_bytes())
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content)
    with pytest.raises(ArtefactError, match=reason):
        load_model(stored)


def test_the_tensors_of_another_artefact_are_refused(stored, car_data):
    save_model(make_model("linear").fit(car_data, rng=0), stored.with_name("other"))
    shutil.copy(stored.with_name("other.safetensors"), stored.with_suffix(".safetensors"))
    with pytest.raises(ArtefactError, match="damaged, or another file"):
        load_model(stored)


def test_a_pickle_in_disguise_is_never_unpickled(stored, tmp_path):
    class Trap:
        def __reduce__(self):
            return Path.touch, (tmp_path / "sprung",)

    content = pickle.dumps(Trap())
    stored.with_suffix(".safetensors").write_bytes(content)
    with pytest.raises(ArtefactError, match="its SHA-256"):
        load_model(stored)
    rewrite(stored, lambda m: m.update(sha256=hashlib.sha256(content).hexdigest()))
    with pytest.raises(ArtefactError, match=r"model.safetensors: not a safetensors file"):
        load_model(stored)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    "change, reason",
    [
        (lambda m: m.update(surprise=1), "surprise: Extra inputs are not permitted"),
        (lambda m: m.pop("sha256"), "sha256: Field required"),
        (lambda m: m.update(schema_="sysid-evo/artefact/1"), "schema_: .*another version of this .*: fit or evolve ag"),
        (lambda m: m.update(seed="3"), "seed: Input should be a valid integer"),
        (lambda m: m["parameters"].update(ridge=float("nan")), "parameters: .*expected finite numbers, got nan"),
        (lambda m: m["learned"].update(a_=[{"b": float("inf")}]), "learned: .*expected finite numbers, got inf"),
        (lambda m: m["system"].update(dt=float("nan")), "system: .*expected finite numbers, got nan"),
        (lambda m: m["tensors"].pop("intercept_"), r"safetensors: expected the tensors \{.*\}, got \{.*intercept_"),
        (lambda m: m.update(kind="controller"), "expected a stored model, got a controller"),
        (lambda m: m["parameters"].update(colour="red"), "not a stored linear: UnknownParameter: .*'colour'"),
        (lambda m: m["system"].pop("dt"), "not a stored linear: KeyError: 'dt'"),
        (lambda m: m["system"].update(states=5), "not a stored linear: TypeError"),
        (lambda m: m["system"].update(dt=-1.0), "not a stored linear: InvalidSystem: system: expected dt > 0 s"),
        (lambda m: m["system"]["motion"].update(kind="balloon"), "expected one of .*planar_body.*, got 'balloon'"),
        (lambda m: m.update(system=None), "not a stored linear: KeyError: 'states'"),
        (lambda m: m["learned"].update(fit=1), "'fit' cannot be the name of something learned"),
        (lambda m: m["learned"].update(__class_=1), "'__class_' cannot be the name of something learned"),
        (lambda m: m["learned"].update(system_=1), "'system_' cannot be the name of something learned"),
        (
            lambda m: m.update(name="lineal", module="their_zoo"),
            "family 'lineal', .* 'their_zoo'.*--plugin.*linear",
        ),
    ],
)
def test_a_manifest_that_was_tampered_with_is_refused_with_the_reason(stored, change, reason):
    rewrite(stored, change)
    with pytest.raises(ArtefactError, match=reason) as raised:
        load_model(stored)
    assert str(stored) in str(raised.value)


def test_a_controller_of_a_run_is_found_without_the_digest_in_its_name_unless_there_are_two(tmp_path):
    save_champion(CHAMPION, tmp_path / "best of 1.5-0123abcd")
    for name in ("best of 1.5", "best of 1.5.json", "best of 1.5-0123abcd", "best of 1.5-0123abcd.safetensors"):
        assert load_champion(tmp_path / name).name == CHAMPION.name
    save_champion(CHAMPION, tmp_path / "best of 1.5-plain")
    assert load_champion(tmp_path / "best of 1.5").name == CHAMPION.name
    save_champion(CHAMPION, tmp_path / "best of 1.5-4567abcd")
    with pytest.raises(ArtefactError, match=r"best of 1.5-0123abcd.json, best of 1.5-4567abcd.json: name one"):
        load_champion(tmp_path / "best of 1.5")
    with pytest.raises(ArtefactError, match=r"best.json: no controller is stored there. Did you mean best of 1.5"):
        load_champion(tmp_path / "best")


def test_a_run_folder_in_place_of_a_controller_is_refused_with_its_controllers(tmp_path):
    for name in ("linear-0123abcd", "near-0123abcd"):
        save_champion(CHAMPION, tmp_path / "run" / "controllers" / name)
    there = tmp_path / "run" / "controllers"
    for named in (tmp_path / "run", there, there / "xyz"):
        with pytest.raises(ArtefactError, match=re.escape(f"There are {there / 'linear'}, {there / 'near'}")):
            load_champion(named)
    with pytest.raises(ArtefactError, match=r"no controller is stored there$"):
        load_champion(tmp_path / "elsewhere" / "linear")


def test_a_model_of_a_run_is_found_without_the_digest_too(stored):
    for suffix in (".json", ".safetensors"):
        stored.with_suffix(suffix).rename(stored.with_name(f"model-0123abcd{suffix}"))
    assert type(load_model(stored)) is type(load_model(stored.with_name("model-0123abcd")))
    assert is_stored_artefact(str(stored), "model")
    assert not is_stored_artefact("linear", "model")


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_a_path_without_a_name_is_refused(path, linear):
    for use in (load_model, load_champion, lambda path: save_model(linear, path)):
        with pytest.raises(ArtefactError, match="expected the name of a file, such as runs/mine/models/NAME, got '"):
            use(path)


def test_a_model_is_no_champion_and_a_champion_no_model(stored, tmp_path):
    with pytest.raises(ArtefactError, match=r"model.json: expected a stored controller, got a model"):
        load_champion(stored)
    save_champion(CHAMPION, tmp_path / "c")
    with pytest.raises(ArtefactError, match=r"c.json: expected a stored model, got a controller"):
        load_model(tmp_path / "c")


@pytest.mark.parametrize(
    "change, reason",
    [
        *(
            (lambda learned, key=key: learned.pop(key), f"KeyError: '{key}'; .* another version .* evolve again")
            for key in ("name", "against", "aggregate", "task", "controller", "seed_fitness", "scoring_models")
        ),
        (lambda learned: learned.update(against=None), "TypeError"),
    ],
)
def test_a_champion_that_lacks_something_or_has_a_wrong_type_is_refused(tmp_path, change, reason):
    save_champion(CHAMPION, tmp_path / "c")
    rewrite(tmp_path / "c", lambda manifest: change(manifest["learned"]))
    with pytest.raises(ArtefactError, match=f"not a stored controller: {reason}"):
        load_champion(tmp_path / "c")


@pytest.mark.parametrize(
    "also, reason",
    [
        ("object", "extra_ is a object; learned values must be arrays, numbers"),
        ("mapping", "extra_ is a dict"),
        ("nan", "cannot be stored: learned: .*expected finite numbers, got nan"),
        ("numpy number", "extra_ is a float64"),
    ],
)
def test_what_cannot_be_stored_is_refused_and_the_older_file_stays(scrapbook, car_data, tmp_path, also, reason):
    save_model(scrapbook().fit(car_data, rng=0), tmp_path / "book")
    before = (tmp_path / "book.safetensors").read_bytes()
    with pytest.raises(InvalidArgument, match=reason):
        save_model(scrapbook(also=also).fit(car_data, rng=1), tmp_path / "book")
    assert (tmp_path / "book.safetensors").read_bytes() == before
    load_model(tmp_path / "book")


def test_a_parameter_that_json_cannot_hold_is_refused(car_data, tmp_path):
    model = make_model("linear").fit(car_data, rng=0)
    for value in (np.zeros(3), float("inf"), {1: 2}):
        model.ridge = value
        with pytest.raises(InvalidArgument, match=r"cannot be stored: parameters: .*expected"):
            save_model(model, tmp_path / "model")
    assert not list(tmp_path.iterdir())


def test_only_fitted_models_of_registered_families_are_stored(car_data, tmp_path):
    with pytest.raises(NotFitted, match=r"model 'linear' is not fitted, so there is nothing to store"):
        save_model(make_model("linear"), tmp_path / "model")
    with pytest.raises(InvalidArgument, match="Scrapbook is not a registered family: decorate it with @register_model"):
        family_name(Scrapbook())
    assert not list(tmp_path.iterdir())


def test_a_dot_in_a_name_is_no_suffix(linear, tmp_path):
    for name in ("model-0.5", "model-0.7"):
        save_model(linear, tmp_path / name)
    assert sorted(path.name for path in tmp_path.glob("*.json")) == ["model-0.5.json", "model-0.7.json"]
    load_model(tmp_path / "model-0.5")


def test_a_file_larger_than_its_tensors_is_refused_before_it_is_read(stored):
    with stored.with_suffix(".safetensors").open("r+b") as file:
        file.truncate(20 * 2**30)  # a sparse file: nothing is written
    tracemalloc.start()
    try:
        with pytest.raises(ArtefactError, match=r"model.safetensors: \d+ bytes are more than the tensors"):
            load_model(stored)
        assert tracemalloc.get_traced_memory()[1] < 100 * 2**20
    finally:
        tracemalloc.stop()


def test_a_crash_while_writing_leaves_the_older_file_whole(tmp_path):
    path = tmp_path / "deep" / "file.txt"
    write_atomically(path, lambda temporary: temporary.write_text("old"))

    def crash(temporary):
        temporary.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, crash)
    assert path.read_text() == "old"
    assert [entry.name for entry in path.parent.iterdir()] == ["file.txt"]


class Parts(DynamicsModel):
    """Learns other models: one by itself, and two in a list, of which one sees fewer states."""

    def fit(self, dataset, *, rng, progress=None):
        system = System(("forward_speed",), dataset.system.controls, dataset.system.dt)
        fewer = Dataset(system, [Trajectory(e.states[:, :1], e.controls, e.dt, name=e.name) for e in dataset.episodes])
        self.base_ = make_model("linear", ridge=0.5).fit(dataset, rng=rng)
        self.members_ = [make_model("linear", ridge=ridge).fit(data) for ridge, data in ((0.1, dataset), (0.2, fewer))]
        self.weight_ = 0.25
        return self

    def next_state(self, carry, control):
        return self.base_.next_state(carry, control)


@pytest.fixture
def parts(register, car_data, tmp_path):
    model = register(models, "parts", Parts)().fit(car_data, rng=0)
    save_model(model, tmp_path / "parts")
    return model


def test_models_that_a_model_learned_come_back_with_it(parts, tmp_path):
    loaded = load_model(tmp_path / "parts")
    assert loaded.weight_ == 0.25
    pairs = [(loaded.base_, parts.base_), *zip(loaded.members_, parts.members_, strict=True)]
    for inner, before in pairs:
        assert inner.get_params() == before.get_params()
        assert inner.system == before.system
        np.testing.assert_array_equal(inner.state_bounds_, before.state_bounds_)
        carry, control = np.full((1, before.system.nx), 0.3), np.full((1, 2), 1.0)
        np.testing.assert_array_equal(inner.next_state(carry, control), before.next_state(carry, control))
    assert [inner.system.nx for inner in loaded.members_] == [parts.system.nx, 1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda learned: learned["base_"].pop("module"), "base_: expected a model with name, module"),
        (lambda learned: learned["members_"][1].update(name="no_such"), "no_such"),
        (lambda learned: learned["members_"].append(3), "members_: expected a model"),
        (lambda learned: learned["base_"].update(system=None), "system of a model cannot be a NoneType"),
        (lambda learned: learned["base_"]["learned"].update(fit=1), "'fit' cannot be the name"),
    ],
)
def test_a_damaged_model_within_a_model_is_refused_with_the_reason(parts, tmp_path, change, said):
    rewrite(tmp_path / "parts", lambda manifest: change(manifest["learned"]))
    with pytest.raises(ArtefactError, match=said):
        load_model(tmp_path / "parts")
