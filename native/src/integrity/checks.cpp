// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/checks.h"

namespace {

using namespace st::checks;

constexpr st_check ALL[] = {
    LATE_FRAME,
    TIME_JUMP,
    REPEATED_FRAME,
    UNUSABLE_CENTROID,
    MISFIT,
    SECOND_TOO_LATE,
    START_RATE,
    HINT,
    HINT_DIFFERS,
    HINT_FAILED,
    IDENTIFICATION_DIFFERS,
    STAR_OUTLIER,
    LIKELY_INNOVATION,
    INNOVATION,
    FEW_AGREE,
    BAD_FRAMES,
    STARS_ELSEWHERE,
    NO_STARS,
    DIVERGED,
    FILTER_COVARIANCE,
    SHEARED_STARS,
    FAST_TURN,
    GYRO_SILENT,
    GYRO_AT_RANGE,
    GYRO_DIFFERS,
    GYRO_BLIND,
    MOTION_ENDS,
    JUMP_IN_FRAME,
    DISPLACED,
    STAMP_ERRORS,
    LENS_ERROR,
    ERROR_SCALE,
    TORN_FRAME,
    LINE_TIME,
    FIRST_LINE_TIME,
    SECOND_IMAGE,
    MISSING_STARS,
    FEW_STARS,
    STAR_RESIDUALS,
    TRACK_RESIDUALS,
    LARGE_CHI2,
    COVARIANCE,
    PROTECTION,
    HEAD_DIFFERS,
    HEAD_RETURNS,
};

}  // namespace

const st_check *st_checks(size_t *count) {
    if (count != nullptr) {
        *count = sizeof(ALL) / sizeof(ALL[0]);
    }
    return ALL;
}
