# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One module per executable: declare, convert, call the core, publish."""

import gc
import sys

from startracker_ros.core.extras import check_numba, MissingLibraryError
from startracker_ros.ros.executables import WRONG_USE

# Here, as the import of a node fails without it.
try:
    check_numba()
except MissingLibraryError as error:
    print(f'startracker_ros: {error}', file=sys.stderr)
    sys.exit(WRONG_USE)

# Next to nothing of what a node imports is garbage: to look through it again and again would
# take a tenth of the start.
gc.set_threshold(100_000)
