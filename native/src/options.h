// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Options that may change while a tracker is used.

#pragma once

#include "startracker.h"

namespace st {

/// Whether two sets of options differ in none but those that docs/parameters.md marks as live;
/// fault (may be null) names one that is not.
bool only_live_differ(const st_config &now, const st_config &wanted, st_fault *fault);

}  // namespace st
