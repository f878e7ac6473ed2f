// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Values of the core in the plain structs of startracker.h, and back.

#pragma once

#include "maths/rotation.h"
#include "startracker.h"

namespace st {

inline Vector3 vector_of(const double (&values)[3]) {
    return {{values[0], values[1], values[2]}};
}

inline Matrix3 matrix_of(const double (&values)[3][3]) {
    Matrix3 made;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            made[i][j] = values[i][j];
        }
    }
    return made;
}

inline Quaternion quaternion_of(const double (&q)[4]) {
    return {q[0], q[1], q[2], q[3]};
}

inline void set(const Quaternion &q, double (&values)[4]) {
    values[0] = q.x;
    values[1] = q.y;
    values[2] = q.z;
    values[3] = q.w;
}

inline void set(const Vector3 &v, double (&values)[3]) {
    for (int i = 0; i < 3; ++i) {
        values[i] = v[i];
    }
}

inline void set(const Matrix3 &P, double (&values)[3][3]) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            values[i][j] = P[i][j];
        }
    }
}

/// Set all numbers of an attitude that is not known.
void set_unknown(st_attitude &attitude);

}  // namespace st
