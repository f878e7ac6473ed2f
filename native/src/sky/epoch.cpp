// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "sky/epoch.h"

#include <cmath>

namespace st {

Vector3 earth_position_au(double year) {
    constexpr double DEG = M_PI / 180;
    const double days = (year - 2000.0) * 365.25;
    const double g = DEG * (357.528 + 0.9856003 * days);
    // Less the precession since J2000, of which the longitudes of the formulas are.
    const double longitude = DEG * (280.460 + 0.9856474 * days + 1.915 * std::sin(g) +
                                    0.020 * std::sin(2 * g) - 0.0139697 * (year - 2000.0));
    const double distance_au = 1.00014 - 0.01671 * std::cos(g) - 0.00014 * std::cos(2 * g);
    const double obliquity = DEG * 23.43929;
    const double x = -distance_au * std::cos(longitude), y = -distance_au * std::sin(longitude);
    return {{x, y * std::cos(obliquity), y * std::sin(obliquity)}};
}

Epoch epoch_after(double file_year, double year) {
    if (std::isnan(year) || year == file_year) {
        return {};
    }
    const Vector3 then = earth_position_au(file_year), now = earth_position_au(year);
    return {year - file_year, {{now[0] - then[0], now[1] - then[1], now[2] - then[2]}}};
}

}  // namespace st
