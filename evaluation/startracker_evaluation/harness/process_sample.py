# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a process uses: memory, file descriptors, threads, processor time."""

from dataclasses import dataclass
import os

import psutil

_MIB = 2 ** 20


@dataclass(frozen=True)
class ProcessSample:
    """
    Memory in MiB, open handles, threads, CPU time in s.

    private_mib is what is of its own alone, proportional_mib (Pss) that and its part of what
    several processes share.
    """

    private_mib: float
    proportional_mib: float
    handles: int
    threads: int
    cpu_s: float


def sample_process(pid: int) -> ProcessSample:
    """Return what a process of this user uses now."""
    process = psutil.Process(pid)
    cpu, memory = process.cpu_times(), process.memory_full_info()
    return ProcessSample(memory.uss / _MIB, memory.pss / _MIB, process.num_fds(),
                         process.num_threads(), cpu.user + cpu.system)


def shared_memory_mib(pids: list[int]) -> float:
    """Return the size of all files in /dev/shm that processes have mapped."""
    files = {mapped.path for pid in pids for mapped in psutil.Process(pid).memory_maps()
             if mapped.path.startswith('/dev/shm/')}
    return sum(os.stat(file).st_size for file in files if os.path.exists(file)) / _MIB
