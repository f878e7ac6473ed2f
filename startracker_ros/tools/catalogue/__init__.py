# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A catalogue for narrow fields, made of files of the user."""
