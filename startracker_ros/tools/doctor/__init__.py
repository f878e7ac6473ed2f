# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `startracker doctor` looks at; each module returns checks and changes nothing."""
