// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * main SKY FOCAL_PX PERIOD_S IMAGE.pgm ...: images of one camera, in the order in which they were
 * taken, to attitudes. SKY is of `startracker sky`. The lens is without distortion, and without an
 * observer (st_add_observer) attitudes are off by the aberration, up to 26 arcsec in orbit.
 */

#include <stdio.h>
#include <stdlib.h>

#include "startracker.h"

static void check(int holds, const char *what, const char *why) {
    if (!holds) {
        fprintf(stderr, "%s: %s\n", what, why);
        exit(2);
    }
}

/* Read a file, of a binary PGM of 8 bits the pixels. */
static void *read_file(const char *path, st_image *pgm, uint64_t *bytes) {
    FILE *file = fopen(path, "rb");
    check(file && (!pgm || fscanf(file, "P5 %d %d 255%*c", &pgm->width_px, &pgm->height_px) == 2),
          path, "is missing, or no binary PGM of 8 bits");
    const long begin = ftell(file);
    fseek(file, 0, SEEK_END);
    *bytes = (uint64_t)(ftell(file) - begin);
    void *content = aligned_alloc(64, *bytes);
    fseek(file, begin, SEEK_SET);
    check(content && fread(content, 1, *bytes, file) == *bytes, path, "cannot be read");
    fclose(file);
    return content;
}

static void print(const char *name, const double *number, int count) {
    printf(" %s", name);
    for (int i = 0; i < count; ++i) {
        printf(" %.17g", number[i]);
    }
}

int main(int count, char **arguments) {
    static const st_abi ABI = ST_ABI;
    static st_config config;
    static st_result result; /* of several kB */
    st_image image = {.type = ST_GREY8, .cell = 1};
    st_camera camera = {.model = ST_PLUMB_BOB};
    st_fault fault = {.name = "sky or camera"};
    st_tracker *tracker = NULL;
    st_sky sky;
    size_t bytes = 0;
    check(count > 4, "usage", "main SKY FOCAL_PX PERIOD_S IMAGE.pgm ...");
    sky.file = read_file(arguments[1], NULL, &sky.bytes);
    free(read_file(arguments[4], &image, &(uint64_t){0}));
    camera.width_px = image.width_px, camera.height_px = image.height_px;
    camera.cx_px = image.width_px / 2.0 - 0.5, camera.cy_px = image.height_px / 2.0 - 0.5;
    camera.fx_px = camera.fy_px = atof(arguments[2]);
    st_status status = st_check_sky(&sky, &fault);
    status = status ? status : st_defaults(&config, &ABI);
    status = status ? status : st_size(&config, &camera, &sky, &bytes);
    void *memory = aligned_alloc(64, bytes); /* flight software has a static array */
    status = status ? status : st_create(memory, bytes, &config, &camera, &sky, &tracker, &fault);
    check(status == ST_OK, fault.name, st_status_text(status));
    for (int i = 4; i < count; ++i) {
        image.pixels = read_file(arguments[i], &image, &(uint64_t){0});
        image.stride_bytes = image.width_px;
        status =
            st_process_image(tracker, (int64_t)(1e9 * atof(arguments[3]) * i), &image, &result);
        check(status == ST_OK, arguments[i], st_status_text(status));
        printf("reason %d", result.reason.code);
        print("quaternion", result.attitude.quaternion, 4);
        print("covariance_rad2", result.attitude.covariance_rad2[0], 9);
        print("protection_rad", result.attitude.protection_rad, 3);
        printf("\n");
        free((void *)(uintptr_t)image.pixels);
    }
}
