"""Models, ensembles and robots as Gymnasium environments, single or vectorised; policies as champions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from sysid_evo.artefacts import is_stored_artefact as is_stored
from sysid_evo.carry import clip_state
from sysid_evo.data.frames import is_stored_dataset
from sysid_evo.engine.results import scored
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.evolution.champion import Champion
from sysid_evo.extras import missing_extra
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.models.storage import load_model
from sysid_evo.randomness import draw_for_steps, draw_for_trials
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import make_robot
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Task, make_task
from sysid_evo.types import Array, BoolArray, IntArray, Seeds

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.error import ResetNeeded
    from gymnasium.utils import seeding
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    raise missing_extra("an environment", error.name) from error

SEEDS = 2**63

Actions: TypeAlias = Literal["auto", "continuous", "discrete"]
"""Kind of actions: continuous controller outputs (Box), or the index of a level for each control (discrete)."""


class ModelEnvironment(gymnasium.Env[Any, Any]):
    """Environment whose episode is one trial of ``task`` on one of ``members``, drawn for each episode.

    The observation is that of a controller. The reward is the increase of the fitness, so that the initial fitness plus
    the rewards of an episode is the fitness. An episode is terminated if the task ends the trial or the model diverges,
    and truncated at the task's horizon. ``metadata`` holds names and units; ``info`` holds the fitness, the state and
    the name of the member. ``seed`` is used by the first reset without a seed.
    """

    def __init__(
        self, members: Mapping[str, Dynamics], task: Task, *, actions: Actions = "auto", seed: int | None = None
    ) -> None:
        self.trials = EnvironmentTrials(members, task, 1)
        self.observation_space = observation_space(self.trials.task)
        self.action_space = action_space(self.trials.system, actions)
        self.metadata = metadata_of(self.trials.task, self.action_space)
        self._first_seed = seed

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a trial; ``options`` may name its ``member``."""
        seed, self._first_seed = self._first_seed if seed is None else seed, None
        super().reset(seed=seed)
        number, trial = draw_episode(self.np_random, len(self.trials.members))
        if options and "member" in options:
            number = self._number(options["member"])
        self.trials.begin(np.array([0]), np.array([trial]), np.array([number]))
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        control = control_of(self.trials.system, self.action_space, action)
        reward, terminated, truncated = self.trials.step(control[None])
        return self._observation(), float(reward[0]), bool(terminated[0]), bool(truncated[0]), self._info()

    def _observation(self) -> Any:
        return self.trials.observe()[0].astype(np.float32)

    def _info(self) -> dict[str, Any]:
        trials = self.trials
        return {
            "fitness": float(trials.fitness[0]),
            "member": trials.names[trials.member[0]],
            "state": trials.state[0].copy(),
        }

    def _number(self, member: str) -> int:
        if member not in self.trials.names:
            raise InvalidArgument(
                f"environment: expected a member among {', '.join(self.trials.names)}, got {member!r}"
            )
        return self.trials.names.index(member)


class ModelVectorEnvironment(VectorEnv[Any, Any, Any]):
    """``num_envs`` copies of a `ModelEnvironment` that are stepped in one call of the dynamics.

    Copy i behaves like a single environment that was reset with the seed of copy i. A copy whose episode has ended is
    reset at its next step, whose action is ignored.
    """

    def __init__(
        self,
        members: Mapping[str, Dynamics],
        task: Task,
        num_envs: int,
        *,
        actions: Actions = "auto",
        seed: int | None = None,
    ) -> None:
        super().__init__()
        self.num_envs = num_envs
        self.trials = EnvironmentTrials(members, task, num_envs)
        self.single_observation_space = observation_space(self.trials.task)
        self.single_action_space = action_space(self.trials.system, actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {
            **metadata_of(self.trials.task, self.single_action_space),
            "autoreset_mode": AutoresetMode.NEXT_STEP,
        }
        self._first_seed = seed
        self._generators: list[np.random.Generator] = []
        self._ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin all trials; with a single ``seed`` the copies get ``seed``, ``seed`` + 1, and so on."""
        seed, self._first_seed = self._first_seed if seed is None else seed, None
        given = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if given is not None and len(given) != self.num_envs:
            raise InvalidArgument(f"environment: expected {self.num_envs} seeds, got {len(given)}")
        for i, own in enumerate(given or [None] * self.num_envs):
            if i >= len(self._generators):
                self._generators.append(seeding.np_random(own)[0])
            elif own is not None:
                self._generators[i] = seeding.np_random(own)[0]
        self.restart(np.ones(self.num_envs, dtype=bool))
        return self.observations(), self._info()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        restarting = self._ended
        controls = control_of(self.trials.system, self.single_action_space, actions, (self.num_envs,))
        reward, terminated, truncated = self.trials.step(controls)
        if restarting.any():
            self.restart(restarting)
            reward = np.where(restarting, 0.0, reward)
            terminated, truncated = terminated & ~restarting, truncated & ~restarting
        self._ended = terminated | truncated
        return self.observations(), reward, terminated, truncated, self._info()

    def restart(self, which: BoolArray) -> None:
        """Begin a new episode in the copies ``which`` (num_envs,) at once."""
        rows = np.flatnonzero(which)
        picks = [draw_episode(self._generators[row], len(self.trials.members)) for row in rows]
        self.trials.begin(rows, np.array([seed for _, seed in picks]), np.array([number for number, _ in picks]))
        self._ended = self._ended & ~which

    def observations(self) -> Any:
        """Return the current observations of all copies, (num_envs, n)."""
        return self.trials.observe().astype(np.float32)

    def _info(self) -> dict[str, Any]:
        return {"fitness": self.trials.fitness.copy(), "_fitness": np.ones(self.num_envs, dtype=bool)}


class EnvironmentTrials:
    """``count`` parallel trials of ``task``, each on one of the dynamics in ``members``.

    The rules are those of a rollout: noise and draws depend on the trial's seed alone, states are clipped to the state
    bounds, and a trial that diverges ends with less fitness than any other. Raises `InvalidArgument` without a member,
    `IncompatibleSystem` for members of different systems, `IncompatibleTask`.
    """

    def __init__(self, members: Mapping[str, Dynamics], task: Task, count: int) -> None:
        if not members or count < 1:
            raise InvalidArgument(
                f"environment: expected at least one model and one trial, got {len(members)} and {count}"
            )
        self.names, self.members = tuple(members), tuple(members.values())
        self.system = self.members[0].system
        for name, member in members.items():
            differences = self.system.differences(member.system)
            if differences:
                raise IncompatibleSystem(f"environment: {self.names[0]} and {name} differ: {'; '.join(differences)}")
        self.task = task.bind(self.system)
        self.member = np.zeros(count, dtype=np.int64)
        self.seeds = np.zeros(count, dtype=np.uint64)
        self.survived = np.zeros(count, dtype=np.int64)
        self.fitness = np.zeros(count)
        self._task_state = self.task.begin(self.seeds)
        self._carries = [np.zeros((count, member.n_carry)) for member in self.members]
        self._noise = [np.zeros((0, 0))] * count
        self._begun = False

    def begin(self, rows: IntArray, seeds: Seeds, members: IntArray) -> None:
        """Begin the trials ``rows`` (k,) again, with ``seeds`` (k,) on the ``members`` (k,), given by number."""
        self._begun = True
        self.seeds[rows], self.member[rows], self.survived[rows] = seeds, members, 0
        initial, restarted = self.task.begin(self.seeds), np.zeros(len(self.seeds), dtype=bool)
        restarted[rows] = True
        self._task_state = self._task_state.updated_where(initial, restarted)
        self.fitness[rows] = self.task.fitness(initial)[rows]
        for row in rows:
            number = int(self.member[row])
            member, seed = self.members[number], self.seeds[row : row + 1]
            self._carries[number][row] = started(
                member, initial.state[row][None], draw_for_trials(seed, member.n_draws)
            )[0]
            self._noise[row] = draw_for_steps(seed, self.task.horizon, member.n_noise)[0]

    @property
    def state(self) -> Array:
        """The states (count, nx)."""
        return self._carry_part([0] * len(self.members))

    def observe(self) -> Array:
        """Return the observations of a controller, (count, n_observations)."""
        return self.task.observe(self._task_state, self._carry_part([member.observed_at for member in self.members]))

    def step(self, control: Array) -> tuple[Array, BoolArray, BoolArray]:
        """Advance all trials by one step under ``control`` (count, nu).

        Return the increase of the fitness, whether a trial has ended, and whether it reached the horizon, each
        (count,). Raises `gymnasium.error.ResetNeeded` before the first reset.
        """
        if not self._begun:
            raise ResetNeeded("environment: step() was called before reset(): call reset() first")
        nx, before = self.system.nx, self.state
        after, diverged = before.copy(), np.zeros(len(before), dtype=bool)
        with np.errstate(all="ignore"):
            for number, member in enumerate(self.members):
                rows = np.flatnonzero(self.member == number)
                if len(rows):
                    last = np.minimum(self.survived[rows], self.task.horizon - 1)
                    drawn = [self._noise[row][k] for row, k in zip(rows, last, strict=True)]
                    carry = self._carries[number][rows]
                    stepped = member.step(carry, control[rows], np.array(drawn) if member.n_noise else None)
                    diverged[rows] = ~np.isfinite(stepped).all(axis=1)
                    stepped, _ = clip_state(np.where(diverged[rows, None], carry, stepped), member.state_bounds)
                    self._carries[number][rows], after[rows] = stepped, stepped[:, :nx]
            advanced, reached = self.task.advance(self._task_state, before, after, control=control)
        for number, carries in enumerate(self._carries):
            rows = np.flatnonzero(self.member == number)
            carries[rows, :nx] = reached[rows]
        self._task_state = self._task_state.updated_where(advanced, ~diverged)
        self.survived += ~diverged
        fitness = scored(self.task, self.task.fitness(self._task_state), self.survived, diverged)
        growth, self.fitness = fitness - self.fitness, fitness
        return growth, diverged | ~self._task_state.alive, self.survived >= self.task.horizon

    def _carry_part(self, places: list[int]) -> Array:
        """Return nx numbers of each trial's carry, (count, nx); ``places`` holds the first row for each member."""
        found = np.zeros((len(self.member), self.system.nx))
        for number, at in enumerate(places):
            rows = self.member == number
            found[rows] = self._carries[number][rows, at : at + self.system.nx]
        return found


def draw_episode(rng: np.random.Generator, members: int) -> tuple[int, np.uint64]:
    """Return the member of an episode and the seed of its trial."""
    return int(rng.integers(members)), np.uint64(rng.integers(SEEDS))


def action_space(system: System, actions: Actions) -> spaces.Space[Any]:
    """Return the space of the actions; "auto" is discrete if every control has levels.

    Continuous actions are a controller's outputs, a Box from -1 to 1, see `System.actuate`. Raises `InvalidArgument`.
    """
    if actions not in ("auto", "continuous", "discrete"):
        raise InvalidArgument(f"environment: expected actions auto, continuous or discrete, got {actions!r}")
    levels = [len(channel.levels or ()) for channel in system.controls]
    if actions == "continuous" or (actions == "auto" and not all(levels)):
        system.actuate(np.zeros(system.nu))
        return spaces.Box(-1.0, 1.0, (system.nu,), dtype=np.float32)
    if not all(levels):
        free = next(channel.name for channel in system.controls if channel.levels is None)
        raise InvalidArgument(
            f"environment: control {free!r} has no levels, so actions cannot be discrete: use actions='continuous'"
        )
    return spaces.Discrete(levels[0]) if len(levels) == 1 else spaces.MultiDiscrete(levels)


def control_of(system: System, space: spaces.Space[Any], action: Any, several: tuple[int, ...] = ()) -> Array:
    """Return the controls (*several, nu) of one action, or of an array of ``several``. Raises `InvalidArgument`."""
    given = np.asarray(action)
    expected = (*several, *(space.shape or ()))
    if given.shape != expected:
        raise InvalidArgument(f"environment: expected an action of {space}, shape {expected}, got shape {given.shape}")
    if isinstance(space, spaces.Box):
        return system.actuate(given.astype(np.float64))
    chosen = given.astype(np.int64)
    if isinstance(space, spaces.Discrete):
        chosen = chosen[..., None]
    counts = np.array([len(channel.levels or ()) for channel in system.controls])
    if ((chosen < 0) | (chosen >= counts)).any() or (given != given.astype(np.int64)).any():
        raise InvalidArgument(f"environment: expected an action of {space}, got {action}")
    values = [np.asarray(channel.levels)[chosen[..., i]] for i, channel in enumerate(system.controls)]
    return np.stack(values, axis=-1)


def observation_space(task: Task) -> spaces.Box:
    """Return the space of the observations of ``task``, without limits, since a simulation may exceed them."""
    return spaces.Box(-np.inf, np.inf, (len(task.observations),), dtype=np.float32)


def metadata_of(task: Task, space: spaces.Space[Any]) -> dict[str, Any]:
    """Return names and units of observations, actions and rewards, and the time step in s."""
    outputs = isinstance(space, spaces.Box)
    return {
        "render_modes": [],
        "render_fps": round(1.0 / task.system.dt),
        "dt": task.system.dt,
        "observations": _described(task.observations),
        "actions": {name: "" if outputs else unit for name, unit in _described(task.system.controls).items()},
        "controls": _described(task.system.controls),
        "reward": task.fitness_unit,
    }


def _described(channels: tuple[Channel, ...]) -> dict[str, str]:
    return {channel.name: channel.unit for channel in channels}


ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu"}


def champion_from_policy(
    algorithm: Any, trials: EnvironmentTrials, *, name: str, task: str | Spec, seed: int = 0
) -> Champion:
    """Return a champion with the policy that a PPO or SAC ``algorithm`` of Stable-Baselines3 learned on ``trials``.

    The policy must be a plain network (``MlpPolicy``) with unscaled observations and continuous actions; only its
    weights are read. ``task`` is the spec of the task. Raises `InvalidArgument` for another policy.
    """
    policy = algorithm.policy
    if hasattr(policy, "mlp_extractor") and hasattr(policy, "action_net"):
        inner, last, output = policy.mlp_extractor.policy_net, policy.action_net, "clip"
    elif hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):
        inner, last, output = policy.actor.latent_pi, policy.actor.mu, "tanh"
    else:
        raise InvalidArgument(f"policy: expected the MlpPolicy of PPO or SAC, got a {type(policy).__name__}")
    linear = [layer for layer in inner if hasattr(layer, "weight")]
    between = {type(layer).__name__ for layer in inner if not hasattr(layer, "weight")}
    last = last[0] if hasattr(last, "__getitem__") else last
    if len(between) != 1 or not between <= ACTIVATIONS.keys() or last.weight.shape[0] != trials.system.nu:
        raise InvalidArgument(
            f"policy: expected one of {', '.join(ACTIVATIONS)} between the layers and one output for each of "
            f"{trials.system.nu} controls, got {', '.join(sorted(between)) or 'none'} and {last.weight.shape[0]}; "
            "make the environment with actions='continuous'"
        )
    hidden = [int(layer.weight.shape[0]) for layer in linear]
    numbers = []
    for layer in (*linear, last):  # its weights (n_in, n_out) row by row, and then its biases
        weight, bias = (part.detach().cpu().numpy().astype(np.float64) for part in (layer.weight, layer.bias))
        numbers += [weight.T.ravel(), bias]
    return Champion(
        name=name,
        parameters=np.concatenate(numbers),
        against=trials.names,
        aggregate="mean",
        seed=seed,
        history=np.empty((0, 3)),
        controller=Spec("policy", {"hidden": hidden, "inner": ACTIVATIONS[between.pop()], "output": output}),
        task=task,
        system=trials.system,
    )


Source: TypeAlias = Dynamics | str | Path
"""A model, an emulated robot's dynamics, the file of a stored model, or the name of an emulated robot."""


def make_env(
    model: Source | Iterable[Source] | Mapping[str, Source],
    task: str | Task = "point_to_point",
    *,
    actions: Actions = "auto",
    seed: int | None = None,
    render_mode: None = None,
) -> ModelEnvironment:
    """Return a Gymnasium environment of ``task`` on ``model``.

    ``model`` is a model, the path of one, the name of an emulated robot, or several of these: an ensemble, whose member
    is drawn for each episode. ``task`` is a spec or a task; see `Actions` for ``actions``; ``seed`` is used by the
    first reset. Raises `InvalidArgument` for a ``render_mode``, since environments do not render.
    """
    _refuse_rendering(render_mode)
    return ModelEnvironment(load_members(model), _task(task), actions=actions, seed=seed)


def make_vector_env(
    model: Source | Iterable[Source] | Mapping[str, Source],
    task: str | Task = "point_to_point",
    *,
    num_envs: int = 1,
    actions: Actions = "auto",
    seed: int | None = None,
    render_mode: None = None,
) -> ModelVectorEnvironment:
    """Return ``num_envs`` copies of the environment of `make_env`, which are stepped together.

    `sysid_evo.environments.stable_baselines.StableBaselinesEnv` wraps it for Stable-Baselines3.
    """
    _refuse_rendering(render_mode)
    return ModelVectorEnvironment(load_members(model), _task(task), num_envs, actions=actions, seed=seed)


def _refuse_rendering(render_mode: str | None) -> None:
    if render_mode is not None:
        raise InvalidArgument(
            f"environment: expected no render_mode, since environments do not render, got {render_mode!r}. The state "
            "is in the info of every step. To watch a trained policy, store it as a controller (champion_from_policy, "
            "save_champion) and run `sysid-evo drive --controller FILE --watch`"
        )


def _task(task: str | Task) -> Task:
    return make_task(task) if isinstance(task, str) else task


def load_members(source: Source | Iterable[Source] | Mapping[str, Source]) -> dict[str, Dynamics]:
    """Return the dynamics of ``source`` by name; several are an ensemble.

    A folder, such as ``models`` of a run, means all models in it. Raises `InvalidArgument`, `ArtefactError`, and the
    errors of the registry of robots.
    """
    if isinstance(source, Mapping):
        return {name: _dynamics(one) for name, one in source.items()}
    if isinstance(source, Dynamics):
        return {type(source).__name__: source}
    if isinstance(source, (str, Path)):
        if (folder := Path(source)).is_dir():
            files = sorted(folder.glob("*.json"))
            if not files or is_stored_dataset(folder):
                raise InvalidArgument(
                    f"environment: no model is stored in {folder}: give the folder 'models' of a run, or the file of "
                    "a model"
                )
            return {file.stem: _dynamics(file) for file in files}
        return {_name_of(source): _dynamics(source)}
    return {f"{_name_of(one)}-{i}": _dynamics(one) for i, one in enumerate(source, start=1)}


def _dynamics(source: Source) -> Dynamics:
    if isinstance(source, Dynamics):
        return source
    if is_stored(str(source), "model"):
        return load_model(source)
    dynamics: Dynamics | None = make_robot(str(source)).dynamics
    if dynamics is None:
        raise InvalidArgument(
            f"environment: {str(source)!r} is not an emulated robot, so it has no equations: give an emulated robot "
            "or the file of a model"
        )
    return dynamics


def _name_of(source: Source) -> str:
    return type(source).__name__ if isinstance(source, Dynamics) else Path(source).stem


ENVIRONMENTS: Mapping[str, tuple[str, str]] = {
    "sysid_evo/PointToPoint-v0": ("emulated_car", "point_to_point"),
    "sysid_evo/WalledTrack-v0": ("emulated_car", "walled_track"),
    "sysid_evo/SwingUp-v0": ("pendulum", "swing_up"),
    "sysid_evo/Balance-v0": ("cart_pole", "balance"),
    "sysid_evo/SetPoint-v0": ("thermal", "set_point"),
    "sysid_evo/TrackReference-v0": ("thermal", "track_reference"),
}
"""Emulated robot and task of each environment; `gymnasium.make` also accepts ``model`` and ``task``."""


for _name, (_robot, _at) in ENVIRONMENTS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point=f"{__name__}:make_env",
            vector_entry_point=f"{__name__}:make_vector_env",
            kwargs={"model": _robot, "task": _at},
        )
