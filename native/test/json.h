// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* A reader of JSON for the conformance corpus; a file that is not JSON ends the program. */

#ifndef STARTRACKER_TEST_JSON_H
#define STARTRACKER_TEST_JSON_H

#include <stddef.h>

typedef enum {
    JSON_NULL,
    JSON_FALSE,
    JSON_TRUE,
    JSON_NUMBER,
    JSON_TEXT,
    JSON_LIST,
    JSON_OBJECT
} json_kind;

/* Members of lists and objects are chained by next; name is that in an object. */
typedef struct json {
    json_kind kind;
    double number;
    char *text, *name;
    struct json *first, *next;
    size_t count;
} json;

json *json_read(const char *path);
void json_free(json *value);

/* The member of an object; null where it has none of this name. */
const json *json_member(const json *object, const char *name);

/* All numbers of a value, of lists in lists too, one after another; NaN for null, 0 and 1 for
 * false and true. The caller frees them. */
double *json_numbers(const json *value, size_t *count);

#endif
