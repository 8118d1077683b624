"""The firmware's protocol core, the compiled C, as an object."""

from __future__ import annotations

import ctypes
from functools import cache

from tests.system.rig.build import build_core

TRANSMIT_SIZE = 256


class FirmwareCore:
    """A robot's side of the link without its pins and wires.

    ``firmware_build``, ``reset_cause`` and ``boot_count`` are what it says of itself. Times are a
    free-running count of ms, modulo 2**32. Raises `InvalidArgument` if the C cannot be compiled.
    """

    def __init__(self, *, firmware_build: int = 1, reset_cause: int = 1, boot_count: int = 1) -> None:
        self._library = _library()
        self._core = ctypes.create_string_buffer(self._library.rcb_size())
        self._out = ctypes.create_string_buffer(TRANSMIT_SIZE)
        self._library.rcb_init(self._core, firmware_build, reset_cause, boot_count)

    def receive(self, data: bytes, now_ms: int) -> None:
        """Take in the bytes that came at ``now_ms``."""
        receive, core = self._library.rcb_receive, self._core
        for byte in data:
            receive(core, byte, now_ms)

    def tick(self, now_ms: int) -> None:
        """Let time pass; a robot does this at least every 10 ms."""
        self._library.rcb_tick(self._core, now_ms)

    @property
    def buttons(self) -> int:
        """The buttons that are closed, as the bits of `hardware.link.messages.Buttons`."""
        return self._library.rcb_buttons(self._core)

    @property
    def accepted(self) -> int:
        """How many commands have been accepted since the start."""
        return self._library.rcb_accepted(self._core)

    def transmit(self) -> bytes:
        """Return the bytes for the host that have not been taken yet."""
        taken = self._library.rcb_transmit(self._core, self._out, TRANSMIT_SIZE)
        return self._out.raw[:taken]


@cache
def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(str(build_core()))
    core, bytes_out = ctypes.c_char_p, ctypes.c_char_p
    u8, u16, u32 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32
    signatures = {
        "rcb_init": ((core, u16, u8, u16), None),
        "rcb_receive": ((core, u8, u32), None),
        "rcb_tick": ((core, u32), None),
        "rcb_buttons": ((core,), u8),
        "rcb_accepted": ((core,), u32),
        "rcb_transmit": ((core, bytes_out, ctypes.c_size_t), ctypes.c_size_t),
        "rcb_size": ((), ctypes.c_size_t),
    }
    for name, (arguments, result) in signatures.items():
        function = getattr(library, name)
        function.argtypes, function.restype = arguments, result
    return library
