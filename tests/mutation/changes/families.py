"""Model families: how they are fitted and judged."""

from tests.mutation.change import Change

SPREAD = "tests/model_zoo/test_spread.py"
VALIDATION = "tests/model_zoo/test_validation.py"

CHANGES = (
    Change(
        "the conformal correction is left out",
        "model_zoo/validation/spread.py",
        "level = min(1.0, share * (len(errors) + 1) / len(errors))",
        "level = share",
        (SPREAD,),
    ),
    Change(
        "earlier samples count as much as the present one",
        "model_zoo/k_neighbours.py",
        "weight = np.full(len(scale), 0.5)",
        "weight = np.full(len(scale), 1.0)",
        ("tests/model_zoo/test_small_systems.py",),
    ),
    Change(
        "a narx that diverges may be chosen",
        "model_zoo/narx.py",
        "errors[index] += 1e6 if diverges(trial, windows, dataset) else 0.0",
        "errors[index] += 0.0 if diverges(trial, windows, dataset) else 0.0",
        (VALIDATION,),
    ),
    Change(
        "evolved3 looks one step ahead",
        "model_zoo/evolved3.py",
        "windows=self.windows, horizon=self.horizon,",
        "windows=self.windows, horizon=1,",
        (VALIDATION,),
    ),
    Change(
        "all steps of a free run weigh alike",
        "model_zoo/networks/multistep.py",
        "** -SHARPNESS",
        "** -0.0",
        ("tests/model_zoo/test_networks.py",),
    ),
    Change(
        "an evolved fit looks one step ahead, whatever it is told",
        "sysid_evo/evolution/identification.py",
        "every = dataset.windows(self.horizon, history=history)",
        "every = dataset.windows(1, history=history)",
        ("tests/sysid_evo/test_model_evolution.py",),
    ),
    Change(
        "states of small numbers hardly count in an evolved fit",
        "sysid_evo/evolution/identification.py",
        'if weights == "paper":',
        'if weights != "paper":',
        ("tests/sysid_evo/test_model_evolution.py",),
    ),
    Change(
        "blocks held out are also learned from",
        "model_zoo/validation/held_out.py",
        "(held if out[begin] else learned).append(",
        "(held if out[begin] else learned).append(episode) or learned.append(",
        (VALIDATION,),
    ),
    Change(
        "the error of a free run is not relative to the spread of the truth",
        "sysid_evo/free_run.py",
        "np.mean(np.sqrt(np.mean(off**2, axis=0)) / spread)",
        "np.mean(np.sqrt(np.mean(off**2, axis=0)))",
        ("tests/sysid_evo/test_fit_and_score.py",),
    ),
    Change(
        "the history of one run is padded with its last state",
        "sysid_evo/free_run.py",
        "np.repeat(history[:1], missing, axis=0)",
        "np.repeat(history[-1:], missing, axis=0)",
        ("tests/sysid_evo/test_fit_and_score.py",),
    ),
    Change(
        "neighbours may be left behind: the plane is not clipped to what they did",
        "model_zoo/k_neighbours.py",
        "np.clip(plane, targets.min(axis=1), targets.max(axis=1))",
        "plane",
        (VALIDATION,),
    ),
)
