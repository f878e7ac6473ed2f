// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#ifndef GNC_STAR_TRACKER_HPP
#define GNC_STAR_TRACKER_HPP

#include "StarTracker/StarTrackerComponentAc.hpp"
#include "startracker.h"

namespace Gnc {

/// Star images to attitudes. Its stack: 65536 bytes.
class StarTracker final : public StarTrackerComponentBase {
public:
    explicit StarTracker(const char *name) : StarTrackerComponentBase(name) {}

    /// Make the tracker in memory of the deployment, with a sky file in memory, both aligned to 64
    /// bytes; st_size() says how much. Before the task is started; false: an event says why.
    bool configure(void *memory, size_t bytes, const st_config &config, const st_camera &camera,
                   const st_sky &sky);

private:
    void image_handler(FwIndexType port, I64 stampNs, Fw::Buffer &pixels) override;
    void rate_handler(FwIndexType port, I64 stampNs, const F64x3 &rateRadS) override;
    bool refused(const char *what, st_status status);

    st_tracker *m_tracker = nullptr;
    st_camera m_camera{};
    st_result m_result{};
};

}  // namespace Gnc

#endif
