# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a star tracker reports of one frame, whatever the packet."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np


class TrackerCode(IntEnum):
    """The state of the tracker as a number of telemetry."""

    LOST = 0
    ACQUIRING = 1
    TRACKING = 2
    UNKNOWN = 7


class TelemetryError(ValueError):
    """Bytes that are not a packet, or values that no packet can hold; the text says which."""


@dataclass(frozen=True)
class FrameReport:
    """
    One frame: stamp_ns is UNIX time in UTC, of the middle of the exposure.

    quaternion (4,) is q_icrf_from_sensor in the order x, y, z, w, None without a trusted
    attitude; sigma_rad (3,) its 1-sigma errors about sensor axes, protection_rad (3,) the bound of
    these, infinite where there is none, None where not known; rate_rad_s (3,) is on sensor axes,
    None where not known. residual_px, background_dn and temperature_c are NaN where not
    known.
    """

    stamp_ns: int
    quaternion: np.ndarray | None = None
    sigma_rad: np.ndarray | None = None
    rate_rad_s: np.ndarray | None = None
    state: TrackerCode = TrackerCode.UNKNOWN
    stars: int = 0
    residual_px: float = float('nan')
    background_dn: float = float('nan')
    temperature_c: float = float('nan')
    protection_rad: np.ndarray | None = None

    def __post_init__(self) -> None:
        q = self.quaternion
        if q is not None and not abs(float(np.linalg.norm(q)) - 1) < 1e-6:
            raise TelemetryError(f'quaternion {np.asarray(q).tolist()} is not a rotation')
