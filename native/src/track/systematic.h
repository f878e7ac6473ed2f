// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Errors of an attitude that the tracks of a frame do not average out.

#pragma once

#include "maths/arena.h"
#include "track/bank.h"

namespace st {

/// What a model knows of errors that stay: of star positions, px per axis, and of the scale of the
/// lens, relative; and the turn by an error of the stamp. Zero where not significant.
struct LastingErrors {
    double lens_error_px, lens_scale;
    Vector3 stamp_turn_rad;
};

/// Set the terms of stamps, lens, observer and epoch of an attitude that was fitted to the detected
/// tracks of a bank; observer null: without the latter two.
void add_lasting_errors(const Lens &lens, const TrackList &bank, const SkyFile &sky,
                        const LastingErrors &errors, const st_observer *observer,
                        const Quaternion &attitude, st_budget &budget, Arena &arena);

/// Bytes of work memory of so many tracks.
size_t lasting_errors_bytes(int tracks);

}  // namespace st
