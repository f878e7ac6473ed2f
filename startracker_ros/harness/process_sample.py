"""What the system says that a process holds: memory, handles, threads, processor time."""

from dataclasses import dataclass
import os
from pathlib import Path
import re

_MIB = 2 ** 20


@dataclass(frozen=True)
class ProcessSample:
    """Memory of its own in MiB, without what is shared; open handles, threads, CPU time in s."""

    private_mib: float
    handles: int
    threads: int
    cpu_s: float


def sample_process(pid: int) -> ProcessSample:
    """Return what a process of this user holds now (Linux)."""
    folder = Path(f'/proc/{pid}')
    rollup = (folder / 'smaps_rollup').read_text()
    private_kib = sum(int(number) for number in re.findall(
        r'^Private_(?:Clean|Dirty):\s+(\d+) kB', rollup, re.MULTILINE))
    fields = (folder / 'stat').read_text().rpartition(')')[2].split()
    return ProcessSample(
        private_kib * 1024 / _MIB, len(os.listdir(folder / 'fd')), int(fields[17]),
        (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK'))


def shared_memory_mib(pids: list[int]) -> float:
    """Return the size of all files in /dev/shm that processes have mapped."""
    files = {line.split()[-1] for pid in pids
             for line in Path(f'/proc/{pid}/maps').read_text().splitlines()
             if '/dev/shm/' in line and not line.endswith('(deleted)')}
    return sum(os.stat(file).st_size for file in files if os.path.exists(file)) / _MIB
