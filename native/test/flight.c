// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * flight SKY RECORDING: what each frame of a recording takes of a flight computer. A line for each:
 * nanoseconds, bytes of stack, whether stars were predicted, state. RECORDING has st_config, st_camera,
 * st_pixel_type and number of frames, then stamp and pixels of each.
 */

#define _POSIX_C_SOURCE 200809L  // clock_gettime, write

#include <inttypes.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "startracker.h"

enum { STACK = 1 << 20, PAINT = 0xA5 };

static _Alignas(4096) uint8_t stack[STACK];
static FILE *recording;
static st_tracker *tracker;
static st_camera camera;
static int32_t kind[2]; /* type, frames */

static void check(int holds, const char *what) {
    if (!holds) {
        fprintf(stderr, "flight: %s\n", what);
        exit(2);
    }
}

static void read_all(void *into, size_t bytes) {
    check(fread(into, 1, bytes, recording) == bytes, "the recording is too short");
}

/* For count_instructions.c: what is between two calls is counted. */
static void mark(void) {
    check(write(-1, "", 0) < 0, "mark");
}

static int64_t now_ns(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec * INT64_C(1000000000) + time.tv_nsec;
}

static void *fly(void *nothing) {
    static st_result result;
    const size_t row_bytes = (size_t)camera.width_px << kind[0],
                 bytes = row_bytes * (size_t)camera.height_px;
    uint8_t *pixels = malloc(bytes);
    const st_image image = {
        pixels, (int64_t)row_bytes, camera.width_px, camera.height_px, kind[0], 1, 0};
    for (int32_t frame = 0; frame < kind[1]; ++frame) {
        int64_t stamp_ns;
        uint8_t here = 0;
        read_all(&stamp_ns, sizeof stamp_ns);
        read_all(pixels, bytes);
        /* The stack grows down; what is called from here on takes what is below. */
        const size_t unused = (size_t)(&here - stack) - 1024;
        memset(stack, PAINT, unused);
        const int64_t begin_ns = now_ns();
        mark();
        const st_status status = st_process_image(tracker, stamp_ns, &image, &result);
        mark();
        const int64_t took_ns = now_ns() - begin_ns;
        check(status == ST_OK, st_status_text(status));
        size_t deepest = 0;
        while (deepest < unused && stack[deepest] == PAINT) {
            ++deepest;
        }
        printf("%" PRId64 " %zu %d %d\n", took_ns, unused + 1024 - deepest,
               result.extraction.windowed, result.tracking.state);
    }
    free(pixels);
    return nothing;
}

int main(int count, char **arguments) {
    static st_config config;
    pthread_attr_t attributes;
    pthread_t thread;
    st_sky sky;
    size_t bytes = 0;
    check(count == 3, "usage: flight SKY RECORDING");
    recording = fopen(arguments[1], "rb");
    check(recording != NULL && fseek(recording, 0, SEEK_END) == 0, "there is no such sky file");
    sky.bytes = (uint64_t)ftell(recording);
    void *file = aligned_alloc(64, sky.bytes);
    rewind(recording);
    read_all(file, sky.bytes);
    sky.file = file;
    fclose(recording);
    recording = fopen(arguments[2], "rb");
    check(recording != NULL, "there is no such recording");
    read_all(&config, sizeof config);
    read_all(&camera, sizeof camera);
    read_all(kind, sizeof kind);
    st_status status = st_check_sky(&sky, NULL);
    status = status ? status : st_size(&config, &camera, &sky, &bytes);
    check(status == ST_OK, st_status_text(status));
    void *memory = aligned_alloc(64, bytes);
    check(st_create(memory, bytes, &config, &camera, &sky, &tracker, NULL) == ST_OK, "st_create");
    pthread_attr_init(&attributes);
    check(pthread_attr_setstack(&attributes, stack, STACK) == 0, "stack");
    check(pthread_create(&thread, &attributes, fly, NULL) == 0, "thread");
    pthread_join(thread, NULL);
    fclose(recording);
    free(memory);
    free(file);
    return 0;
}
