// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Values of plain numbers, as the arrays of them that the interface takes and gives.

#pragma once

#include <cstring>

namespace st {

/// Return a value of plain numbers out of an array.
template <class T>
T from(const double *numbers) {
    T value;
    std::memcpy(&value, numbers, sizeof(T));
    return value;
}

/// Write a value of plain numbers into an array, where there is one.
template <class T>
void into(double *numbers, const T &value) {
    if (numbers != nullptr) {
        std::memcpy(numbers, &value, sizeof(T));
    }
}

}  // namespace st
