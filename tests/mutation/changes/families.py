"""Model families: how they are fitted and judged."""

from tests.mutation.change import Change

VERDICTS = "tests/model_zoo/test_verdicts.py"
VALIDATION = "tests/model_zoo/test_validation.py"
AUTO = "tests/model_zoo/test_auto.py"
TRIES = "tests/model_zoo/test_what_auto_tries.py"
LEARNING, SHOOTING = "model_zoo/state_space/estimation.py", "tests/model_zoo/hidden/test_shooting.py"

CHANGES = (
    Change(
        "a state space may run away where controls are held longer",
        LEARNING,
        "runs(slower), runs([louder])",
        "runs([louder])",
        (SHOOTING,),
    ),
    Change(
        "a state space may run away where controls are larger",
        LEARNING,
        "runs(slower), runs([louder])",
        "runs(slower)",
        (SHOOTING,),
    ),
    Change(
        "a network of a small system takes as much less time as it has fewer states",
        "model_zoo/auto/candidates.py",
        "size = 1.0 - self.widening + self.widening * (system.nx",
        "size = 1.0 * (system.nx",
        (TRIES,),
    ),
    Change(
        "what is known of an inducing point to rounding is divided by",
        "model_zoo/gaussian_process.py",
        "if known[row] <= LEAST:",
        "if False:",
        ("tests/model_zoo/test_inducing_rows.py",),
    ),
    Change(
        "a mean of one structure is one of several",
        "model_zoo/auto/selection.py",
        "inside.pop() if len(inside) == 1 else",
        "inside.pop() if len(inside) == 0 else",
        (AUTO,),
    ),
    Change(
        "an average alone stands for that of processes",
        "model_zoo/auto/candidates.py",
        "if one.spec.name == spec.name and one is not PROCESSES]",
        "if one.spec.name == spec.name]",
        (TRIES,),
    ),
    Change(
        "half the members are expected to take half the time",
        "model_zoo/auto/candidates.py",
        "share = ALONE + (1.0 - ALONE) * members / most",
        "share = members / most",
        (TRIES,),
    ),
    Change(
        "all members of a mean weigh alike, whatever their structure",
        "model_zoo/auto/selection.py",
        "1.0 / np.sqrt(count[structure])",
        "1.0",
        (AUTO,),
    ),
    Change(
        "all classes weigh alike, however many are in them",
        "model_zoo/auto/selection.py",
        "1.0 / np.sqrt(count[structure])",
        "1.0 / count[structure]",
        (AUTO,),
    ),
    Change(
        "all families are tried anew for an adaptation",
        "model_zoo/auto/model.py",
        "    chooses = True\n",
        "",
        (AUTO,),
    ),
    Change(
        "the gate is never narrowed",
        "model_zoo/auto/selection.py",
        "if error <= (1.0 + AS_GOOD) * lowest)",
        "if error >= 0.0)",
        (AUTO,),
    ),
    Change(
        "what is far behind is refined all the same",
        "model_zoo/auto/selection.py",
        "found.mean <= PROMISING * min(one.mean for one in errors if one is not None)",
        "found.mean > 0.0",
        (AUTO, TRIES),
    ),
    Change(
        "free runs are judged without the history that hidden states are found in",
        "sysid_evo/validation/simulation_error.py",
        "(typical - max(horizons)) // HISTORY_SHARE",
        "typical // 20",
        (AUTO, TRIES),
    ),
    Change(
        "a committee weighs as much as each of its models would alone",
        "model_zoo/auto/model.py",
        "np.full(len(own), share / len(own))",
        "np.full(len(own), share)",
        (AUTO, TRIES),
    ),
    Change(
        "what progress raises counts as a candidate that failed",
        "model_zoo/auto/fitting.py",
        "raise Stopped(error) from None",
        "raise",
        (AUTO,),
    ),
    Change(
        "what drives a state out of its range does not fade",
        "model_zoo/polynomial/sindy.py",
        "up = np.maximum(total, 0.0) * np.maximum(1.0 - above * per_margin, 0.0)",
        "up = np.maximum(total, 0.0)",
        (
            "tests/model_zoo/test_sparse_stability.py::test_beyond_the_margin_every_state_moves_back_whatever_the_polynomial_says",
        ),
    ),
    Change(
        "the conformal correction is left out",
        "sysid_evo/validation/intervals.py",
        "level = min(1.0, share * (len(errors) + 1) / len(errors))",
        "level = share",
        (VERDICTS,),
    ),
    Change(
        "earlier samples count as much as the present one",
        "model_zoo/neighbours.py",
        "weight = np.full(len(scale), 0.5)",
        "weight = np.full(len(scale), 1.0)",
        (VERDICTS,),
    ),
    Change(
        "hyper-parameters may be chosen with which a narx diverges",
        "sysid_evo/validation/held_out.py",
        "total += DIVERGED if self.diverges(model, simulated) else 0.0",
        "total += 0.0",
        (VERDICTS,),
    ),
    Change(
        "evolved3 looks one step ahead",
        "model_zoo/evolved3.py",
        "windows=self.windows, horizon=self.horizon,",
        "windows=self.windows, horizon=1,",
        (VERDICTS,),
    ),
    Change(
        "all steps of a free run weigh alike",
        "model_zoo/networks/training.py",
        "** -SHARPNESS",
        "** -0.0",
        (VERDICTS,),
    ),
    Change(
        "an evolved fit looks one step ahead, whatever it is told",
        "sysid_evo/evolution/model_evolution.py",
        "every = dataset.window_places(self.horizon, history=history)",
        "every = dataset.window_places(1, history=history)",
        ("tests/sysid_evo/test_model_evolution.py",),
    ),
    Change(
        "states of small numbers hardly count in an evolved fit",
        "sysid_evo/evolution/model_evolution.py",
        'if self.weights == "paper" else',
        'if self.weights != "paper" else',
        ("tests/sysid_evo/test_model_evolution.py",),
    ),
    Change(
        "blocks held out are also learned from",
        "sysid_evo/validation/folds.py",
        "(held if out[begin] else learned).append(",
        "(held if out[begin] else learned).append(episode) or learned.append(",
        (VALIDATION,),
    ),
    Change(
        "the error of a free run is not relative to the spread of the truth",
        "sysid_evo/validation/simulation_error.py",
        "np.mean(np.sqrt(np.mean(off**2, axis=0)) / spread)",
        "np.mean(np.sqrt(np.mean(off**2, axis=0)))",
        ("tests/sysid_evo/test_fit_and_score.py",),
    ),
    Change(
        "the history of one run is padded with its last state",
        "sysid_evo/carry.py",
        "np.repeat(states[..., :1, :], missing, axis=-2)",
        "np.repeat(states[..., -1:, :], missing, axis=-2)",
        ("tests/sysid_evo/test_fit_and_score.py",),
    ),
    Change(
        "neighbours may be left behind: the plane is not clipped to what they did",
        "model_zoo/neighbours.py",
        "np.clip(plane, targets.min(axis=1), targets.max(axis=1))",
        "plane",
        (VALIDATION,),
    ),
    Change(
        "an angle is seen as a plain number",
        "model_zoo/features.py",
        "if place % nx in periods:",
        "if place < 0:",
        ("tests/model_zoo/test_features.py::test_a_periodic_state_stands_as_sine_and_cosine_with_its_lags",),
    ),
    Change(
        "the turns that an angle has made count as its spread",
        "sysid_evo/system.py",
        "off = self.difference(states, np.broadcast_to(middle, states.shape))",
        "off = states - middle",
        (
            "tests/sysid_evo/wrappers/test_noise.py::test_the_unit_of_noise_is_the_spread_of_the_training_states_or_of_a_driven_robot",
        ),
    ),
)
