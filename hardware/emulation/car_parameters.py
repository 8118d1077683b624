"""The emulated toy car in numbers: what each parameter is, its unit, why it is there."""

from __future__ import annotations

from dataclasses import dataclass

from hardware.emulation.quantities import Quantities, quantity
from sysid_evo.errors import InvalidArgument

FINE_DT = 0.005  # s: the rate of the tracker, and short against every lag of the car


@dataclass(frozen=True, kw_only=True)
class CarParameters(Quantities):
    """A bang-bang toy car of 0.3 kg, 18 x 10 cm (paper, section 3).

    Unit, reason and spread of each field stand in its metadata. Thrust, drag and resistance are per
    unit of mass, so they read as accelerations. Raises `InvalidArgument`.
    """

    mass: float = quantity(0.3, "kg", 0.1, "stated in the paper")
    yaw_inertia: float = quantity(0.00106, "kg m2", 0.1, "a uniform plate of 18 x 10 cm")
    front_axle: float = quantity(0.055, "m", 0.1, "centre of mass to the steered axle")
    rear_axle: float = quantity(0.055, "m", 0.1, "centre of mass to the driven axle")

    thrust_forward: float = quantity(3.2, "m/s2", 0.2, "at rest, full battery; reaches 2.0 m/s")
    thrust_backward: float = quantity(2.45, "m/s2", 0.2, "brushes and gears run worse backward; reaches 1.4 m/s")
    back_emf: float = quantity(1.08, "1/s", 0.2, "loss of thrust with speed while the motor is powered")
    motor_lag: float = quantity(0.08, "s", 0.3, "current and gears take time to follow the switch")
    battery_spread: float = quantity(0.08, "1", 0.1, "charge differs from trial to trial by this share at most")
    sag: float = quantity(0.08, "1", 0.3, "share of the voltage lost under full load")
    sag_lag: float = quantity(0.4, "s", 0.3, "the cells' own time constant")
    slack_time: float = quantity(0.03, "s", 0.3, "full motor speed across the play of the worn gearbox")

    coasting_drag: float = quantity(0.6, "1/s", 0.3, "the unpowered motor turned by the wheels")
    rolling_drag: float = quantity(0.15, "1/s", 0.3, "bearings and paper, growing with speed")
    rolling_resistance: float = quantity(0.5, "m/s2", 0.2, "bearings and paper, at any speed; stops a coasting car")
    static_friction: float = quantity(0.9, "m/s2", 0.15, "thrust below this does not move a standing car")

    steer_left: float = quantity(0.203, "rad", 0.1, "front wheels at full left lock")
    steer_right: float = quantity(0.177, "rad", 0.1, "front wheels at full right lock; the linkage is uneven")
    steer_offset: float = quantity(0.008, "rad", 0.3, "front wheels without a command; the linkage is bent")
    linkage_play: float = quantity(0.0125, "rad", 0.3, "front wheels flop right rolling forward, left backward")
    steering_lag: float = quantity(0.06, "s", 0.3, "the steering magnet works against a spring")

    front_grip: float = quantity(1.14, "N", 0.15, "largest sideways force of the front tyres")
    rear_grip: float = quantity(1.58, "N", 0.15, "largest sideways force of the rear tyres, without thrust")
    thrust_grip_loss: float = quantity(0.5, "1", 0.2, "most of the rear grip, as a share, that traction uses up")
    slip_gain: float = quantity(8.0, "1/rad", 0.1, "how soon a slip angle saturates a tyre")
    slip_floor: float = quantity(0.7, "m/s", 0.1, "slower than this, slip is measured against this speed")

    force_noise: float = quantity(0.25, "m/s2", 0.3, "uneven floor; standard deviation at speed")
    yaw_noise: float = quantity(2.0, "rad/s2", 0.3, "uneven floor; standard deviation at speed")
    noise_lag: float = quantity(0.1, "s", 0.3, "correlation time: a dozen centimetres of floor")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("battery_spread", "sag", "thrust_grip_loss"):
            if getattr(self, name) >= 1.0:
                raise InvalidArgument(f"car: {name} is a share below 1, got {getattr(self, name)}")
        if self.static_friction < self.rolling_resistance:
            raise InvalidArgument(
                "car: expected static_friction >= rolling_resistance, "
                f"got {self.static_friction} and {self.rolling_resistance} m/s2"
            )
        if self.stiffness * FINE_DT > 1.0:
            raise InvalidArgument(
                f"car: tyres as stiff as {self.stiffness:.0f} 1/s overshoot in steps of {FINE_DT} s; "
                f"raise slip_floor ({self.slip_floor} m/s) by {self.stiffness * FINE_DT:.2f} or lower slip_gain or grip"
            )

    @property
    def stiffness(self) -> float:
        """Fastest rate in 1/s at which tyres damp sideways motion of an axle."""
        front = self.front_grip * (1.0 / self.mass + self.front_axle**2 / self.yaw_inertia)
        rear = self.rear_grip * (1.0 / self.mass + self.rear_axle**2 / self.yaw_inertia)
        return max(front, rear) * self.slip_gain / self.slip_floor
