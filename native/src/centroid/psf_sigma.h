// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// PSF sigma of the stars of a frame.

#pragma once

#include "centroid/frame.h"
#include "maths/arena.h"

namespace st {

/// is_certain is whether a Gaussian explains most of the spots: others may be hits.
struct PsfSigma {
    double sigma_px;
    bool is_certain;
};

/// Return the median PSF sigma of the brightest stars; without any spot that of the filter that
/// found the peaks. Where narrow it is that of the narrowest stars, as most may be debris out of
/// focus. The arena needs psf_sigma_bytes().
PsfSigma measure_psf_sigma(const Frame &frame, bool narrow, Arena &arena);

size_t psf_sigma_bytes();

}  // namespace st
