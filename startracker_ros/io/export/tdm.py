# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""CCSDS Tracking Data Message, version 2.0, in KVN (CCSDS 503.0-B-2, sections 3 and 4)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.epoch import utc


class TrackletAngles(NamedTuple):
    """
    The directions (N,) of an object: ra_deg 0 to 360, dec_deg, and magnitude, NaN if unknown.

    covariance_arcsec2 (N, 2, 2) is on axes to the east and north.
    """

    name: str
    stamp_ns: np.ndarray
    ra_deg: np.ndarray
    dec_deg: np.ndarray
    covariance_arcsec2: np.ndarray
    magnitude: np.ndarray


def tdm_text(observer: str, originator: str, tracklets: Sequence[TrackletAngles],
             creation_ns: int) -> str:
    """
    Return the message, a segment for each tracklet; creation_ns is UNIX time.

    The angles are of type RADEC in ICRF; light comes from participant 2, the object, to 1. The
    standard has no keyword for a covariance: comments at the begin of the data hold it.
    """
    lines = ['CCSDS_TDM_VERS = 2.0',
             'COMMENT apparent directions: aberration and light time are not corrected',
             'COMMENT in the data: covariance east, east-north, north in arcsec**2',
             f'CREATION_DATE = {utc(creation_ns)}', f'ORIGINATOR = {originator}']
    for tracklet in tracklets:
        lines += _segment(observer, tracklet)
    return '\n'.join(lines) + '\n'


def _segment(observer: str, tracklet: TrackletAngles) -> list[str]:
    stamps = tracklet.stamp_ns
    lines = [
        '', 'META_START', f'TRACK_ID = {tracklet.name}', 'TIME_SYSTEM = UTC',
        f'START_TIME = {utc(int(stamps[0]), digits=9)}',
        f'STOP_TIME = {utc(int(stamps[-1]), digits=9)}',
        f'PARTICIPANT_1 = {observer}', 'PARTICIPANT_2 = UNKNOWN', 'MODE = SEQUENTIAL',
        'PATH = 2,1', 'ANGLE_TYPE = RADEC', 'REFERENCE_FRAME = ICRF', 'META_STOP',
        'DATA_START']
    times = [utc(stamp, digits=9) for stamp in stamps.tolist()]
    # Comments may stand at the begin of the data only.
    lines += [f'COMMENT {when} {C[0, 0]:.4g} {C[0, 1]:.4g} {C[1, 1]:.4g}'
              for when, C in zip(times, tracklet.covariance_arcsec2)]
    for when, ra, dec, magnitude in zip(times, tracklet.ra_deg, tracklet.dec_deg,
                                        tracklet.magnitude):
        # Eight digits are 0.04 milliarcseconds; 360 is 0, and zero has no sign.
        angle = f'{ra:.8f}'
        lines += [f'ANGLE_1 = {when} {"0.00000000" if angle == "360.00000000" else angle}',
                  f'ANGLE_2 = {when} {dec + 0.0:.8f}']
        if np.isfinite(magnitude):
            lines.append(f'MAG = {when} {magnitude:.2f}')
    return [*lines, 'DATA_STOP']
