// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Identification of frames that follow one another, of any shutter.
//
// The stars of a rolling shutter are moved to the time of their frame by the rate between it and the
// frame before. Without one, or where that does not identify them, they are identified with a wide
// tolerance, and the rate is that which explains their residuals (rolling_shutter.h).
//
// Planets, Moon and Sun are not stars: what is identified in their light is left out.

#pragma once

#include "identify/identification_stage.h"
#include "sky/apparent.h"

namespace st {

class FrameSearch {
public:
    FrameSearch() = default;
    FrameSearch(int most_centroids, Arena &kept);

    static size_t bytes(int most_centroids);
    static size_t work_bytes(const IdentificationSetup &setup);

    /// Begin with a frame.
    void begin(int64_t stamp_ns, const st_centroid *centroids, int count,
               IdentificationStage &stage, Arena &work);

    /// Continue for so much work; *stop not zero ends it, null is allowed. sky may be null: bodies are
    /// then not known.
    void proceed(double slice_s, const volatile uint32_t *stop, IdentificationStage &stage,
                 ApparentSky *sky, st_identification &result, List<st_identified> &identified,
                 Arena &work);

    /// Forget the frame before, and a search that waits to be continued.
    void reset();

    bool is_searching() const { return searching_; }
    int64_t stamp_ns() const { return stamp_ns_; }

    /// The centroids of the frame, where they were at its time as far as that is known.
    const List<st_centroid> &centroids() const { return moved_; }

private:
    /// What is searched: centroids moved by a rate, or as they are; with which tolerance for the shear.
    enum class Attempt { BY_FRAME_BEFORE, SHEARED_LITTLE, SHEARED_MUCH, LAST };

    void search(Attempt attempt, IdentificationStage &stage, Arena &work);
    void move(const Lens &lens, const Vector3 &rate_rad_s);
    bool rate_of_residuals(const IdentificationStage &stage, const st_identification &result,
                           Vector3 &rate_rad_s, Arena &work) const;

    List<st_centroid> seen_, moved_, before_;
    int64_t stamp_ns_ = 0, before_ns_ = 0;
    bool searching_ = false, has_before_ = false;
    Attempt attempt_ = Attempt::LAST;
};

}  // namespace st
