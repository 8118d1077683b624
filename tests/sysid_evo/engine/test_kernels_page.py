"""The examples of docs/kernels.md run as they stand."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import check_model

PAGE = Path(__file__).parents[3] / "docs" / "kernels.md"
NAMES = ("damped", "damped_lifted", "damped_block")


@pytest.fixture
def examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, register: Callable[..., Any]) -> Any:
    """The module that the blocks of the page make."""
    path = tmp_path / "from_the_page.py"
    path.write_text("\n\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)))
    spec = importlib.util.spec_from_file_location("from_the_page", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "from_the_page", module)
    spec.loader.exec_module(module)
    yield module
    for name in NAMES:
        models.forget(name)


def test_every_example_keeps_the_contract_and_its_kernel_is_its_numpy_form(examples: Any, recording: Dataset) -> None:
    for name in NAMES:
        check_model(name)
    for name in NAMES:
        assert examples.difference(name) == 0.0


def test_the_page_names_nothing_that_an_installed_package_lacks() -> None:
    text = PAGE.read_text()
    assert not re.search(r"python -m tests|make \w+|tests\.benchmarks|model_zoo/\w+\.py", text)
    assert set(re.findall(r"from (sysid_evo\.engine[\w.]*) import", text)) == {"sysid_evo.engine"}


def test_the_three_levels_step_alike_in_the_forms_they_promise(examples: Any, recording: Dataset) -> None:
    weights = np.random.default_rng(1).standard_normal((5, 78))
    forms = []
    for name in NAMES:
        model = make_model(name).fit(recording, rng=np.random.default_rng(0))
        given = (model, examples.RecurrentNetwork(), weights, PointToPoint(horizon=30), examples.trial_seeds(0, 2))
        forms.append(rollout(*given).engine)
        if name != "damped":
            fast, exact = (rollout(*given, engine=engine, record=True) for engine in ("float64", "reference"))
            for a, b in zip(fast.trajectories, exact.trajectories, strict=True):
                np.testing.assert_allclose(a.states, b.states, rtol=1e-12, atol=1e-12)
    assert forms == ["reference", "compiled float32", "compiled float32"]
