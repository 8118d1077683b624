"""What data, models and champions look like in a terminal and in a notebook: short, quick to make, escaped."""

import numpy as np
import pytest

from sysid_evo import Champion, Channel, Dataset, System, make_model
from sysid_evo.display import listed
from sysid_evo.testing import example_dataset

MOST = 500
"""Characters of one line."""
HOSTILE = "<script>alert(1)</script>"


def champion():
    history = np.tile([3.0, 2.0, 1.0], (300, 1))
    return Champion("mine", np.zeros(5000), ("linear", "narx"), "min", 0, history, population=np.zeros((40, 5000)))


def test_a_million_samples_are_a_line():
    system = example_dataset().system
    data = Dataset.from_arrays(system, np.zeros((1_000_001, 3)), np.zeros((1_000_000, 2)))
    assert len(repr(data)) < MOST
    assert "1 (episode-0), steps: 1,000,000 of 0.05 s, 50,000.0 s in all" in repr(data)
    assert len(repr(data.episodes[0])) < MOST
    assert "1000000 of 0.05 s" in repr(data.episodes[0])


def test_many_names_are_the_first_ones_and_how_many_there_are():
    many = [f"x{i}" for i in range(60)]
    assert listed(many).endswith("x7, ... (60 in all)")
    assert listed([]) == "none"
    data = Dataset.from_arrays(System(many, ["u"], 0.1), [np.zeros((3, 60))] * 500, [np.zeros(2)] * 500)
    assert len(repr(data)) < MOST
    assert "500 (episode-0, " in repr(data)


def test_a_model_says_whether_it_is_fitted_and_what_it_learned():
    model = make_model("linear", ridge=0.1)
    assert repr(model) == "Linear(ridge=0.1)"
    assert "no</td>" in model._repr_html_()
    data = example_dataset()
    model.fit(data)
    assert repr(model).startswith("Linear(ridge=0.1), fitted: ")
    assert "forward_speed (m/s)" in repr(model)
    assert len(repr(model)) < MOST
    assert model.clone_unfitted().facts() == {}
    assert "forward_speed[+1] = " in make_model("narx(terms=3)").fit(data)._repr_html_()


def test_a_champion_is_named_with_its_task_and_what_it_reached():
    text = repr(champion())
    assert len(text) < MOST
    for part in ("mine", "controller: recurrent", "task: point_to_point", "linear, narx (min)", "3 after 300 gen"):
        assert part in text


@pytest.mark.parametrize("made", ["data", "model", "champion", "system"])
def test_names_from_elsewhere_are_text_in_a_notebook(made):
    system = System([Channel(HOSTILE, unit="<b>")], ["u"], 0.1, name=HOSTILE)
    states = np.random.default_rng(0).standard_normal((50, 1))
    data = Dataset.from_arrays(system, states, states[1:], names=[HOSTILE])
    shown = {
        "data": data,
        "system": system,
        "champion": Champion(HOSTILE, np.zeros(1), (HOSTILE,), "min", 0, np.zeros((0, 3))),
    }.get(made)
    html = make_model("linear").fit(data)._repr_html_() if shown is None else shown._repr_html_()
    assert "&lt;script&gt;" in html
    assert "<script" not in html
    assert "<b>" not in html
