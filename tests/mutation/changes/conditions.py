"""Models of another condition: more training, means, the spread."""

from tests.mutation.change import Change

ELSEWHERE = "sysid_evo/models/adaptation/adapted.py"
INTERVALS = "sysid_evo/validation/intervals.py"
ADAPTED = "sysid_evo/models/adaptation/adapted.py"
MEAN = "sysid_evo/models/ensemble.py"
MLP_ENSEMBLE = "model_zoo/networks/mlp_ensemble.py"
NETWORK_RATE = "model_zoo/networks/neural_ode.py"
FLOW_TRAINING = "model_zoo/networks/neural_ode.py"
MULTISTEP = "model_zoo/networks/training.py"
AVERAGE = "model_zoo/average.py"
TEST_CALIBRATED_ELSEWHERE = "tests/model_zoo/test_calibrated_elsewhere.py"
TEST_TRAINED_FURTHER = "tests/model_zoo/test_trained_further.py"

CHANGES = (
    Change(
        "the base takes over the spread of another condition",
        ELSEWHERE,
        "CorrectedSteps(one.model.variant(), one.terms",
        "CorrectedSteps(one.model, one.terms",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "parts run together",
        INTERVALS,
        "numbers.append(begin + windows.start",
        "numbers.append(windows.start",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "episodes run together",
        INTERVALS,
        "windows.start + windows.episode * longest",
        "windows.start",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "parts are run with the error of another condition",
        ELSEWHERE,
        "        steps.base.residual_ = residual\n",
        "        pass\n",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "each part has all windows",
        ELSEWHERE,
        "MOST_WINDOWS // len(pairs)",
        "MOST_WINDOWS",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change("parts without data are asked", ELSEWHERE, "and one.held is not None", "", (TEST_CALIBRATED_ELSEWHERE,)),
    Change(
        "the correction is left out of a step",
        ELSEWHERE,
        "return self.terms.next_carry(carry, control, after, self.coefficients)",
        "return after",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "the base is recalibrated itself",
        ELSEWHERE,
        "    other = base.variant()\n",
        "    other = base\n",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "the error is that about its mean",
        INTERVALS,
        "np.sqrt(np.mean(pooled**2, axis=0))",
        "pooled.std(axis=0)",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "what was fitted anew is recalibrated",
        ADAPTED,
        "not in (NONE, ANEW, REFIT)",
        "not in (NONE, REFIT)",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "what did not change is recalibrated",
        ADAPTED,
        "not in (NONE, ANEW, REFIT)",
        "not in (ANEW, REFIT)",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "nothing is recalibrated",
        ADAPTED,
        "isinstance(base, Uncertain) and base.timed",
        "isinstance(base, Uncertain) and not base.timed",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "a mean loses its shares",
        MEAN,
        "[new or old for new, old in zip(further, self.members_, strict=True)], self.weights_",
        "[new or old for new, old in zip(further, self.members_, strict=True)], self.weights_[::-1]",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "further training without a mirror",
        MLP_ENSEMBLE,
        "hidden=hidden, members=members, further=1, mirror=mirror, rng=rng)",
        "hidden=hidden, members=members, further=1, rng=rng)",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "further training of a flow without a mirror",
        FLOW_TRAINING,
        "further=0 if mirror is None else 1, mirror=mirror)",
        "further=0 if mirror is None else 1)",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "more training is on single steps alone",
        MULTISTEP,
        "single = round(SINGLE_STEPS * updates)",
        "single = updates",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "the mean of fitted models has the envelope of the first",
        AVERAGE,
        "np.stack([envelopes[:, 0].min(axis=0), envelopes[:, 1].max(axis=0)])",
        "envelopes[0]",
        ("tests/model_zoo/test_average.py",),
    ),
    Change(
        "physical parameters stay",
        NETWORK_RATE,
        "            other.physical_ = physical\n",
        "            pass\n",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "biases stay in a flow",
        NETWORK_RATE,
        "other.weights_, other.biases_ = list(network.weights), list(network.biases)",
        "other.weights_ = list(network.weights)",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "biases stay",
        MLP_ENSEMBLE,
        "other = self.variant()\n        other.weights_, other.biases_ =",
        "other = self.variant()\n        other.weights_, _ =",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "a flow itself is changed",
        NETWORK_RATE,
        "        other = self.variant()\n        other.weights_",
        "        other = self\n        other.weights_",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "a flow learns no noise",
        NETWORK_RATE,
        "TrainingSchedule.further(updates, self.horizon, self.input_noise)",
        "TrainingSchedule.further(updates, self.horizon, 0.0)",
        (TEST_TRAINED_FURTHER,),
    ),
)
