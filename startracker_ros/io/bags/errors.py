# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of bags."""


class BagError(OSError):
    """A bag cannot be written or read; the text names the file and the reason."""


class UnfinishedBagError(BagError):
    """A bag that was never closed: the process was killed or the disk was full."""
