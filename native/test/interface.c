// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* Wrong use of the interface gets a status and changes nothing. Exit status 1 if any does not. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "startracker_ground.h"

static int failures;

static void check(int holds, const char *what, int line) {
    if (!holds) {
        printf("interface.c:%d: %s\n", line, what);
        ++failures;
    }
}

#define CHECK(condition) check((condition), #condition, __LINE__)

static const st_abi ABI = ST_ABI;

static void versions(void) {
    st_abi other = ABI;
    st_config config;
    memset(&config, 0x5a, sizeof config);
    CHECK(st_check_abi(&ABI) == ST_OK);
    CHECK(st_check_abi(NULL) == ST_NULL_POINTER);
    other.result += 8;
    CHECK(st_check_abi(&other) == ST_WRONG_VERSION);
    CHECK(st_defaults(&config, &other) == ST_WRONG_VERSION);
    CHECK(config.stages == 0x5a5a5a5a);
    CHECK(st_defaults(NULL, &ABI) == ST_NULL_POINTER);
    CHECK(st_defaults(&config, &ABI) == ST_OK);
    CHECK(st_check_config(&config, NULL) == ST_OK);
    config.abi.version += 1;
    CHECK(st_check_config(&config, NULL) == ST_WRONG_VERSION);
}

static void options(void) {
    st_config config;
    st_fault fault = {NULL, 0, 0, 0};
    st_defaults(&config, &ABI);
    config.tracking.max_stars = 501;
    CHECK(st_check_config(&config, &fault) == ST_OUT_OF_RANGE);
    CHECK(strcmp(fault.name, "tracking.max_stars") == 0);
    CHECK(fault.value == 501 && fault.least == 4 && fault.most == 500);
    st_defaults(&config, &ABI);
    config.trust.misleading_probability = NAN;
    CHECK(st_check_config(&config, &fault) == ST_OUT_OF_RANGE);
    CHECK(strcmp(fault.name, "trust.misleading_probability") == 0);
    CHECK(st_check_config(NULL, &fault) == ST_NULL_POINTER);
    st_defaults(&config, &ABI);
    config.epoch_year = 2500;
    CHECK(st_check_config(&config, &fault) == ST_OUT_OF_RANGE);
    config.epoch_year = 2026.5;
    CHECK(st_check_config(&config, &fault) == ST_OK);
}

static st_camera usual(void) {
    st_camera camera = {1024, 768, 1500, 1501, 511.5, 383.5, {0}, ST_PLUMB_BOB, 0};
    return camera;
}

static void cameras(void) {
    st_fault fault = {NULL, 0, 0, 0};
    st_camera camera = usual();
    CHECK(st_check_camera(&camera, &fault) == ST_OK);
    CHECK(st_check_camera(NULL, &fault) == ST_NULL_POINTER);
    camera.fx_px = NAN;
    CHECK(st_check_camera(&camera, &fault) == ST_OUT_OF_RANGE);
    CHECK(strcmp(fault.name, "fx_px") == 0);
    camera = usual();
    camera.model = 3;
    CHECK(st_check_camera(&camera, &fault) == ST_OUT_OF_RANGE);
    camera = usual();
    camera.distortion[7] = 0.1; /* plumb_bob has five terms */
    CHECK(st_check_camera(&camera, &fault) == ST_OUT_OF_RANGE);
    camera = usual();
    camera.distortion[0] = -4; /* folds within the image */
    CHECK(st_check_camera(&camera, &fault) == ST_BAD_CAMERA);
    camera = usual();
    camera.fx_px = camera.fy_px = 20; /* 88 deg to each side */
    CHECK(st_check_camera(&camera, &fault) == ST_BAD_CAMERA);
    camera.model =
        ST_EQUIDISTANT; /* more than straight back: pixels beyond it have no direction */
    camera.fx_px = camera.fy_px = 100;
    CHECK(st_check_camera(&camera, &fault) == ST_OK);
}

static void lists(void) {
    const st_camera camera = usual();
    const double back[6] = {0, 0, -1, NAN, 0, 1};
    double pixel[4] = {7, 7, 7, 7}, flow[12];
    CHECK(st_project(&camera, back, pixel, 2) == ST_OK);
    CHECK(isnan(pixel[0]) && isnan(pixel[1]) && isnan(pixel[2]));
    CHECK(st_image_flow(&camera, back, flow, 2) == ST_OK);
    CHECK(isnan(flow[0]) && isnan(flow[11]));
    CHECK(st_project(&camera, NULL, pixel, 1) == ST_NULL_POINTER);
    CHECK(st_project(&camera, back, NULL, 1) == ST_NULL_POINTER);
    CHECK(st_unproject(NULL, pixel, flow, 1) == ST_NULL_POINTER);
    pixel[0] = 7;
    CHECK(st_project(&camera, back, pixel, 0) == ST_OK && pixel[0] == 7);
}

/* A tracker that extracts, in memory of the size that it needs. */
static void on_ground(st_tracker *tracker, const st_image *image) {
    const st_search_options options = {1, 0, 0, 0, 0}, none = {0, 0, 0, 0, 0};
    const st_streak streak = {NAN, 0, 0, 0, 0};
    const double place[2] = {50, 50}, radius_px = 3;
    double widths[3], full_scale_dn = 0;
    st_extraction found;
    int32_t kept = 7;
    size_t bytes = 0, count = 0;
    CHECK(st_searched_size(NULL, &bytes) == ST_NULL_POINTER);
    CHECK(st_searched_size(tracker, NULL) == ST_NULL_POINTER);
    CHECK(st_searched_size(tracker, &bytes) == ST_OK && bytes > 0);
    char *left = aligned_alloc(64, bytes);
    memset(left, 0, bytes);
    CHECK(st_search(NULL, image, &options, NULL, NULL, left, &kept, &found) == ST_NULL_POINTER);
    CHECK(st_search(tracker, image, NULL, NULL, NULL, left, &kept, &found) == ST_NULL_POINTER);
    CHECK(st_search(tracker, image, &options, NULL, NULL, NULL, &kept, &found) == ST_NULL_POINTER);
    CHECK(st_search(tracker, image, &options, NULL, NULL, left + 8, &kept, &found) ==
          ST_MISALIGNED);
    CHECK(st_search(tracker, image, &none, NULL, NULL, left, &kept, &found) == ST_BAD_INPUT);
    CHECK(st_search(tracker, image, &options, &streak, NULL, left, &kept, &found) == ST_BAD_INPUT);
    CHECK(st_search(tracker, image, &options, NULL, NULL, left, &kept, &found) == ST_OK);
    CHECK(kept == 0 && found.reason.code == ST_REASON_BLANK);
    /* What was never filled is of no image. */
    CHECK(st_search_near(tracker, image, place, &radius_px, 1, NULL, left, left, &found) ==
          ST_BAD_IMAGE);
    CHECK(st_measure_widths(tracker, image, left, widths, 1, &count) == ST_BAD_IMAGE);
    CHECK(st_find_spots(tracker, image, 0, 0) == ST_BAD_INPUT);
    CHECK(st_find_spots(tracker, image, 4, 0) == ST_OK);
    CHECK(st_find_highest_peaks(tracker, image) == ST_OK);
    CHECK(st_full_scale(tracker, image, 5, NULL) == ST_NULL_POINTER);
    CHECK(st_full_scale(tracker, image, 5, &full_scale_dn) == ST_OK && isinf(full_scale_dn));
    free(left);
}

/* A tracker keeps the exposure that it estimated; no refused call changes anything. */
static void changes(st_tracker *tracker, const st_config *created, const st_image *image) {
    st_config config = *created;
    st_fault fault = {NULL, 0, 0, 0};
    st_extraction found;
    CHECK(st_change_options(NULL, &config, &fault) == ST_NULL_POINTER);
    CHECK(st_change_options(tracker, NULL, &fault) == ST_NULL_POINTER);
    config.extraction.max_stars = 5001;
    CHECK(st_change_options(tracker, &config, &fault) == ST_OUT_OF_RANGE);
    CHECK(strcmp(fault.name, "extraction.max_stars") == 0);
    config.extraction.max_stars = 20;
    config.extraction.line_time_us = 20;
    CHECK(st_change_options(tracker, &config, &fault) == ST_READ_ONLY);
    CHECK(strcmp(fault.name, "extraction.line_time_us") == 0 && fault.value == 20);
    CHECK(fault.least == 0 && fault.most == 0);
    CHECK(st_change_options(tracker, &config, NULL) == ST_READ_ONLY);
    config = *created;
    config.epoch_year = 2026;
    CHECK(st_change_options(tracker, &config, &fault) == ST_READ_ONLY);
    CHECK(strcmp(fault.name, "epoch_year") == 0);
    config = *created;
    config.capacities.predictions += 1;
    CHECK(st_change_options(tracker, &config, &fault) == ST_READ_ONLY);
    config = *created;
    config.abi.config += 8;
    CHECK(st_change_options(tracker, &config, &fault) == ST_WRONG_VERSION);
    config = *created;
    config.extraction.max_stars = 20;
    config.extraction.method = ST_GREY;
    CHECK(st_change_options(tracker, &config, &fault) == ST_OK);
    CHECK(st_extract(tracker, 4, image, NULL, 0, 0, 1, &found) == ST_OK);
    CHECK(found.exposure_least_s == 0.1 && found.exposure_most_s == 0.1);
    CHECK(st_change_options(tracker, created, NULL) == ST_OK);
}

static void trackers(void) {
    static unsigned char pixels[100 * 130 * 2 + 1];
    const st_camera camera = {130, 100, 900, 900, 64.5, 49.5, {0}, ST_PLUMB_BOB, 0};
    st_image image = {pixels, 260, 130, 100, ST_GREY16, 1, 0};
    st_prediction prediction = {50, 50, 0, 0, 0.1, 7, 0};
    st_extraction found;
    st_config config;
    st_fault fault;
    st_tracker *tracker = NULL;
    size_t bytes = 0, count = 7;
    st_defaults(&config, &ABI);
    CHECK(st_size(&config, &camera, NULL, &bytes) == ST_NULL_POINTER);
    config.stages = ST_EXTRACTS;
    CHECK(st_size(&config, &camera, NULL, NULL) == ST_NULL_POINTER);
    CHECK(st_size(&config, &camera, NULL, &bytes) == ST_OK && bytes % 64 == 0);
    unsigned char *block = aligned_alloc(64, bytes + 64);
    CHECK(st_create(NULL, bytes, &config, &camera, NULL, &tracker, &fault) == ST_NULL_POINTER);
    CHECK(st_create(block + 8, bytes, &config, &camera, NULL, &tracker, &fault) == ST_MISALIGNED);
    CHECK(st_create(block, bytes - 1, &config, &camera, NULL, &tracker, &fault) ==
          ST_TOO_LITTLE_MEMORY);
    config.extraction.max_stars = 0;
    CHECK(st_create(block, bytes, &config, &camera, NULL, &tracker, &fault) == ST_OUT_OF_RANGE);
    CHECK(strcmp(fault.name, "extraction.max_stars") == 0);
    config.extraction.max_stars = 40;
    CHECK(tracker == NULL);
    CHECK(st_create(block, bytes, &config, &camera, NULL, &tracker, &fault) == ST_OK);
    memset(pixels, 5, sizeof pixels);
    CHECK(st_extract(tracker, 1, &image, NULL, 0, 0, 1, &found) == ST_OK);
    CHECK(found.reason.code == ST_REASON_BLANK && found.reason.figure[0] == 0x505);
    CHECK(isnan(found.background_dn) && found.centroids == 0);
    CHECK(st_centroids(tracker, &count) != NULL && count == 0);
    CHECK(st_extract(NULL, 1, &image, NULL, 0, 0, 1, &found) == ST_NULL_POINTER);
    CHECK(st_extract(tracker, 1, NULL, NULL, 0, 0, 1, &found) == ST_NULL_POINTER);
    CHECK(st_extract(tracker, 1, &image, NULL, 1, 0, 1, &found) == ST_NULL_POINTER);
    CHECK(st_extract(tracker, 1, &image, NULL, 0, 0, 1, NULL) == ST_NULL_POINTER);
    CHECK(st_extract(tracker, -1, &image, NULL, 0, 0, 1, &found) == ST_BAD_INPUT);
    CHECK(st_extract(tracker, 2, &image, &prediction, 5000, 1, 1, &found) == ST_TOO_MANY);
    CHECK(st_extract(tracker, 2, &image, &prediction, 1, 1, 1, &found) == ST_OK);
    prediction.sigma_px = NAN;
    CHECK(st_extract(tracker, 2, &image, &prediction, 1, 1, 1, &found) == ST_BAD_INPUT);
    prediction.sigma_px = 0.1;
    image.exposure_s = -1;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_BAD_INPUT);
    image.exposure_s = 0.1;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_OK);
    CHECK(found.exposure_least_s == 0.1 && found.exposure_most_s == 0.1);
    image.exposure_s = 0;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_OK);
    CHECK(found.exposure_least_s == 0.1 && found.exposure_most_s == 0.1);
    image.stride_bytes = 259;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_BAD_IMAGE);
    image.stride_bytes = 258;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_BAD_IMAGE);
    image.stride_bytes = 260;
    image.pixels = pixels + 1;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_BAD_IMAGE);
    image.type = ST_GREY8;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_OK);
    image.cell = 2;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_BAD_IMAGE);
    image.cell = 0;
    CHECK(st_extract(tracker, 3, &image, NULL, 0, 0, 1, &found) == ST_BAD_IMAGE);
    image.cell = 1;
    on_ground(tracker, &image);
    changes(tracker, &config, &image);
    CHECK(st_reset(NULL) == ST_NULL_POINTER && st_reset(tracker) == ST_OK);
    CHECK(st_centroids(NULL, &count) == NULL && st_rejections(NULL, &count) == NULL);
    free(block);
}

/* Write a sky file of one star, without patterns and pairs. */
static void put_section(unsigned char *file, int number, const char *name, const char *type,
                        size_t place, uint64_t rows, uint64_t columns, uint32_t dimensions) {
    unsigned char *row = file + 64 + 64 * number;
    const uint64_t shape[3] = {place, rows, columns};
    strcpy((char *)row, name);
    strcpy((char *)row + 24, type);
    memcpy(row + 32, shape, sizeof shape);
    memcpy(row + 56, &dimensions, sizeof dimensions);
}

static unsigned char *one_star(uint64_t *bytes) {
    static const struct {
        const char *name, *type;
        uint64_t rows, columns;
        uint32_t dimensions;
        double number;
    } SECTION[] = {{"sky", "i4", 0, 0, 0, 1},
                   {"epoch_year", "f8", 0, 0, 0, 2026},
                   {"pixel_rad", "f8", 0, 0, 0, 1e-4},
                   {"crowd_rad", "f8", 0, 0, 0, 1e-3},
                   {"pattern_limit", "f8", 0, 0, 0, 6},
                   {"least_rad", "f8", 0, 0, 0, 0},
                   {"most_rad", "f8", 0, 0, 0, 0},
                   {"hip", "i4", 1, 0, 1, 7},
                   {"direction", "f8", 1, 3, 2, 1},
                   {"magnitude", "f8", 1, 0, 1, 2},
                   {"crowded", "b1", 1, 0, 1, 0},
                   {"blended", "b1", 1, 0, 1, 0},
                   {"variation_mag", "f4", 1, 0, 1, 0},
                   {"motion", "f4", 1, 3, 2, 0},
                   {"parallax_rad", "f4", 1, 0, 1, 0},
                   {"cells", "i4", 0, 0, 0, 1},
                   {"start", "i4", 2, 0, 1, -1},
                   {"member", "i4", 1, 0, 1, 0},
                   {"pattern_cells", "i4", 0, 0, 0, 1},
                   {"pattern_start", "i4", 2, 0, 1, -1},
                   {"pattern_member", "i4", 1, 0, 1, 0},
                   {"pair_star", "i4", 0, 0, 1, 0},
                   {"pair_direction", "f8", 0, 3, 2, 0},
                   {"pair_separation", "f8", 0, 0, 1, 0},
                   {"pair_below", "i4", 1, 0, 1, 0},
                   {"pair_member", "i4", 0, 0, 1, 0},
                   {"pair_previous", "i4", 0, 0, 1, 0},
                   {"bright_star", "i4", 0, 0, 1, 0},
                   {"bright_direction", "f8", 0, 3, 2, 0},
                   {"bright_separation", "f8", 0, 0, 1, 0},
                   {"bright_below", "i4", 1, 0, 1, 0},
                   {"bright_member", "i4", 0, 0, 1, 0},
                   {"bright_previous", "i4", 0, 0, 1, 0}};
    const uint32_t sections = sizeof SECTION / sizeof SECTION[0], order = 0x01020304, layout = 1;
    *bytes = 64 + 64 * sections * 2;
    unsigned char *file = aligned_alloc(64, *bytes);
    memset(file, 0, *bytes);
    memcpy(file, "STARRAYS", 8);
    memcpy(file + 8, &order, 4);
    memcpy(file + 16, bytes, 8);
    memcpy(file + 24, &layout, 4);
    memcpy(file + 28, &sections, 4);
    for (uint32_t n = 0; n < sections; ++n) {
        const size_t place = 64 + 64 * (sections + n);
        put_section(file, (int)n, SECTION[n].name, SECTION[n].type, place, SECTION[n].rows,
                    SECTION[n].columns, SECTION[n].dimensions);
        const int32_t whole = (int32_t)SECTION[n].number, ends[2] = {0, 1};
        if (SECTION[n].number == -1) {
            memcpy(file + place, ends, sizeof ends);
        } else if (strcmp(SECTION[n].type, "f8") == 0) {
            memcpy(file + place, &SECTION[n].number, 8);
        } else if (strcmp(SECTION[n].type, "i4") == 0) {
            memcpy(file + place, &whole, 4);
        }
    }
    return file;
}

/* A tracker that tracks and trusts. */
static void tracking(void) {
    const st_camera camera = {512, 512, 900, 900, 255.5, 255.5, {0}, ST_PLUMB_BOB, 0};
    const double rate[3] = {0, 0, 0}, odd[3] = {0, NAN, 0}, exposure_s[2] = {0.2, 0.1};
    st_centroid star;
    st_identified identified = {NAN, NAN, NAN, 7, 0};
    st_observer observer;
    st_hint hint;
    st_tracking known;
    st_trusted trusted;
    st_attitude at;
    st_config config;
    st_fault fault;
    st_sky sky;
    st_tracker *tracker = NULL;
    size_t bytes = 0, count = 7;
    memset(&star, 0, sizeof star);
    memset(&observer, 0, sizeof observer);
    memset(&hint, 0, sizeof hint);
    star.sigma_px = 0.1;
    star.cov_uu_px2 = star.cov_vv_px2 = 0.01;
    sky.file = one_star(&sky.bytes);
    st_defaults(&config, &ABI);
    config.stages = ST_TRACKS | ST_TRUSTS;
    config.capacities.centroids = 3;
    CHECK(st_size(&config, &camera, NULL, &bytes) == ST_NULL_POINTER);
    CHECK(st_size(&config, &camera, &sky, &bytes) == ST_OK && bytes % 64 == 0);
    void *block = aligned_alloc(64, bytes);
    --sky.bytes;
    CHECK(st_create(block, bytes, &config, &camera, &sky, &tracker, &fault) == ST_BAD_SKY);
    CHECK(strcmp(fault.name, "bytes of the file") == 0);
    ++sky.bytes;
    CHECK(st_create(block, bytes - 64, &config, &camera, &sky, &tracker, &fault) ==
          ST_TOO_LITTLE_MEMORY);
    CHECK(st_create(block, bytes, &config, &camera, &sky, &tracker, &fault) == ST_OK);
    CHECK(st_tracks(tracker, &count) != NULL && count == 0);
    CHECK(st_predictions(tracker, &count) == NULL);
    CHECK(st_track(NULL, 1, &star, 1, NULL, &known) == ST_NULL_POINTER);
    CHECK(st_track(tracker, 1, NULL, 1, NULL, &known) == ST_NULL_POINTER);
    CHECK(st_track(tracker, 1, &star, 1, NULL, NULL) == ST_NULL_POINTER);
    CHECK(st_track(tracker, -1, &star, 1, NULL, &known) == ST_BAD_INPUT);
    CHECK(st_track(tracker, 1, &star, 1, exposure_s, &known) == ST_BAD_INPUT);
    CHECK(st_track(tracker, 1, &star, 4, NULL, &known) == ST_TOO_MANY);
    CHECK(st_track(tracker, 5, &star, 1, NULL, &known) == ST_OK);
    CHECK(known.state == ST_LOST && known.reason.code == ST_REASON_WAITING);
    CHECK(!known.attitude.valid && isnan(known.attitude.quaternion[0]));
    CHECK(st_track(tracker, 5, &star, 1, NULL, &known) == ST_NOT_NEWER && known.late_frames == 1);
    star.u_px = NAN;
    CHECK(st_track(tracker, 6, &star, 1, NULL, &known) == ST_OK && known.rejected_centroids == 1);
    star.u_px = 0;
    CHECK(st_add_identification(tracker, 6, &star, NULL, 1, &known) == ST_NULL_POINTER);
    CHECK(st_add_identification(tracker, 6, &star, &identified, 1, &known) == ST_OK);
    CHECK(st_identification_is_due(tracker, 7, ST_LOST, 0) == 1);
    CHECK(st_identification_is_due(tracker, 7, ST_TRACKING, 0) == 0);
    CHECK(st_identification_is_due(tracker, 20000000000, ST_TRACKING, 0) == 1);
    CHECK(st_identification_is_due(tracker, 20000000000, ST_TRACKING, 1) == 0);
    CHECK(st_prepare(NULL) == ST_NULL_POINTER && st_prepare(tracker) == ST_OK);
    CHECK(st_add_rate(tracker, 5, odd) == ST_BAD_INPUT);
    CHECK(st_add_rate(tracker, 5, rate) == ST_OK && st_add_rate(tracker, 4, rate) == ST_NOT_NEWER);
    CHECK(st_add_observer(tracker, 5, NULL) == ST_NULL_POINTER);
    CHECK(st_add_observer(tracker, 5, &observer) == ST_OK);
    observer.body_count = ST_MOST_BODIES + 1;
    CHECK(st_add_observer(tracker, 5, &observer) == ST_BAD_INPUT);
    CHECK(st_add_hint(tracker, &hint) == ST_BAD_INPUT);
    hint.quaternion[3] = 1;
    CHECK(st_add_hint(tracker, &hint) == ST_OK);
    CHECK(st_trust(tracker, 6, NULL, 0, &known.attitude, &trusted) == ST_OK);
    CHECK(trusted.reason.code == ST_REASON_NOT_TRACKED && !trusted.attitude.valid);
    CHECK(st_trust(tracker, 6, NULL, 0, NULL, &trusted) == ST_OK);
    CHECK(trusted.reason.code == ST_REASON_TOO_FEW_STARS);
    CHECK(st_trust_stars(tracker, 6, &star, &identified, 1, &trusted) == ST_OK);
    CHECK(trusted.reason.code == ST_REASON_TOO_FEW_STARS && trusted.reason.figure[0] == 1);
    CHECK(st_residuals(tracker, &count) != NULL && count == 0);
    CHECK(st_attitude_at(&trusted.attitude, 5, &at) == ST_BAD_INPUT);
    config.tracking.max_stars = 50;
    CHECK(st_change_options(tracker, &config, &fault) == ST_OK);
    config.tracking.model = ST_SNA;
    CHECK(st_change_options(tracker, &config, &fault) == ST_READ_ONLY);
    CHECK(strcmp(fault.name, "tracking.model") == 0);
    CHECK(st_reset(tracker) == ST_OK);
    config.stages = ST_TRUSTS;
    CHECK(st_size(&config, &camera, &sky, &count) == ST_OK && count < bytes);
    CHECK(st_create(block, bytes, &config, &camera, &sky, &tracker, &fault) == ST_OK);
    CHECK(st_track(tracker, 1, &star, 1, NULL, &known) == ST_NO_STAGE);
    CHECK(st_add_rate(tracker, 1, rate) == ST_NO_STAGE);
    CHECK(st_tracks(tracker, &count) == NULL && st_predictions(tracker, &count) == NULL);
    config.stages = ST_ALL_STAGES;
    /* The pairs of a sky file are of cameras with pixels like its own. */
    CHECK(st_size(&config, &camera, &sky, &count) == ST_BAD_SKY);
    free(block);
    free((void *)(uintptr_t)sky.file);
}

/* Whole frames, of a tracker whose frames the caller identifies. */
static void frames(void) {
    const st_camera camera = {64, 48, 900, 900, 31.5, 23.5, {0}, ST_PLUMB_BOB, 0};
    const double odd_s[2] = {0.2, 0.1};
    static uint16_t pixels[64 * 48];
    st_image image = {pixels, 128, 64, 48, ST_GREY16, 1, 0};
    st_centroid star;
    st_result result, before;
    st_config config;
    st_sky sky;
    st_tracker *tracker = NULL;
    size_t bytes = 0, count = 7;
    memset(&star, 0, sizeof star);
    memset(&result, 0x5a, sizeof result);
    star.sigma_px = 0.1;
    star.cov_uu_px2 = star.cov_vv_px2 = 0.01;
    sky.file = one_star(&sky.bytes);
    st_defaults(&config, &ABI);
    config.stages = ST_EXTRACTS | ST_TRACKS | ST_TRUSTS;
    config.capacities.centroids = 3;
    CHECK(st_size(&config, &camera, &sky, &bytes) == ST_OK);
    void *block = aligned_alloc(64, bytes);
    CHECK(st_create(block, bytes, &config, &camera, &sky, &tracker, NULL) == ST_OK);
    before = result;
    CHECK(st_process_image(NULL, 1, &image, &result) == ST_NULL_POINTER);
    CHECK(st_process_image(tracker, 1, NULL, &result) == ST_NULL_POINTER);
    CHECK(st_process_image(tracker, 1, &image, NULL) == ST_NULL_POINTER);
    CHECK(st_process_image(tracker, -1, &image, &result) == ST_BAD_INPUT);
    image.width_px = 63;
    CHECK(st_process_image(tracker, 1, &image, &result) == ST_BAD_IMAGE);
    image.width_px = 64;
    CHECK(st_process_centroids(NULL, 1, &star, 1, NULL, 0, &result) == ST_NULL_POINTER);
    CHECK(st_process_centroids(tracker, 1, NULL, 1, NULL, 0, &result) == ST_NULL_POINTER);
    CHECK(st_process_centroids(tracker, 1, &star, 1, NULL, 0, NULL) == ST_NULL_POINTER);
    CHECK(st_process_centroids(tracker, -1, &star, 1, NULL, 0, &result) == ST_BAD_INPUT);
    CHECK(st_process_centroids(tracker, 1, &star, 1, odd_s, 0, &result) == ST_BAD_INPUT);
    CHECK(st_process_centroids(tracker, 1, &star, 4, NULL, 0, &result) == ST_TOO_MANY);
    CHECK(memcmp(&before, &result, sizeof result) == 0);
    CHECK(st_process_image(tracker, 5000000000, &image, &result) == ST_OK && result.used);
    CHECK(result.stamp_ns == 5000000000 && result.reason.code == ST_REASON_BLANK);
    CHECK(!result.attitude.valid && isnan(result.attitude.quaternion[0]));
    CHECK(result.identification.status == ST_NOT_DUE && !result.tracking.attitude.valid);
    CHECK(st_process_centroids(tracker, 5000000001, &star, 1, NULL, 1, &result) == ST_OK);
    CHECK(result.used && result.extraction.centroids == 1 && result.extraction.windowed == 1);
    CHECK(result.reason.code == ST_REASON_WAITING && isnan(result.extraction.noise_dn));
    CHECK(st_process_centroids(tracker, 5000000001, &star, 1, NULL, 0, &result) == ST_OK);
    CHECK(!result.used && result.tracking.late_frames == 1);
    CHECK(result.reason.code == ST_REASON_NOT_NEWER && result.reason.figure[0] == 0);
    CHECK(st_process_image(tracker, 4500000000, &image, &result) == ST_OK && !result.used);
    CHECK(result.reason.figure[0] == 500000001 && result.tracking.late_frames == 2);
    CHECK(st_process_centroids(tracker, 7, &star, 1, NULL, 0, &result) == ST_OK && result.used);
    CHECK(st_process_centroids(tracker, 0, &star, 1, NULL, 0, &result) == ST_OK && !result.used);
    CHECK(result.reason.code == ST_REASON_NOT_STAMPED);
    CHECK(st_known(NULL, &result.tracking) == ST_NULL_POINTER);
    CHECK(st_known(tracker, &result.tracking) == ST_OK && result.tracking.late_frames == 3);
    CHECK(st_searched_centroids(tracker, &count) == NULL && count == 0);
    config.stages = ST_EXTRACTS | ST_TRACKS;
    CHECK(st_create(block, bytes, &config, &camera, &sky, &tracker, NULL) == ST_OK);
    CHECK(st_process_image(tracker, 1, &image, &result) == ST_NO_STAGE);
    config.stages = ST_TRACKS | ST_TRUSTS;
    CHECK(st_create(block, bytes, &config, &camera, &sky, &tracker, NULL) == ST_OK);
    CHECK(st_process_image(tracker, 1, &image, &result) == ST_NO_STAGE);
    CHECK(st_process_centroids(tracker, 1, &star, 1, NULL, 0, &result) == ST_OK);
    free(block);
    free((void *)(uintptr_t)sky.file);
}

static void texts(void) {
    for (int status = 0; status <= ST_STATUS_COUNT; ++status) {
        CHECK(strlen(st_status_text((st_status)status)) > 1);
    }
    CHECK(strstr(st_build_text(), "interface 3") != NULL);
}

int main(void) {
    versions();
    options();
    cameras();
    lists();
    trackers();
    tracking();
    frames();
    texts();
    printf("interface: %d failures\n", failures);
    return failures != 0;
}
