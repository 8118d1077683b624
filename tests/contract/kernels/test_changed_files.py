"""A stored model whose numbers were changed, with right digests, is refused or steps as its reference form does.

Its compiled form runs between guards: memory that is nan, so that a read past the end of an array makes the result
nan, and a write there is seen.
"""

import hashlib
import json
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save

from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.compiler import compiled, compiled_loop
from sysid_evo.errors import ArtefactError
from sysid_evo.kernels import DYNAMICS, LANES
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.models.dynamics import started
from sysid_evo.registry import models
from tests.fixtures.families import SMALL

MODELS = {
    "linear, lags": ("linear", {"state_lags": 1, "control_lags": 2}),
    "linear, stochastic": ("linear", {"stochastic": True}),
    "average": ("average", {"families": ["linear(state_lags=1)", "linear(control_lags=1)"]}),
    "adapted": ("adapted", {"base": "linear"}),
    "sindy, functions": ("sindy", {"functions": ["abs(forward_speed)"], "degree": 1, "threshold": 0.1}),
    "single_track, residual": ("single_track", {"residual": True, "residual_points": 20, **SMALL["single_track"]}),
    **{name: (name, SMALL.get(name, {})) for name in models.names() if name not in ("adapted", "average")},
}
COMPILED = ("linear, lags", "nonlinear_state_space", "narx")
"""Compiled by day: lags, kinds of units and powers are what a kernel finds its places by."""
HEAVY = (
    "adapted", "auto", "backprop27", "evolved3", "hybrid_ode", "latent_ode", "linear_state_space", "neural_ode",
    "sindy, functions", "sindy_discrete", "single_track", "single_track, residual", "torch_ode",
)  # fmt: skip
"""What takes longer to fit."""
GUARD = 4096
"""Numbers on each side: more than any array of these models is longer or shorter after a change."""


def changed_array(array, rng):
    """Return ``array`` with another shape, type or content."""
    kind, axis = rng.integers(14), int(rng.integers(array.ndim)) if array.ndim else 0
    kind = kind if array.size else 4
    if kind < 10:
        types = ["float32", "float16", "int64", "int8", "bool", "uint8"]
        return [
            lambda: np.concatenate([array, array], axis=axis),
            lambda: np.delete(array, -1, axis=axis),
            lambda: array.T.copy(),
            lambda: array.ravel(),
            lambda: array[None],
            lambda: array[:0],
            lambda: np.insert(array, 0, 0, axis=axis),
            lambda: array.astype(rng.choice(types)),
            lambda: array[..., None],
            lambda: np.flip(array, axis=axis).copy(),
        ][kind]()
    other, at = array.copy(), int(rng.integers(array.size))
    with np.errstate(all="ignore"):
        number = other.flat[at] * [1, 10, -1, 1000][kind - 10] + [1000, 1, 0, 7][kind - 10]
        other.flat[at] = number.astype(other.dtype)
    if other.dtype.kind == "f" and rng.random() < 0.5:
        other.flat[at] = rng.choice([np.nan, np.inf, -np.inf, 1e30])
    return other


def changed_number(value, rng):
    """Return another number, or something that is none, in the place of ``value``."""
    offered: list[Any] = [-1, 0, 1, 2, 3, 7, 100, 1e9, "text", None, [], [1], {}, True]
    return offered[int(rng.integers(len(offered)))]


def change(path, rng):
    """Change the stored model at ``path``, with right digests; return what was changed."""
    manifest = json.loads(path.with_suffix(".json").read_text())
    tensors = load_file(path.with_suffix(".safetensors"))
    place = rng.random()
    name = str(rng.choice(sorted(tensors)))
    if place < 0.6:
        tensors[name] = changed_array(tensors[name], rng)
        said = f"{name} is now {tensors[name].dtype} {tensors[name].shape}"
    elif place < 0.65:
        said = f"{name} is gone"
        del tensors[name]
    elif place < 0.7:
        other = str(rng.choice(sorted(tensors)))
        tensors[name], said = tensors[other], f"{name} is {other}"
    elif place < 0.85:
        where = [manifest["parameters"], manifest["learned"]][int(rng.integers(2))]
        key = str(rng.choice(sorted(where))) if where else ""
        if key:
            where[key] = changed_number(where[key], rng)
        said = f"{key} is now {where.get(key)!r}"
    else:
        which = str(rng.choice(["states", "controls"]))
        channels = manifest["system"][which]
        if rng.random() < 0.5:
            channels.pop(int(rng.integers(len(channels))))
        else:
            channels.insert(int(rng.integers(len(channels) + 1)), {**channels[0], "name": "another"})
        said = f"there are {len(channels)} {which}"
    payload = save({key: np.ascontiguousarray(value) for key, value in tensors.items()})
    manifest["tensors"] = {key: list(value.shape) for key, value in tensors.items()}
    manifest["sha256"] = hashlib.sha256(payload).hexdigest()
    path.with_suffix(".safetensors").write_bytes(payload)
    path.with_suffix(".json").write_text(json.dumps(manifest))
    return said


def guarded_step(kernel, carry, control, noise):
    """Return the next carries (LANES, n_carry) in float64, and whether all memory around arrays is as it was."""
    parts = {
        "carry": carry.T.ravel(), "control": control.T.ravel(), "noise": noise.T.ravel(),
        "parameters": kernel.parameters, "scratch": np.zeros(kernel.n_scratch * LANES),
    }  # fmt: skip
    room = np.full(sum(part.size + 16 for part in parts.values()) + GUARD * (len(parts) + 1), np.nan)
    guard, arrays, at = np.ones(len(room), dtype=bool), {}, GUARD
    for name, part in parts.items():
        at = -(-at // 8) * 8
        arrays[name] = room[at : at + part.size]
        arrays[name][:], guard[at : at + part.size] = part, False
        at += part.size + GUARD
    loop = compiled_loop(loops.one_step, loops.ONE_STEP, "float64")
    loop(*loops.ONE_STEP.ordered(dynamics=compiled(kernel.source, DYNAMICS, "float64"), **arrays))
    return arrays["carry"].reshape(-1, LANES).T, bool(np.isnan(room[guard]).all())


def disagreement(model, dataset, compiled):
    """Return what is wrong with the steps of ``model``: an exception, another shape or, compiled, another result."""
    kernel, rng, system = model.kernel(), np.random.default_rng(0), model.system
    states = np.resize(dataset.transitions().state, (LANES, system.nx))
    if model.state_bounds is not None:
        states = np.clip(states, *np.clip(model.state_bounds, -1e30, 1e30))
    carry = started(model, states, rng.standard_normal((LANES, model.n_draws)))
    control = system.actuate(rng.uniform(-1.0, 1.0, (LANES, system.nu)))
    noise = rng.standard_normal((LANES, model.n_noise))
    for _ in range(3):
        with np.errstate(all="ignore"):
            after = model.step(carry.copy(), control, noise if model.n_noise else None)
        if after.shape != carry.shape:
            return "" if kernel is None else f"the carry {carry.shape} becomes {after.shape}"
        plain = np.isfinite(after).all(axis=1) & (np.abs(after).max(axis=1) < 1e12)  # others are diverged trials
        if compiled and kernel is not None:
            found, kept = guarded_step(kernel, carry, control, noise)
            if not kept:
                return "written past the end of an array"
            scale = np.abs(after[plain]).max(axis=0, initial=1.0)
            off = (~(np.abs(found[plain] - after[plain]) <= 1e-6 * scale)).any(axis=1)
            if off.sum() > 3:  # a few may: two neighbours as near as each other
                return f"{off.sum()} of {len(off)} rows differ"
        carry = np.where(plain[:, None], after, carry)
    return ""


@pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.nightly) if n in HEAVY else n for n in MODELS])
def test_a_changed_model_is_refused_or_steps_as_its_reference_does(name, tmp_path, car_data, request):
    """Nothing but an `ArtefactError` when it is loaded, and no exception when it is used."""
    nightly, (family, options) = request.config.getoption("--nightly"), MODELS[name]
    compiled = nightly or name in COMPILED
    quick = dict(models.get(family).presets.get("quick", {}))
    model = make_model(family, **{**quick, **options}).fit(car_data, rng=np.random.default_rng(1))
    save_model(model, tmp_path / "whole")
    assert not disagreement(load_model(tmp_path / "whole"), car_data, compiled)
    wrong, refused = [], 0
    for seed in range(50 if nightly else 16):
        for suffix in (".json", ".safetensors"):
            (tmp_path / f"changed{suffix}").write_bytes((tmp_path / f"whole{suffix}").read_bytes())
        said = change(tmp_path / "changed", np.random.default_rng([seed, *name.encode()]))
        try:
            loaded = load_model(tmp_path / "changed")
        except ArtefactError:
            refused += 1
            continue
        try:
            fault = disagreement(loaded, car_data, compiled)
        except Exception as error:  # any is a traceback for who uses the model
            fault = f"{type(error).__name__}: {error}"
        if fault:
            wrong.append(f"{said}: {fault}")
    assert not wrong
    assert refused
