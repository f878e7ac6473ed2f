// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "StarTracker/StarTracker.hpp"

#include <cstring>

namespace Gnc {

namespace {

template <class Array>
Array arrayOf(const double *numbers) {
    Array array;
    for (U32 i = 0; i < Array::SIZE; ++i) {
        array[i] = numbers[i];
    }
    return array;
}

}  // namespace

bool StarTracker::refused(const char *what, st_status status) {
    if (status != ST_OK) {
        this->log_WARNING_HI_Refused(Fw::LogStringArg(what),
                                     Fw::LogStringArg(st_status_text(status)));
    }
    return status != ST_OK;
}

bool StarTracker::configure(void *memory, size_t bytes, const st_config &config,
                            const st_camera &camera, const st_sky &sky) {
    st_fault fault{"sky", 0, 0, 0};
    m_camera = camera;
    return !refused(fault.name, st_check_sky(&sky, &fault)) &&
           !refused(fault.name,
                    st_create(memory, bytes, &config, &camera, &sky, &m_tracker, &fault));
}

void StarTracker::image_handler(FwIndexType, I64 stampNs, Fw::Buffer &pixels) {
    const I64 rowBytes = 2 * m_camera.width_px;
    const st_image image{
        pixels.getData(), rowBytes, m_camera.width_px, m_camera.height_px, ST_GREY16, 1, 0};
    const bool fits = m_tracker != nullptr && pixels.getSize() >= rowBytes * m_camera.height_px;
    const st_status status =
        fits ? st_process_image(m_tracker, stampNs, &image, &m_result) : ST_BAD_IMAGE;
    this->imageDone_out(0, pixels);
    if (refused("image", status)) {
        return;
    }
    const st_attitude &attitude = m_result.attitude;
    this->attitude_out(0, stampNs, attitude.valid != 0, arrayOf<F64x4>(attitude.quaternion),
                       arrayOf<F64x9>(attitude.covariance_rad2[0]),
                       arrayOf<F64x3>(attitude.rate_rad_s),
                       arrayOf<F64x3>(attitude.protection_rad));
    this->tlmWrite_Reason(m_result.reason.code);
    this->tlmWrite_State(m_result.tracking.state);
}

void StarTracker::rate_handler(FwIndexType, I64 stampNs, const F64x3 &rateRadS) {
    const double rate[3] = {rateRadS[0], rateRadS[1], rateRadS[2]};
    (void)refused("rate", st_add_rate(m_tracker, stampNs, rate));
}

}  // namespace Gnc
