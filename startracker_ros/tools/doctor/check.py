# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One row of the examination."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """
    What was looked at, what was found, whether that will do, and what to mend.

    A check that holds may still carry advice in `mend`.
    """

    check: str
    result: str
    holds: bool = True
    mend: str = ''
