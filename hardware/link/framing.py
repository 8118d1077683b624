"""Frames of RCB/1: COBS(type, payload, CRC-16/CCITT-FALSE), then a zero byte."""

from __future__ import annotations

from binascii import crc_hqx

DECODED_MAX = 32
ENCODED_MAX = DECODED_MAX + 1
CRC_SIZE = 2
DELIMITER = 0


def checksum(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of ``data``."""
    return crc_hqx(data, 0xFFFF)


def encode(body: bytes) -> bytes:
    """Return the frame of ``body``, a type and its payload of together at most 30 bytes."""
    from cobs import cobs

    return cobs.encode(body + checksum(body).to_bytes(CRC_SIZE, "little")) + bytes([DELIMITER])


class FrameDecoder:
    """Splits a stream of bytes into frames and drops the damaged ones.

    It accepts any bytes without an error and keeps at most one frame of them. ``crc_errors`` counts frames of a legal
    length with a wrong checksum, ``length_errors`` those that are too long, too short or not COBS; after either,
    decoding restarts at the next delimiter.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.crc_errors = 0
        self.length_errors = 0
        self._partial = bytearray()
        self._overlong = False

    def feed(self, data: bytes) -> list[bytes]:
        """Return the bodies (type and payload) of the frames that ``data`` completes, in order."""
        *ends, rest = data.split(bytes([DELIMITER]))
        bodies = []
        for piece in ends:
            self._keep(piece)
            body = self._finish()
            if body is not None:
                bodies.append(body)
        self._keep(rest)
        return bodies

    def _keep(self, piece: bytes) -> None:
        self._overlong = self._overlong or len(self._partial) + len(piece) > ENCODED_MAX
        self._partial += piece[: ENCODED_MAX - len(self._partial)]

    def _finish(self) -> bytes | None:
        from cobs import cobs

        encoded, overlong = bytes(self._partial), self._overlong
        self._partial.clear()
        self._overlong = False
        if not encoded:
            return None
        try:
            decoded = b"" if overlong else cobs.decode(encoded)
        except cobs.DecodeError:
            decoded = b""
        body, check = decoded[:-CRC_SIZE], decoded[-CRC_SIZE:]
        if not body:
            self.length_errors += 1
            return None
        if checksum(body) != int.from_bytes(check, "little"):
            self.crc_errors += 1
            return None
        self.frames += 1
        return body
