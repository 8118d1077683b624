"""Models of another condition: what the gate believes, more training, the spread."""

from tests.mutation.change import Change

GATE = "sysid_evo/adaptation/gate.py"
ADAPTING = "sysid_evo/adaptation/adapting.py"
ELSEWHERE = "model_zoo/validation/elsewhere.py"
ADAPTED = "model_zoo/adapted.py"
MEAN = "model_zoo/selection/mean.py"
MLP_ENSEMBLE = "model_zoo/mlp_ensemble.py"
NETWORK_RATE = "model_zoo/flows/network_rate.py"
TEST_WHAT_THE_GATE_SAYS = "tests/sysid_evo/adaptation/test_what_the_gate_says.py"
TEST_GATE = "tests/sysid_evo/adaptation/test_gate.py"
TEST_CALIBRATED_ELSEWHERE = "tests/model_zoo/test_calibrated_elsewhere.py"
TEST_TRAINED_FURTHER = "tests/model_zoo/test_trained_further.py"

CHANGES = (
    Change(
        "better in one block is enough",
        GATE,
        "return max(self.each) <= 1.0 - IN_EACH",
        "return min(self.each) <= 1.0 - IN_EACH",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a tenth is enough",
        GATE,
        "BETTER = 0.15",
        "BETTER = 0.14",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "three percent in each block are enough",
        GATE,
        "IN_EACH = 0.05",
        "IN_EACH = 0.045",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a correction is sure at 97 % of Student's t",
        GATE,
        "CONFIDENCE = 0.975",
        "CONFIDENCE = 0.97",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "two seconds are sure",
        GATE,
        "if len(gains) < 3:",
        "if len(gains) < 2:",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the error of a mean is that of n",
        GATE,
        "gains.std(ddof=1)",
        "gains.std()",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "chance and blocks are exchanged in what is said",
        GATE,
        '"which may be chance" if best.everywhere',
        '"which may be chance" if not best.everywhere',
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "worse is better in what is said",
        GATE,
        "'better' if change > 0 else 'worse'",
        "'better' if change < 0 else 'worse'",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the best is said, not what was taken",
        GATE,
        "if taken is None else taken",
        "if taken is None else min(self.trials, key=lambda trial: trial.error)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a window that reaches over the edge is held back",
        GATE,
        "(first >= self.low) & (first + self.horizon <= self.high)",
        "(first >= self.low) & (first <= self.high)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a window that reaches into the block is learned from",
        GATE,
        "(first + self.horizon <= self.low) | (first >= self.high)",
        "(first <= self.low) | (first >= self.high)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the second episode counts from the first",
        GATE,
        "begin += len(episode)",
        "begin += 0",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the part before a block is left out",
        GATE,
        "((0, low), (high, len(episode))) if b > a",
        "((high, len(episode)),) if b > a",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "blocks begin where the first window does",
        GATE,
        "edges[0], edges[-1] = 0, int(first.max()) + horizon",
        "edges[0], edges[-1] = int(first.min()), int(first.max())",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "blocks without windows are blocks",
        GATE,
        "if all(block.held(first).any() and block.learned(first).any() for block in blocks) else []",
        "",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "seconds that one of both has count",
        GATE,
        "first.keys() & second.keys()",
        "first.keys()",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the last that is about as good is taken",
        GATE,
        "<= (1.0 + AS_GOOD) * least), None)",
        "<= (1.0 + 3 * AS_GOOD) * least), None)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "training further is never better",
        GATE,
        "for further in (False, True)]",
        "for further in (False,)]",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "rest counts as motion",
        ADAPTING,
        "int(rows[:-1].sum())",
        "len(rows[:-1])",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "new seconds count once",
        ADAPTING,
        "copies = max(1, round(training.n_steps / new.n_steps))",
        "copies = 1",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the old data are left out of a refit",
        ADAPTING,
        "training.with_episodes([*training, *again])",
        "training.with_episodes(again)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the base takes over the spread of another condition",
        ELSEWHERE,
        "CorrectedSteps(one.model.variant(), one.terms",
        "CorrectedSteps(one.model, one.terms",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "parts run together",
        ELSEWHERE,
        "numbers.append(begin + windows.start",
        "numbers.append(windows.start",
        (TEST_CALIBRATED_ELSEWHERE,),
    ),
    Change(
        "episodes run together",
        ELSEWHERE,
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
        "return np.concatenate([moved, after[:, nx:]], axis=1)",
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
        ELSEWHERE,
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
        "further training at the first rate",
        MLP_ENSEMBLE,
        "plan = Plan(0, updates, self.horizon, learning_rate=FURTHER_RATE,",
        "plan = Plan(0, updates, self.horizon,",
        (TEST_TRAINED_FURTHER,),
    ),
    Change(
        "further training of a flow at the first rate",
        NETWORK_RATE,
        "plan = Plan(0, updates, self.horizon, learning_rate=FURTHER_RATE,",
        "plan = Plan(0, updates, self.horizon,",
        (TEST_TRAINED_FURTHER,),
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
        "learning_rate=FURTHER_RATE, input_noise=self.input_noise)",
        "learning_rate=FURTHER_RATE)",
        (TEST_TRAINED_FURTHER,),
    ),
)
