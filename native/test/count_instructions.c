// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * A plugin for qemu-user: at each call of write(-1, ...) the instructions so far, a line each, in the
 * log (-d plugin -D FILE -plugin ./count_instructions.so). The interface is that of qemu-plugin.h, of
 * which Debian has no package.
 */

#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#define EXPORT __attribute__((visibility("default")))

typedef uint64_t plugin_id;
typedef struct qemu_plugin_tb block;
size_t qemu_plugin_tb_n_insns(const block *tb);
void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id id, void (*call)(plugin_id, block *));
void qemu_plugin_register_vcpu_tb_exec_inline(block *tb, int operation, void *to, uint64_t add);
void qemu_plugin_register_vcpu_syscall_cb(plugin_id id,
                                          void (*call)(plugin_id, unsigned, int64_t, uint64_t,
                                                       uint64_t, uint64_t, uint64_t, uint64_t,
                                                       uint64_t, uint64_t, uint64_t));
void qemu_plugin_outs(const char *text);

EXPORT extern int qemu_plugin_version;
int qemu_plugin_version = 1;

static uint64_t instructions;

static void translated(plugin_id id, block *tb) {
    (void)id;
    qemu_plugin_register_vcpu_tb_exec_inline(tb, 0, &instructions, qemu_plugin_tb_n_insns(tb));
}

static void called(plugin_id id, unsigned cpu, int64_t number, uint64_t file, uint64_t b,
                   uint64_t c, uint64_t d, uint64_t e, uint64_t f, uint64_t g, uint64_t h) {
    (void)id, (void)cpu, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h;
    const int write = number == 1 || number == 64; /* of x86-64, of aarch64 */
    if (write && (int32_t)file == -1) {
        char text[32];
        snprintf(text, sizeof text, "%" PRIu64 "\n", instructions);
        qemu_plugin_outs(text);
    }
}

EXPORT int qemu_plugin_install(plugin_id id, const void *info, int count, char **arguments) {
    (void)info, (void)count, (void)arguments;
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_vcpu_syscall_cb(id, called);
    return 0;
}
