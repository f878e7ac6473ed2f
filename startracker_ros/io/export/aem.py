# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""CCSDS Attitude Ephemeris Message, version 2.0, in KVN (CCSDS 504.0-B-2, section 4)."""

from dataclasses import dataclass, fields

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.core.maths.rotation import sign_continuous
from startracker_ros.io.bags.reader import contents
from startracker_ros.io.recordings.recording import ATTITUDE_TOPICS, lock_segments, Recording

_LONGEST_LINE = 254


class AemError(ValueError):
    """What cannot be written as an AEM; the text says why."""


@dataclass(frozen=True)
class AemLabels:
    """What only the user knows: who made the message, and of which object."""

    originator: str = 'UNKNOWN'
    object_name: str = 'UNKNOWN'
    object_id: str = 'UNKNOWN'

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (value.isascii() and value.isprintable() and value.strip() == value and value
                    and len(value) <= _LONGEST_LINE - 30):
                raise AemError(f'{field.name} {value!r} must be printable ASCII on one line, '
                               'not empty, without spaces around it')


def aem_text(recording: Recording, labels: AemLabels, creation_ns: int) -> str:
    """
    Return the message; AemError without an attitude. creation_ns is UNIX time.

    Q1 Q2 Q3 QC is q_icrf_from_sensor in x, y, z, w as it is: the standard's quaternion from
    frame A, ICRF, to frame B, INSTRUMENT, takes the components of vectors from A to B by the
    transpose of R(q). Within a segment the quaternion does not jump to its negative.
    """
    if not len(recording.attitude_ns):
        raise AemError('the bag holds no attitude: '
                       f'{recording.why_nothing(*ATTITUDE_TOPICS)}; '
                       f'{contents(recording.topics)}')
    lines = ['CCSDS_AEM_VERS = 2.0', f'CREATION_DATE = {utc(creation_ns)}',
             f'ORIGINATOR = {labels.originator}']
    segment = lock_segments(recording)
    for number in range(segment[-1] + 1):
        chosen = segment == number
        lines += _segment(recording.attitude_ns[chosen], recording.quaternion[chosen], labels,
                          first=number == 0)
    return '\n'.join(lines) + '\n'


def _segment(stamp_ns: np.ndarray, quaternion: np.ndarray, labels: AemLabels, *, first: bool
             ) -> list[str]:
    begin = 'star tracker' if first else 'star tracker, after a loss of lock'
    lines = [
        '', 'META_START',
        f'COMMENT {begin}: attitude of the optical frame, x right, y down, z boresight',
        f'OBJECT_NAME = {labels.object_name}', f'OBJECT_ID = {labels.object_id}',
        'REF_FRAME_A = ICRF', 'REF_FRAME_B = INSTRUMENT', 'TIME_SYSTEM = UTC',
        f'START_TIME = {utc(stamp_ns[0], digits=9)}', f'STOP_TIME = {utc(stamp_ns[-1], digits=9)}',
        'ATTITUDE_TYPE = QUATERNION', 'META_STOP', '', 'DATA_START']
    previous = None
    for stamp, q in zip(stamp_ns, quaternion):
        previous = sign_continuous(q, previous)
        # Twelve digits are 0.2 microarcseconds; zero has no sign.
        lines.append(' '.join((utc(stamp, digits=9),
                               *(f'{value + 0.0:.12f}' for value in previous))))
    return [*lines, 'DATA_STOP']
