// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* Wrong use of the interface gets a status and changes nothing. Exit status 1 if any does not. */

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "startracker.h"

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
    camera.model = ST_EQUIDISTANT; /* more than straight back */
    camera.fx_px = camera.fy_px = 100;
    CHECK(st_check_camera(&camera, &fault) == ST_BAD_CAMERA);
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

static void texts(void) {
    for (int status = 0; status <= ST_STATUS_COUNT; ++status) {
        CHECK(strlen(st_status_text((st_status)status)) > 1);
    }
    CHECK(strstr(st_build_text(), "interface 1") != NULL);
}

int main(void) {
    versions();
    options();
    cameras();
    lists();
    texts();
    printf("interface: %d failures\n", failures);
    return failures != 0;
}
