"""Vicon and VRPN, read with the package motioncapture.

The package gives no time stamps, neither of the frame nor of its arrival: frames are stamped when
they come, and ``latency`` s, if it is known, are taken off.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from hardware.arguments import number, text
from hardware.measurement import Measurement
from hardware.trackers.axes import Axes
from hardware.trackers.process import ProcessTracker
from sysid_evo.arrays import Array
from sysid_evo.errors import LinkLost
from sysid_evo.registry import register_tracker


@dataclass(frozen=True)
class MotionCaptureTracker(ProcessTracker):
    """The rigid body ``body`` of the system ``kind`` at ``host``.

    ``up`` is the axis that points up, ``scale`` the unit of length in m; ``heading_offset`` rad are added
    to the heading; ``latency`` s are taken off the times of arrival. Raises `InvalidArgument`.

    A system that ``polls`` answers with the last pose when there is no new one: a pose that is the
    same to the last bit is then no frame.
    """

    body: str
    host: str = "localhost"
    up: Literal["y", "z"] = "z"
    scale: float = 1.0
    heading_offset: float = 0.0
    latency: float = 0.0
    requires: ClassVar[tuple[str, ...]] = ("motioncapture",)
    kind: ClassVar[str]
    polls: ClassVar[bool] = False

    def __post_init__(self) -> None:
        text(f"tracker {self.kind}: body", self.body)
        text(f"tracker {self.kind}: host", self.host)
        number(f"tracker {self.kind}: latency", self.latency, least=0.0)
        self._axes()

    @property
    def settings(self) -> dict[str, str]:
        """What the package is told of the system."""
        return {"hostname": self.host}

    def frames(self) -> Iterator[Measurement | None]:
        import motioncapture

        axes = self._axes()
        try:
            system = motioncapture.connect(self.kind, self.settings)
        except RuntimeError as error:
            raise LinkLost(f"no {self.kind} system answers at {self.host}: {error}") from error
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
            if self.polls and self._same(pose, last):
                yield None
                continue
            last = pose.tobytes()
            number += 1
            valid = bool(np.isfinite(pose).all())
            yield Measurement(arrival - self.latency, arrival, number, self.body, valid, pose)

    def _axes(self) -> Axes:
        return Axes(self.up, self.scale, self.heading_offset)

    @staticmethod
    def _same(pose: Array, last: bytes) -> bool:
        return pose.tobytes() == last or bool(np.isnan(pose).any())


@register_tracker("vicon")
@dataclass(frozen=True)
class ViconTracker(MotionCaptureTracker):
    """A body of a Vicon system, from its data stream at ``host`` (``name`` or ``name:port``)."""

    name = "vicon"
    kind: ClassVar[str] = "vicon"


@register_tracker("vrpn")
@dataclass(frozen=True)
class VrpnTracker(MotionCaptureTracker):
    """A body of a VRPN server at ``host`` (``name`` or ``name:port``), which is asked 200 times a second."""

    name = "vrpn"
    kind: ClassVar[str] = "vrpn"
    polls: ClassVar[bool] = True
