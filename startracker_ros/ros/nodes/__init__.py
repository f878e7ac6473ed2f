# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One module per executable: declare, convert, call the core, publish."""

import gc

# Next to nothing of what a node imports is garbage: to look through it again and again would
# take a tenth of the start.
gc.set_threshold(100_000)
