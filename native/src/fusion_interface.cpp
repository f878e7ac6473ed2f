// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Calls for a fusion of heads, and its options with defaults and ranges.

#include <cmath>
#include <new>

#include "fusion/fusion.h"
#include "maths/numbers.h"
#include "startracker_fusion.h"

using namespace st;

struct st_fusion {
    Fusion fusion;
};

namespace {

/// Differences of two stamps within it, year 2112, and of time offsets, are numbers too.
constexpr int64_t LATEST_NS = 4'500'000'000'000'000'000;
constexpr double MOST_OFFSET_S = 1e6;

bool is_possible(int64_t stamp_ns) {
    return -LATEST_NS <= stamp_ns && stamp_ns <= LATEST_NS;
}

/// A number of the options with its range, by the name in docs/parameters.md.
struct Ranged {
    const char *name;
    double value, least, most;
};

bool is_outside(const Ranged &one, st_fault *fault) {
    if (one.least <= one.value && one.value <= one.most) {
        return false;
    }
    if (fault != nullptr) {
        *fault = {one.name, one.value, one.least, one.most};
    }
    return true;
}

/// Whether all options are within their ranges; fault names the one that is not.
st_status check(const st_fusion_config &config, st_fault *fault) {
    const st_fusion_options &fusion = config.fusion;
    const st_mount_options &mount = config.mount;
    const st_gyro_options &gyro = config.gyro;
    const Ranged options[] = {
        {"heads", static_cast<double>(config.heads), 1, ST_MOST_HEADS},
        {"frames", static_cast<double>(config.frames), 0, 1e6},
        {"rates", static_cast<double>(config.rates), 0, 1e7},
        {"start_heads", static_cast<double>(fusion.start_heads), 1, 2},
        {"agree_frames", static_cast<double>(fusion.agree_frames), 1, 10000},
        {"exclude_frames", static_cast<double>(fusion.exclude_frames), 1, 100},
        {"horizon_s", fusion.horizon_s, 0, 60},
        {"max_gap_s", fusion.max_gap_s, 0.01, 60},
        {"max_gyro_gap_s", fusion.max_gyro_gap_s, 0.01, 1e5},
        {"acceleration_deg_s2", fusion.acceleration_deg_s2, 1e-6, 100},
        {"correlation_s", fusion.correlation_s, 0, 3600},
        {"mount_sigma_arcsec", mount.mount_sigma_arcsec, 0, 36000},
        {"mount_walk_arcsec_sqrt_h", mount.mount_walk_arcsec_sqrt_h, 0, 1000},
        {"mount_temperature_arcsec_k", mount.mount_temperature_arcsec_k, 0, 1000},
        {"mount_orbit_arcsec", mount.mount_orbit_arcsec, 0, 1000},
        {"orbit_period_s", mount.orbit_period_s, 60, 1e7},
        {"gyro_drift_deg_h", gyro.gyro_drift_deg_h, 0.001, 10000},
        {"gyro_noise_deg_sqrt_h", gyro.gyro_noise_deg_sqrt_h, 0, 100},
        {"gyro_range_deg_s", gyro.gyro_range_deg_s, 0.1, 100},
        {"gyro_rate_change_deg_s2", gyro.gyro_rate_change_deg_s2, 0, 1000}};
    for (const Ranged &one : options) {
        if (is_outside(one, fault)) {
            return ST_OUT_OF_RANGE;
        }
    }
    return ST_OK;
}

/// Whether options and mounts are possible, and the coefficients fit.
st_status check(const st_fusion_config *config, const st_mount *mounts, st_fault *fault) {
    if (config == nullptr || mounts == nullptr) {
        return ST_NULL_POINTER;
    }
    const st_status status = check(*config, fault);
    if (status != ST_OK) {
        return status;
    }
    const int coefficients = Fusion::coefficients_of(*config, mounts);
    if (coefficients > ST_MOST_COEFFICIENTS) {
        if (fault != nullptr) {
            *fault = {"coefficients of mounts", static_cast<double>(coefficients), 0,
                      ST_MOST_COEFFICIENTS};
        }
        return ST_TOO_MANY;
    }
    for (int k = 0; k < config->heads; ++k) {
        double square = 0.0;
        for (const double one : mounts[k].quaternion) {
            square += one * one;
        }
        if (!(std::fabs(std::sqrt(square) - 1) < 1e-6) ||
            !(std::fabs(mounts[k].time_offset_s) <= MOST_OFFSET_S)) {
            return ST_BAD_INPUT;
        }
    }
    return ST_OK;
}

template <size_t N>
void set_unknown(double (&numbers)[N]) {
    for (double &one : numbers) {
        one = NAN;
    }
}

template <size_t R, size_t C>
void set_unknown(double (&matrix)[R][C]) {
    for (auto &row : matrix) {
        set_unknown(row);
    }
}

bool has_head(const st_fusion *fusion, int32_t head) {
    return fusion != nullptr && 0 <= head && head < fusion->fusion.heads();
}

}  // namespace

st_status st_fusion_defaults(st_fusion_config *config, int32_t heads) {
    if (config == nullptr) {
        return ST_NULL_POINTER;
    }
    *config = {};
    config->fusion = {1.0, 1.0, 600.0, 0.005, 0.0, 2, 5, 3, 0};
    config->mount = {10.0, 0.5, 0.0, 0.0, 5700.0};
    config->gyro = {3.0, 0.15, 100.0, 0.1};
    config->heads = heads;
    return ST_OK;
}

st_status st_fusion_size(const st_fusion_config *config, const st_mount *mounts, size_t *bytes) {
    if (bytes == nullptr) {
        return ST_NULL_POINTER;
    }
    const st_status status = check(config, mounts, nullptr);
    if (status == ST_OK) {
        *bytes = Arena::padded<st_fusion>(1) + Fusion::bytes(*config, mounts);
    }
    return status;
}

st_status st_fusion_create(void *memory, size_t bytes, const st_fusion_config *config,
                           const st_mount *mounts, st_fusion **fusion, st_fault *fault) {
    if (memory == nullptr || fusion == nullptr) {
        return ST_NULL_POINTER;
    }
    const st_status status = check(config, mounts, fault);
    if (status != ST_OK) {
        return status;
    }
    if (reinterpret_cast<uintptr_t>(memory) % ALIGNMENT != 0) {
        return ST_MISALIGNED;
    }
    if (bytes < Arena::padded<st_fusion>(1) + Fusion::bytes(*config, mounts)) {
        return ST_TOO_LITTLE_MEMORY;
    }
    Arena arena(memory, bytes);
    *fusion = new (arena.take<st_fusion>(1)) st_fusion;
    (*fusion)->fusion.start(*config, mounts, arena);
    return ST_OK;
}

st_status st_fusion_reset(st_fusion *fusion) {
    if (fusion == nullptr) {
        return ST_NULL_POINTER;
    }
    fusion->fusion.reset();
    return ST_OK;
}

st_status st_fusion_add_rate(st_fusion *fusion, int64_t stamp_ns, const double rate_rad_s[3]) {
    if (fusion == nullptr || rate_rad_s == nullptr) {
        return ST_NULL_POINTER;
    }
    return is_possible(stamp_ns) && fusion->fusion.add_rate(stamp_ns, from<Vector3>(rate_rad_s))
               ? ST_OK
               : ST_BAD_INPUT;
}

st_status st_fusion_add_frame(st_fusion *fusion, int32_t head, int64_t stamp_ns,
                              const double quaternion[4], const double covariance[9],
                              st_fused *fused) {
    if (quaternion == nullptr || covariance == nullptr || fused == nullptr || fusion == nullptr) {
        return ST_NULL_POINTER;
    }
    const HeadFrame frame{stamp_ns, from<Quaternion>(quaternion), from<Matrix3>(covariance)};
    if (!has_head(fusion, head) || !is_possible(stamp_ns) || !is_attitude(frame)) {
        return ST_BAD_INPUT;
    }
    // Where there is no attitude no number is one.
    set_unknown(fused->quaternion);
    set_unknown(fused->covariance_rad2);
    set_unknown(fused->rate_rad_s);
    set_unknown(fused->rate_covariance);
    set_unknown(fused->drift_rad_s);
    set_unknown(fused->drift_covariance);
    fused->stamp_ns = stamp_ns;
    fused->valid = fused->reserved = 0;
    fusion->fusion.add_frame(head, frame, *fused);
    return ST_OK;
}

st_status st_fusion_add_temperature(st_fusion *fusion, int32_t head, double celsius) {
    if (fusion == nullptr) {
        return ST_NULL_POINTER;
    }
    return has_head(fusion, head) && fusion->fusion.head(head).set_temperature(celsius)
               ? ST_OK
               : ST_BAD_INPUT;
}

st_status st_fusion_state(const st_fusion *fusion, st_reason *trouble, st_reason *gyro_trouble,
                          int32_t *uses_gyro) {
    if (fusion == nullptr) {
        return ST_NULL_POINTER;
    }
    if (trouble != nullptr) {
        *trouble = fusion->fusion.trouble();
    }
    if (gyro_trouble != nullptr) {
        *gyro_trouble = fusion->fusion.motion().gyro_trouble;
    }
    if (uses_gyro != nullptr) {
        *uses_gyro = fusion->fusion.motion().uses_gyro ? 1 : 0;
    }
    return ST_OK;
}

st_status st_fusion_head(const st_fusion *fusion, int32_t head, int64_t stamp_ns, st_head *state) {
    if (fusion == nullptr || state == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!has_head(fusion, head) || !is_possible(stamp_ns)) {
        return ST_BAD_INPUT;
    }
    const Head &of = fusion->fusion.head(head);
    *state = of.counts;
    state->reason = of.reason;
    state->noise_scale = of.noise.scale;
    state->state = of.state;
    state->silent = fusion->fusion.is_missing(head, stamp_ns) ? 1 : 0;
    state->stands_out = of.noise.stands_out() ? 1 : 0;
    state->needs_temperature = of.needs_temperature ? 1 : 0;
    return ST_OK;
}

st_status st_fusion_mount(const st_fusion *fusion, int32_t head, int64_t stamp_ns,
                          double quaternion[4], double misalignment_rad[3], double covariance[9]) {
    if (fusion == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!has_head(fusion, head) || !is_possible(stamp_ns)) {
        return ST_BAD_INPUT;
    }
    Vector3 offset;
    Matrix3 P;
    fusion->fusion.misalignment(head, stamp_ns, offset, P);
    into(misalignment_rad, offset);
    into(covariance, P);
    into(quaternion, multiply(quaternion_from_rotation_vector(offset),
                              from<Quaternion>(fusion->fusion.head(head).mount.quaternion)));
    return ST_OK;
}

st_status st_fusion_learnt(const st_fusion *fusion, int32_t head, st_mount *mount) {
    if (fusion == nullptr || mount == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!has_head(fusion, head)) {
        return ST_BAD_INPUT;
    }
    *mount = fusion->fusion.estimated(head);
    return ST_OK;
}

const st_mount_step *st_fusion_steps(const st_fusion *fusion, size_t *count) {
    const List<st_mount_step> *steps = fusion == nullptr ? nullptr : &fusion->fusion.steps();
    if (count != nullptr) {
        *count = steps == nullptr ? 0 : static_cast<size_t>(steps->count);
    }
    return steps == nullptr ? nullptr : steps->item;
}
