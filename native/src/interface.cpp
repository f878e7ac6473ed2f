// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Versions, texts, and the options with their defaults and ranges.

#if defined(__x86_64__)
#include <cpuid.h>
#endif

#include <cmath>
#include <cstddef>
#include <cstring>

#include "options.h"

namespace st {
namespace {

constexpr st_abi THIS_ABI = ST_ABI;

bool same_abi(const st_abi &a, const st_abi &b) {
    return std::memcmp(&a, &b, sizeof(st_abi)) == 0;
}

// --- instructions ---

#if defined(__SSE4_2__)
#define ST_PROCESSOR "x86-64-v2"
#elif defined(__x86_64__)
#define ST_PROCESSOR "x86-64"
#elif defined(__aarch64__)
#define ST_PROCESSOR "armv8-a"
#else
#define ST_PROCESSOR "the processor it was built for"
#endif

/// Whether the processor has what the compiler was allowed to use (x86-64 psABI, table 3.1).
bool has_instructions() {
#if defined(__SSE4_2__)
    // Not by __builtin_cpu_supports, which with zig knows nothing in some programs.
    unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
    constexpr unsigned NEEDED = bit_SSSE3 | bit_SSE4_1 | bit_SSE4_2 | bit_POPCNT;
    return __get_cpuid(1, &eax, &ebx, &ecx, &edx) != 0 && (ecx & NEEDED) == NEEDED;
#else
    return true;
#endif
}

// --- options ---

enum class Kind { NUMBER, WHOLE };

enum class Change { AT_CREATE, LIVE };

struct Option {
    const char *name;
    size_t offset;
    Kind kind;
    double standard, least, most;
    Change change = Change::AT_CREATE;
};

#define NUMBER(option, ...) {#option, offsetof(st_config, option), Kind::NUMBER, __VA_ARGS__}
#define WHOLE(option, ...) {#option, offsetof(st_config, option), Kind::WHOLE, __VA_ARGS__}

// Those of the Python classes of options, which a test compares with these.
constexpr Option OPTIONS[] = {
    WHOLE(stages, ST_ALL_STAGES, 1, ST_ALL_STAGES),
    WHOLE(capacities.peaks, 0, 0, 1e6),
    WHOLE(capacities.centroids, 0, 0, 5000),
    WHOLE(capacities.rejected, 0, 0, 1e6),
    WHOLE(capacities.tracks, 0, 0, 500),
    WHOLE(capacities.predictions, 0, 0, 5000),
    WHOLE(capacities.candidates, 0, 0, 1e6),
    WHOLE(capacities.frames, 0, 0, 1000),
    WHOLE(capacities.rates, 0, 0, 1e5),
    NUMBER(extraction.threshold_sigma, 5.5, 3.0, 100.0, Change::LIVE),
    NUMBER(extraction.threshold_dn, 50.0, 0.1, 65535.0, Change::LIVE),
    NUMBER(extraction.psf_sigma_px, 0.0, 0.0, 5.0),
    NUMBER(extraction.exposure_s, 0.0, 0.0, 600.0),
    NUMBER(extraction.line_time_us, 0.0, 0.0, 10000.0),
    NUMBER(extraction.search_period_s, 1.0, 0.0, 3600.0, Change::LIVE),
    WHOLE(extraction.threshold, ST_THRESHOLD_SIGMA, 0, ST_THRESHOLD_ITERATIVE, Change::LIVE),
    WHOLE(extraction.method, ST_GAUSSIAN, 0, ST_THRESHOLDED, Change::LIVE),
    WHOLE(extraction.max_stars, 40, 1, 5000, Change::LIVE),
    WHOLE(extraction.max_stars_lost, 160, 1, 5000, Change::LIVE),
    WHOLE(extraction.readout_up, 0, 0, 1),
    NUMBER(identification.tolerance_sigmas, 3.5, 1.0, 10.0),
    NUMBER(identification.sigma_floor_px, 0.2, 0.0, 10.0),
    NUMBER(identification.fov_error_percent, 0.5, 0.0, 5.0),
    NUMBER(identification.false_alarm_max, 1e-5, 1e-30, 0.1),
    NUMBER(identification.most_work_s, 1.0, 0.001, 600.0),
    NUMBER(identification.check_period_s, 10.0, 0.0, 3600.0),
    NUMBER(identification.slice_s, 0.0, 0.0, 600.0),
    WHOLE(identification.max_image_stars, 400, 4, 500),
    NUMBER(tracking.magnitude_limit, 11.0, 0.0, 11.0),
    NUMBER(tracking.acceleration_deg_s2, 0.005, 1e-6, 100.0),
    NUMBER(tracking.roll_acceleration_deg_s2, 0.005, 1e-6, 100.0),
    NUMBER(tracking.sigma_floor_px, 0.01, 1e-4, 10.0, Change::LIVE),
    NUMBER(tracking.detection_probability, 0.95, 0.01, 0.999),
    NUMBER(tracking.gate_probability, 0.9999, 0.5, 0.999999),
    NUMBER(tracking.magnitude_tolerance, 1.0, 0.05, 20.0, Change::LIVE),
    NUMBER(tracking.max_residual_px, 1.0, 0.01, 100.0, Change::LIVE),
    NUMBER(tracking.max_rate_deg_s, 10.0, 0.001, 100.0, Change::LIVE),
    NUMBER(tracking.max_gap_s, 5.0, 0.01, 600.0, Change::LIVE),
    WHOLE(tracking.max_stars, 40, 4, 500, Change::LIVE),
    WHOLE(tracking.min_stars, 4, 3, 100, Change::LIVE),
    WHOLE(tracking.max_missed, 5, 0, 200, Change::LIVE),
    WHOLE(tracking.confirm_frames, 3, 1, 100, Change::LIVE),
    WHOLE(tracking.max_bad_frames, 5, 1, 1000, Change::LIVE),
    WHOLE(tracking.model, ST_ATTITUDE_MODEL, 0, ST_MODEL_COUNT - 1),
    WHOLE(tracking.solver, ST_QUEST, 0, ST_TRIAD),
    WHOLE(tracking.association, ST_POISSON, 0, ST_ASSOCIATION_COUNT - 1),
    WHOLE(tracking.sna_confirmation, 0, 0, 1),
    WHOLE(tracking.roll_by_gyro, 0, 0, 1),
    NUMBER(gyro.gyro_drift_deg_h, 3.0, 0.001, 10000.0),
    NUMBER(gyro.gyro_noise_deg_sqrt_h, 0.15, 0.0, 100.0),
    NUMBER(gyro.gyro_range_deg_s, 100.0, 0.1, 100.0),
    NUMBER(gyro.gyro_rate_change_deg_s2, 0.1, 0.0, 1000.0),
    NUMBER(trust.max_residual_px, 1.0, 0.01, 100.0, Change::LIVE),
    NUMBER(trust.misleading_probability, 1e-7, 1e-12, 0.1, Change::LIVE),
    NUMBER(trust.false_star_probability, 1e-5, 1e-9, 0.01, Change::LIVE),
    WHOLE(trust.solver, ST_QUEST, 0, ST_TRIAD, Change::LIVE),
    WHOLE(trust.min_stars, 4, 2, 100, Change::LIVE),
};

#undef NUMBER
#undef WHOLE

double value_of(const st_config &config, const Option &option) {
    const auto *place = reinterpret_cast<const unsigned char *>(&config) + option.offset;
    return option.kind == Kind::NUMBER ? *reinterpret_cast<const double *>(place)
                                       : *reinterpret_cast<const int32_t *>(place);
}

void set_standard(st_config &config, const Option &option) {
    auto *place = reinterpret_cast<unsigned char *>(&config) + option.offset;
    if (option.kind == Kind::NUMBER) {
        *reinterpret_cast<double *>(place) = option.standard;
    } else {
        *reinterpret_cast<int32_t *>(place) = static_cast<int32_t>(option.standard);
    }
}

bool refuse(st_fault *fault, const char *name, double value, double least, double most) {
    if (fault != nullptr) {
        *fault = {name, value, least, most};
    }
    return false;
}

/// Julian years to which the catalogue is propagated; NaN is the year of the sky file.
constexpr double FIRST_EPOCH = 1800.0, LAST_EPOCH = 2200.0;

bool options_are_possible(const st_config &config, st_fault *fault) {
    for (const Option &option : OPTIONS) {
        const double value = value_of(config, option);
        if (!(value >= option.least && value <= option.most)) {
            return refuse(fault, option.name, value, option.least, option.most);
        }
    }
    const double year = config.epoch_year;
    return std::isnan(year) || (year >= FIRST_EPOCH && year <= LAST_EPOCH) ||
           refuse(fault, "epoch_year", year, FIRST_EPOCH, LAST_EPOCH);
}

}  // namespace

bool only_live_differ(const st_config &now, const st_config &wanted, st_fault *fault) {
    for (const Option &option : OPTIONS) {
        const double before = value_of(now, option), after = value_of(wanted, option);
        if (option.change == Change::AT_CREATE && before != after) {
            return refuse(fault, option.name, after, before, before);
        }
    }
    const double before = now.epoch_year, after = wanted.epoch_year;
    return before == after || (std::isnan(before) && std::isnan(after)) ||
           refuse(fault, "epoch_year", after, before, before);
}

}  // namespace st

using namespace st;

extern "C" {

st_status st_check_abi(const st_abi *caller) {
    if (!has_instructions()) {
        return ST_WRONG_PROCESSOR;
    }
    if (caller == nullptr) {
        return ST_NULL_POINTER;
    }
    return same_abi(*caller, THIS_ABI) ? ST_OK : ST_WRONG_VERSION;
}

#define TEXT_OF(number) #number
#define TEXT(number) TEXT_OF(number)
#if defined(__clang__)
#define ST_COMPILER __VERSION__
#else
#define ST_COMPILER "g++ " __VERSION__
#endif

const char *st_build_text() {
    return ST_COMPILER ", " ST_PROCESSOR ", interface " TEXT(ST_VERSION);
}

const char *st_status_text(st_status status) {
    switch (status) {
        case ST_OK:
            return "ok";
        case ST_NULL_POINTER:
            return "a pointer is null";
        case ST_WRONG_VERSION:
            return "caller and library are of different versions of startracker.h";
        case ST_WRONG_PROCESSOR:
            return "the library was built for a later processor: x86-64-v2 is the oldest one";
        case ST_OUT_OF_RANGE:
            return "a number is out of its range";
        case ST_BAD_CAMERA:
            return "no lens has these numbers: the field is too wide, or the image folds";
        case ST_BAD_SKY:
            return "not a sky file of this version and camera, or damaged";
        case ST_TOO_LITTLE_MEMORY:
            return "less memory than st_size says";
        case ST_MISALIGNED:
            return "memory or sky file is not aligned to 64 bytes";
        case ST_BAD_IMAGE:
            return "size, stride or type of the image is not that of the camera";
        case ST_BAD_INPUT:
            return "an input is not finite, or not possible";
        case ST_NOT_NEWER:
            return "the stamp is not newer than the one before";
        case ST_TOO_MANY:
            return "more elements than the capacity of the list";
        case ST_READ_ONLY:
            return "an option that only st_create takes";
        case ST_NO_STAGE:
            return "the tracker was created without this stage";
        case ST_STATUS_COUNT:
            break;
    }
    return "not a status of this library";
}

st_status st_defaults(st_config *config, const st_abi *caller) {
    // Before anything is written: a config of another version may be smaller.
    const st_status status = st_check_abi(caller);
    if (status != ST_OK) {
        return status;
    }
    if (config == nullptr) {
        return ST_NULL_POINTER;
    }
    *config = {};
    config->abi = THIS_ABI;
    config->epoch_year = NAN;
    for (const Option &option : OPTIONS) {
        set_standard(*config, option);
    }
    return ST_OK;
}

st_status st_check_config(const st_config *config, st_fault *fault) {
    if (config == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!same_abi(config->abi, THIS_ABI)) {
        return ST_WRONG_VERSION;
    }
    return options_are_possible(*config, fault) ? ST_OK : ST_OUT_OF_RANGE;
}

}  // extern "C"
