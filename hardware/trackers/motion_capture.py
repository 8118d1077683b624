"""Optical motion capture: Vicon and VRPN by the package motioncapture, OptiTrack by the package natnet."""

from __future__ import annotations

import math
import queue
import socket
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from hardware.arguments import check_flag, check_integer, check_number, check_text
from hardware.connection import Measurement
from hardware.trackers.process import ProcessTracker
from hardware.trackers.tracker import Axes, SourceClock
from hardware.trackers.udp import LARGEST
from sysid_evo.errors import LinkLost
from sysid_evo.registry import register_tracker

if TYPE_CHECKING:
    from natnet import NatNetClient


@dataclass(frozen=True)
class MotionCaptureTracker(ProcessTracker):
    """The rigid body ``body`` of the system at ``host``.

    ``up`` is the vertical axis, ``scale`` the unit of length in m; ``heading_offset`` rad are added to the heading. The
    package gives no time stamps, neither of the frame nor of its arrival: frames are stamped when they arrive, and
    ``latency`` s, if it is known, are subtracted. Raises `InvalidArgument`.

    A system that ``polls`` answers with the last pose if there is no new one: an identical pose is then no new frame.
    """

    body: str
    host: str = "localhost"
    up: Literal["y", "z"] = "z"
    scale: float = 1.0
    heading_offset: float = 0.0
    latency: float = 0.0
    requires: ClassVar[tuple[str, ...]] = ("motioncapture",)
    polls: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_text(f"tracker {self.name}: body", self.body)
        check_text(f"tracker {self.name}: host", self.host)
        check_number(f"tracker {self.name}: latency", self.latency, minimum=0.0)
        self._axes()

    @property
    def settings(self) -> dict[str, str]:
        """Settings of the system for the package."""
        return {"hostname": self.host}

    def frames(self) -> Iterator[Measurement | None]:
        import motioncapture

        axes = self._axes()
        try:
            system = motioncapture.connect(self.name, self.settings)
        except RuntimeError as error:
            raise LinkLost(f"no {self.name} system answers at {self.host}: {error}") from error
        yield None
        number, last = 0, b""
        while True:
            system.waitForNextFrame()
            arrival = time.monotonic()
            body = system.rigidBodies.get(self.body)
            pose = np.full(3, math.nan)
            if body is not None:
                turned = body.rotation
                pose = axes.planar(body.position, (turned.x, turned.y, turned.z, turned.w))
            if self.polls and (pose.tobytes() == last or np.isnan(pose).any()):
                yield None
                continue
            last = pose.tobytes()
            number += 1
            valid = bool(np.isfinite(pose).all())
            yield Measurement(arrival - self.latency, arrival, number, self.body, valid, pose)

    def _axes(self) -> Axes:
        return Axes(self.up, self.scale, self.heading_offset)


@register_tracker("vicon")
@dataclass(frozen=True)
class ViconTracker(MotionCaptureTracker):
    """A body of a Vicon system, from its data stream at ``host`` (``name`` or ``name:port``)."""

    name = "vicon"


@register_tracker("vrpn")
@dataclass(frozen=True)
class VrpnTracker(MotionCaptureTracker):
    """A body of a VRPN server at ``host`` (``name`` or ``name:port``), which is polled 200 times a second."""

    name = "vrpn"
    polls: ClassVar[bool] = True


ANSWER = 3.0  # s within which the server and its list of bodies must answer
SILENCE = 0.1  # s without a frame after which it yields None


@register_tracker("natnet")
@dataclass(frozen=True)
class NatNetTracker(ProcessTracker):
    """The rigid body ``body`` as streamed by the server at ``server`` to this host's address ``local``.

    ``multicast`` is true if Motive streams to ``multicast_address``; the ports are ``command_port`` and ``data_port``.
    Motive's default is y ``up``; ``scale`` is its unit of length in m, ``heading_offset`` rad are added to the heading.
    Times are the frames' own, mapped by `SourceClock`; they are late by the shortest transport from the exposure to
    this host, and ``latency`` s are subtracted for that. Raises `InvalidArgument`.
    """

    body: str
    server: str = "127.0.0.1"
    local: str = "127.0.0.1"
    multicast: bool = False
    multicast_address: str = "239.255.42.99"
    command_port: int = 1510
    data_port: int = 1511
    up: Literal["y", "z"] = "y"
    scale: float = 1.0
    heading_offset: float = 0.0
    latency: float = 0.0
    name = "natnet"
    requires: ClassVar[tuple[str, ...]] = ("natnet",)

    def __post_init__(self) -> None:
        for name in ("body", "server", "local", "multicast_address"):
            check_text(f"tracker natnet: {name}", getattr(self, name))
        for name in ("command_port", "data_port"):
            check_integer(f"tracker natnet: {name}", getattr(self, name), minimum=1, maximum=65535)
        check_flag("tracker natnet: multicast", self.multicast)
        check_number("tracker natnet: latency", self.latency, minimum=0.0)
        self._axes()

    def frames(self) -> Iterator[Measurement | None]:
        from natnet import NatNetError

        try:
            client_of, ignored = listening_to(socket.gethostbyname_ex(self.server)[2])
        except OSError as error:
            raise LinkLost(f"tracker natnet: no host is called {self.server!r} ({error})") from error
        client = client_of(
            server_ip_address=self.server,
            local_ip_address=self.local,
            multicast_address=self.multicast_address,
            command_port=self.command_port,
            data_port=self.data_port,
            use_multicast=self.multicast,
        )
        came: queue.SimpleQueue[tuple[float, Any]] = queue.SimpleQueue()
        bodies: dict[str, int] = {}
        described = threading.Event()

        def describe(descriptions: Any) -> None:
            bodies.clear()
            bodies.update({one.name: one.id_num for one in descriptions.rigid_bodies})
            described.set()

        client.on_data_frame_received_event.handlers.append(lambda frame: came.put((time.monotonic(), frame)))
        client.on_data_description_received_event.handlers.append(describe)
        try:
            client.connect(timeout=ANSWER)
        except (TimeoutError, NatNetError, OSError) as error:
            others = f" Packets came from {', '.join(sorted(ignored))}, which is not the server." if ignored else ""
            raise LinkLost(
                f"no NatNet server answers at {self.server}:{self.command_port} ({type(error).__name__}): is Motive "
                f"streaming to {self.local}, and is it set to {'multicast' if self.multicast else 'unicast'}?{others}"
            ) from error
        client.run_async()
        client.request_modeldef()
        if not described.wait(ANSWER):
            raise LinkLost(f"the NatNet server at {self.server} does not list its rigid bodies")
        if self.body not in bodies:
            raise LinkLost(f"no rigid body is called {self.body!r}; the server has: {', '.join(bodies) or 'none'}")
        yield None
        clock, axes = SourceClock(), self._axes()
        while True:
            try:
                arrival, frame = came.get(timeout=SILENCE)
            except queue.Empty:
                yield None
                continue
            if frame.suffix.tracked_models_changed:
                client.request_modeldef()
            if not abs(frame.suffix.timestamp) < LARGEST:  # or nan: no time at all
                continue
            yield self._measurement(frame, arrival, bodies.get(self.body), clock, axes)

    def _axes(self) -> Axes:
        return Axes(self.up, self.scale, self.heading_offset)

    def _measurement(
        self, frame: Any, arrival: float, number: int | None, clock: SourceClock, axes: Axes
    ) -> Measurement:
        """Return the pose of the rigid body with this number in ``frame``; not valid if it is not in it."""
        source = clock.map(frame.suffix.timestamp, arrival) - self.latency
        seen = next(
            (one for one in frame.rigid_bodies if one.id_num == number and one.tracking_valid is not False), None
        )
        pose = np.full(3, math.nan) if seen is None else axes.planar(seen.pos, seen.rot)
        valid = bool(np.isfinite(pose).all())
        return Measurement(source, arrival, frame.prefix.frame_number, self.body, valid, pose)


MOST_IGNORED = 5
"""Number of senders that are kept for an error message."""


def listening_to(addresses: Collection[str]) -> tuple[type[NatNetClient], set[str]]:
    """Return natnet's client that accepts these addresses alone, and the set in which it stores others.

    The package accepts packets from any sender, and one that it cannot read ends the reading thread.
    """
    from natnet import NatNetClient
    from natnet.packet_buffer import PacketBuffer

    ignored: set[str] = set()

    class OnlyOneServer(NatNetClient):  # type: ignore[misc]  # the package has no types
        """Overrides the private method of the package (0.3) through which every packet comes."""

        def _NatNetClient__process_socket(  # noqa: N802
            self, in_socket: socket.socket, recv_buffer_size: int = 2**16, send_keep_alive: bool = False
        ) -> bool:
            try:
                if send_keep_alive:
                    self.send_request(self.NAT_KEEPALIVE)
                data, (sender, _) = in_socket.recvfrom(recv_buffer_size)
            except OSError:  # nothing received, or the network is temporarily unavailable
                return False
            if sender in addresses:
                with suppress(Exception):  # a damaged packet may cause any error
                    self._NatNetClient__process_message(PacketBuffer(data))
            elif len(ignored) < MOST_IGNORED:
                ignored.add(sender)
            return True

    return OnlyOneServer, ignored
