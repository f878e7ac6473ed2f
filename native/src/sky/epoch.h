// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The time of the star places.

#pragma once

#include "sky/apparent.h"

namespace st {

/// Return the position of the Earth about the Sun on ICRF axes, au, within 0.001 (Astronomical
/// Almanac, low precision formulas for the Sun): for parallaxes.
Vector3 earth_position_au(double year);

/// Return a Julian year as the epoch of a sky file of another one; NaN is that of the file.
Epoch epoch_after(double file_year, double year);

}  // namespace st
