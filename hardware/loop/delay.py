"""How late an estimate is: the shift at which it agrees best with the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hardware.loop.estimator import PoseEstimator
from hardware.measurement import Measurement
from sysid_evo.arrays import Array, check_shape
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

LONGEST = 0.2  # s: the latest estimate looked for
STEP = 0.001  # s
FREQUENCIES = (0.3, 0.7, 1.1)  # Hz: how fast the speeds of a known drive change


@dataclass(frozen=True)
class EstimateDelay:
    """How late the estimate of ``channel`` is, in s, and what is left of its error.

    ``correlation`` with the truth so long ago; ``error`` is the root mean square difference from it,
    ``error_now`` that from the truth at the time of the estimate, both in ``unit``.
    """

    channel: str
    unit: str
    seconds: float
    correlation: float
    error: float
    error_now: float


def measure_delays(
    system: System, times: Array, truth: Array, estimate_times: Array, estimates: Array
) -> tuple[EstimateDelay, ...]:
    """Return the delay of every state: ``estimates`` (N, nx) against ``truth`` (T, nx), linear between ``times``.

    The delay is where the parabola through the highest correlation and its neighbours has its top,
    looked for from 0 to 0.2 s. Estimates from the first 0.2 s of the recording are left out.
    """
    truth = check_shape("truth", truth, (len(times), system.nx))
    estimates = check_shape("estimates", estimates, (len(estimate_times), system.nx))
    late = estimate_times >= times[0] + LONGEST + STEP
    shifts = STEP * np.arange(-1, round(LONGEST / STEP) + 2)
    found = []
    for i, channel in enumerate(system.states):
        estimated = estimates[late, i]

        def true(shift: float, column: Array = truth[:, i]) -> Array:
            return np.interp(estimate_times[late] - shift, times, column)

        curve = np.array([_correlation(true(shift), estimated) for shift in shifts])
        peak = int(np.clip(curve.argmax(), 1, len(curve) - 2))
        before, at, after = curve[peak - 1 : peak + 2]
        bend = before - 2.0 * at + after
        delay = shifts[peak] + (STEP * 0.5 * (before - after) / bend if bend < 0.0 else 0.0)
        found.append(
            EstimateDelay(
                channel.name,
                channel.unit,
                float(delay),
                float(at),
                _rms(estimated - true(delay)),
                _rms(estimated - true(0.0)),
            )
        )
    return tuple(found)


def known_drive(system: System, times: Array, *, speed: float = 1.0, yaw_rate: float = 2.0) -> tuple[Array, Array]:
    """Return states (T, nx) and poses (T, 3) of a made-up drive whose speeds swing smoothly around zero."""
    motion = system.motion
    assert isinstance(motion, PlanarBody)
    forward, lateral, turning = motion.indices(system.state_names)
    waves = np.sin(2.0 * np.pi * np.outer(times, FREQUENCIES) + np.arange(len(FREQUENCIES)))
    states = np.zeros((len(times), system.nx))
    states[:, forward] = speed * (waves[:, 0] + waves[:, 1]) / 2.0
    states[:, turning] = yaw_rate * (waves[:, 1] + waves[:, 2]) / 2.0
    if lateral is not None:
        states[:, lateral] = 0.1 * speed * waves[:, 2]
    poses = np.zeros((len(times), motion.n_pose))
    for k in range(1, len(times)):
        dt = float(times[k] - times[k - 1])
        poses[k] = system.move(poses[k - 1], states[k - 1], states[k], dt)
    return states, poses


def estimator_delays(system: System, *, frame_interval: float, duration: float = 20.0) -> tuple[EstimateDelay, ...]:
    """Return the delays of `PoseEstimator` alone, on a known drive seen every ``frame_interval`` s without noise."""
    times: Array = np.arange(0.0, duration, frame_interval)
    states, poses = known_drive(system, times)
    estimator = PoseEstimator(system)
    known: list[tuple[float, Array]] = []
    for frame, (time, pose) in enumerate(zip(times, poses, strict=True)):
        estimator.add(Measurement(time, time, frame, "", True, pose))
        estimate = estimator.estimate(time)
        if estimate is not None:
            known.append((time, estimate.state))
    return measure_delays(system, times, states, np.array([t for t, _ in known]), np.array([s for _, s in known]))


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / scale) if scale > 0.0 else 0.0


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(difference**2)))
