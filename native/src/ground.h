// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What calls of startracker_ground.h share: arrays of the caller.

#pragma once

#include <algorithm>
#include <cstdint>

#include "maths/matrix.h"

namespace st {

/// Stars of a quad.
constexpr size_t QUAD = 4;

static_assert(sizeof(Vector3) == 3 * sizeof(double), "directions are given as (count, 3)");

/// Return directions (count, 3) of a caller, in place.
inline const Vector3 *vectors(const double *array) {
    return reinterpret_cast<const Vector3 *>(array);
}

/// Whether numbers are of count things.
template <class Count>
bool are_numbers(const int32_t *numbers, size_t given, Count count) {
    return std::all_of(numbers, numbers + given, [count](int32_t number) {
        return number >= 0 && static_cast<Count>(number) < count;
    });
}

}  // namespace st
