// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "json.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *path_of_text;

static void fail(const char *what) {
    fprintf(stderr, "%s: %s\n", path_of_text, what);
    exit(2);
}

static void *allocated(size_t bytes) {
    void *memory = calloc(1, bytes);
    if (memory == NULL) {
        fail("no memory");
    }
    return memory;
}

static const char *without_space(const char *at) {
    return at + strspn(at, " \t\r\n");
}

/* Escapes do not occur in the corpus. */
static char *read_text(const char **at) {
    const char *begin = *at + 1, *end = strchr(begin, '"');
    if (**at != '"' || end == NULL || memchr(begin, '\\', (size_t)(end - begin)) != NULL) {
        fail("expected a text without escapes");
    }
    char *text = allocated((size_t)(end - begin) + 1);
    memcpy(text, begin, (size_t)(end - begin));
    *at = end + 1;
    return text;
}

static json *read_value(const char **at);

static void read_members(const char **at, json *value, char closing) {
    json **last = &value->first;
    *at = without_space(*at + 1);
    while (**at != closing) {
        char *name = NULL;
        if (closing == '}') {
            name = read_text(at);
            *at = without_space(*at);
            if (*(*at)++ != ':') {
                fail("expected a colon");
            }
        }
        *last = read_value(at);
        (*last)->name = name;
        last = &(*last)->next;
        ++value->count;
        *at = without_space(*at);
        if (**at == ',') {
            *at = without_space(*at + 1);
        } else if (**at != closing) {
            fail("expected a comma or the end of a list");
        }
    }
    ++*at;
}

static json *read_value(const char **at) {
    static const char *const WORDS[] = {"null", "false", "true"};
    json *value = allocated(sizeof(json));
    *at = without_space(*at);
    for (int word = 0; word < 3; ++word) {
        size_t length = strlen(WORDS[word]);
        if (strncmp(*at, WORDS[word], length) == 0) {
            value->kind = (json_kind)word;
            *at += length;
            return value;
        }
    }
    if (**at == '{' || **at == '[') {
        value->kind = **at == '{' ? JSON_OBJECT : JSON_LIST;
        read_members(at, value, **at == '{' ? '}' : ']');
    } else if (**at == '"') {
        value->kind = JSON_TEXT;
        value->text = read_text(at);
    } else {
        char *end;
        value->kind = JSON_NUMBER;
        value->number = strtod(*at, &end);
        if (end == *at) {
            fail("expected a value");
        }
        *at = end;
    }
    return value;
}

json *json_read(const char *path) {
    path_of_text = path;
    FILE *file = fopen(path, "rb");
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) {
        fail("cannot be read");
    }
    long bytes = ftell(file);
    rewind(file);
    char *text = allocated((size_t)bytes + 1);
    if (fread(text, 1, (size_t)bytes, file) != (size_t)bytes) {
        fail("cannot be read");
    }
    fclose(file);
    const char *at = text;
    json *value = read_value(&at);
    if (*without_space(at) != '\0') {
        fail("something follows the document");
    }
    free(text);
    return value;
}

void json_free(json *value) {
    while (value != NULL) {
        json *next = value->next;
        json_free(value->first);
        free(value->text);
        free(value->name);
        free(value);
        value = next;
    }
}

const json *json_member(const json *object, const char *name) {
    const json *member = object == NULL ? NULL : object->first;
    while (member != NULL && (member->name == NULL || strcmp(member->name, name) != 0)) {
        member = member->next;
    }
    return member;
}

static size_t copy_numbers(const json *value, double *numbers) {
    if (value->kind != JSON_LIST) {
        if (numbers != NULL) {
            *numbers = value->kind == JSON_NUMBER ? value->number
                       : value->kind == JSON_NULL ? NAN
                                                  : (double)(value->kind == JSON_TRUE);
        }
        return 1;
    }
    size_t count = 0;
    for (const json *member = value->first; member != NULL; member = member->next) {
        count += copy_numbers(member, numbers == NULL ? NULL : numbers + count);
    }
    return count;
}

double *json_numbers(const json *value, size_t *count) {
    *count = copy_numbers(value, NULL);
    double *numbers = allocated((*count + 1) * sizeof(double));
    copy_numbers(value, numbers);
    return numbers;
}
