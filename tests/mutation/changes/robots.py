"""The host's side of the link, and what is believed of a tracker."""

from tests.mutation.change import Change

SESSION = "hardware/link/session.py"
GATES = "hardware/gate.py"
TEST_FRAMING = ("tests/hardware/link/test_framing.py",)
TEST_SESSION = ("tests/hardware/link/test_session.py",)
TEST_GATES = ("tests/hardware/trackers/test_gates.py",)

CHANGES = (
    Change(
        "a damaged frame is believed",
        "hardware/link/framing.py",
        'if checksum(body) != int.from_bytes(check, "little"):',
        "if not check:",
        TEST_FRAMING,
    ),
    Change(
        "the checksum is that of another protocol",
        "hardware/link/framing.py",
        "crc_hqx(data, 0xFFFF)",
        "crc_hqx(data, 0x0000)",
        TEST_FRAMING,
    ),
    Change(
        "buttons are believed without their complement",
        "hardware/link/messages.py",
        'if values["buttons"] != _guarded(buttons) or any(',
        "if any(",
        ("tests/hardware/link/test_messages.py",),
    ),
    Change(
        "sequence numbers run over half-way",
        SESSION,
        "(self._sequence + 1) % 65536",
        "(self._sequence + 1) % 32768",
        TEST_SESSION,
    ),
    Change(
        "a command lives longer than the robot allows",
        SESSION,
        "min(valid_for / TIME_TO_LIVE_UNIT + 1e-9, self.acknowledgement.max_time_to_live)",
        "valid_for / TIME_TO_LIVE_UNIT + 1e-9",
        TEST_SESSION,
    ),
    Change("a silent robot is driven on", SESSION, "SILENCE = 0.25", "SILENCE = 0.5", TEST_SESSION),
    Change(
        "the first command finds the buttons as they are",
        SESSION,
        "if buttons and (self.status is None or self.status.state != State.DRIVING):",
        "if buttons and (self.status is not None and self.status.state != State.DRIVING):",
        TEST_SESSION,
    ),
    Change(
        "the answer to another host opens a session",
        SESSION,
        "if message.nonce == self.nonce and self.acknowledgement is None:",
        "if self.acknowledgement is None:",
        TEST_SESSION,
    ),
    Change(
        "a body that is too fast is believed",
        GATES,
        "limits.speed * dt + limits.position_error",
        "2.0 * limits.speed * dt + limits.position_error",
        TEST_GATES,
    ),
    Change(
        "a frozen pose is believed",
        GATES,
        "return limit is not None and self._repeats >= limit",
        "return False",
        TEST_GATES,
    ),
    Change(
        "a jump is believed after one frame",
        GATES,
        "return len(rival) >= self.limits.confirm",
        "return True",
        TEST_GATES,
    ),
    Change(
        "the last reason to stop counts, not the first",
        "hardware/run_report.py",
        "if self.reason is None:",
        "if True:",
        ("tests/hardware/loop/test_stops.py::test_request_of_another_thread_ends_the_run_and_the_first_one_counts",),
    ),
    Change(
        "a command in force outlives its validity",
        "hardware/emulation/simulated_robot.py",
        "self.control, self._expires = control, self.time + valid_for",
        "self.control, self._expires = control, self.time + 10.0 * valid_for",
        ("tests/hardware/emulation/test_emulated_robot.py",),
    ),
)
