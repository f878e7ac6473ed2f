# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every command as a stranger meets it: help, wrong files, full disks, Ctrl-C, pipes, JSON."""

from contextlib import contextmanager
from importlib import import_module
import json
import os
from pathlib import Path
import re
import resource
import signal
import subprocess
import sys
import time

import click
from commands import invoke
import cv2
from limits import HANGS_S
import numpy as np
import pytest
from startracker_ros.command_line import main
from startracker_ros.commands_page import PAGE, page_text
from startracker_ros.io.workers import cluster

ROOT = Path(__file__).parents[1]
BAG = str(ROOT / 'bags' / 'slew')
IMAGES = sorted(map(str, (ROOT / 'test' / 'data' / 'night-sky-11deg').glob('*.png')))[:3]
SMALL_BYTES = 100


def commands(command=main, names=()):
    """Yield the names and the object of all commands, groups included."""
    yield names, command
    for name, each in getattr(command, 'commands', {}).items():
        yield from commands(each, (*names, name))


ALL = dict(commands())
LEAVES = {names: command for names, command in ALL.items()
          if not isinstance(command, click.Group)}
# What reads files: FILE is replaced by one that is not there, is no such file, or is a folder.
READERS = [
    ['solve', 'FILE', '--fov-deg', '11.4'],
    ['solve', IMAGES[0], '--camera', 'FILE'],
    ['solve', IMAGES[0], '--catalogue', 'FILE'],
    ['catalogue', 'FILE', '--epoch', '2016', '-o', 'out'],
    ['calibrate', 'FILE', '--fov-deg', '11.4', '-o', 'out.yaml'],
    ['calibrate', IMAGES[0], '--camera', 'FILE', '-o', 'out.yaml'],
    ['info', 'FILE'], ['report', 'FILE'], ['export', 'FILE'], ['play', 'FILE'],
    ['reprocess', 'FILE'], ['reprocess', BAG, '--parameters', 'FILE'], ['compare', 'FILE', 'FILE'],
    ['trend', 'FILE'], ['tracklets', 'FILE'], ['telemetry', 'decode', 'FILE'],
    ['datasheet', '--camera', 'FILE'], ['datasheet', '--optics', 'FILE'],
    ['live', '--device', 'FILE', '--seconds', '1'], ['live', '--camera', 'FILE'],
    ['night', BAG, '--camera', 'FILE']]
# These are right or wrong whatever the file is.
READERS_OF_MISSING = [
    ['doctor', '--camera', 'FILE'], ['night', 'FILE'],
    ['campaign', 'centroid', '--images', 'FILE'],
    ['bench', 'real-sky', 'FILE'], ['bench', 'lost-in-space', '--cedar-python', 'FILE'],
    ['catalogue', IMAGES[0], 'FILE', '-o', 'out'], ['compare', BAG, 'FILE']]
# Each is wrong by what it says alone.
WRONG = [
    ['fly'], ['solve'], ['run', 'rocket'], ['solve', IMAGES[0], '--fov-deg', '400'],
    ['solve', IMAGES[0], '--fov-deg', '11', '--camera', IMAGES[0]],
    ['solve', IMAGES[0], '--epoch', 'noon'], ['solve', IMAGES[0], '--epoch', '1.78e9'],
    ['solve', IMAGES[0], '--near', '1', '2'], ['solve', IMAGES[0], '--frames', 'all'],
    ['solve', IMAGES[0], '--site', '98', '11', '500'],
    ['solve', IMAGES[0], '--velocity', '0', '21', '0'], ['calibrate', IMAGES[0], '-o', 'c.yaml'],
    ['calibrate', IMAGES[0], '-o', 'c.yaml', '--fov-deg', '9', '--site', '1', '2', '3'],
    ['night', str(ROOT / 'test'), '--interval-s', '1'], ['play', BAG, '--rate', '0'],
    ['export', BAG, '--format', 'pdf'], ['demo', '--seconds', '1'], ['campaign', 'nothing']]
HEAVY = {'cv2', 'erfa', 'matplotlib', 'numpy', 'rclpy', 'rich', 'scipy'}
# What writes without long work; the output is OUT.
WRITERS = {
    'solve --annotate': ['solve', IMAGES[0], '--fov-deg', '11.4', '--annotate', 'OUT'],
    'solve --wcs': ['solve', IMAGES[0], '--fov-deg', '11.4', '--wcs', 'OUT'],
    'calibrate': ['calibrate', *IMAGES, '--fov-deg', '11.4', '-o', 'OUT'],
    'report': ['report', BAG, '-o', 'OUT'],
    'export': ['export', BAG, '-o', 'OUT'],
    'simulate': ['simulate', '--workers', '1', '--set', 'days=0.001', '-o', 'OUT'],
}
# Those that find out before long work that there is no place for their output.
EARLY = [['datasheet', '--quick'], ['campaign', 'jpdaf'], ['campaign', 'extended-grid'],
         ['campaign', 'two-satellite'], ['demo'], ['demo', 'heads'], ['demo', 'two-satellite'],
         ['live', '--device', IMAGES[0]], ['record']]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Run in an empty folder, on a terminal of 80 columns."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('COLUMNS', '80')
    return tmp_path


def startracker(*arguments, **options):
    """Run a command in this process; it ends with a status, not with a traceback."""
    done = invoke(*arguments, **options)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exc_info
    assert 'Traceback' not in done.stderr
    return done


def assert_failed(done, *statuses):
    """Assert the status, and that the last line on stderr says why."""
    assert done.exit_code in statuses, (done.exit_code, done.output)
    line = done.stderr.rstrip().splitlines()[-1]
    assert line.startswith(('startracker: ', 'Error: ')), done.stderr
    assert not re.search(r'Error\(|<class|object at 0x|NoneType', line), line


@pytest.mark.parametrize('columns', [60, 200])
@pytest.mark.parametrize('names', ALL, ids=lambda names: ' '.join(names) or 'startracker')
def test_help_fits_and_explains_every_option(names, columns):
    done = startracker(*names, '--help', terminal_width=columns)
    assert done.exit_code == 0 and done.stdout.startswith('Usage: ')
    # Lines of an example are whole.
    assert max(len(line) for line in done.stdout.splitlines() if 'startracker ' not in line
               ) <= columns
    assert '...\n' not in re.sub(r'\[ARGS\]\.\.\.|\S+\.\.\.', '', done.stdout)
    for option in ALL[names].params:
        if isinstance(option, click.Option):
            assert re.sub(r'\[default.*?\]', '', option.help or '').strip(), option.opts


@pytest.mark.parametrize('names', [names for names, command in ALL.items() if any(
    each.required for each in command.params) or isinstance(command, click.Group) and not
    command.invoke_without_command], ids=lambda names: ' '.join(names) or 'startracker')
def test_without_arguments_the_usage_is_shown(names):
    done = startracker(*names)
    assert done.exit_code == 2 and done.stderr.startswith('Usage: ')


TYPES = {'FLOAT', 'INTEGER', 'TEXT', 'PATH', 'RANGE', 'FLOAT...'}


@pytest.mark.parametrize('names', LEAVES, ids=' '.join)
def test_a_metavar_says_what_and_not_which_type(names):
    with click.Context(LEAVES[names]) as context:
        for option in LEAVES[names].get_params(context):
            if isinstance(option, click.Option):
                shown, _ = option.get_help_record(context)
                assert not TYPES & {*shown.split()}, shown


@pytest.mark.parametrize('names, module, options', [
    (['live'], 'io.images.capture', 'CaptureOptions'),
    (['reprocess'], 'tools.reprocess.plan', 'SegmentOptions'),
    (['sky'], 'core.identify.identification', 'IdentificationOptions')])
def test_ranges_are_those_of_the_options(names, module, options):
    rows = {row.name: row for row in getattr(
        import_module(f'startracker_ros.{module}'), options).table()}
    ranges = {option.name: option.type for option in LEAVES[*names,].params
              if option.name in rows and rows[option.name].low is not None}
    assert len(ranges) >= 2
    for name, kind in ranges.items():
        assert (kind.min, kind.max) == (rows[name].low, rows[name].high), name


def test_the_commands_are_listed_in_groups_a_line_each():
    lines = startracker('--help', terminal_width=80).stdout.splitlines()
    sections = re.split(r'\n\n(\w+):\n', '\n'.join(lines))[1:]
    assert sections[::2] == ['Options', 'Photographs', 'Pipeline', 'Bags', 'Evaluation', 'Help']
    listed = [line.split()[0] for section in sections[3::2] for line in section.splitlines()]
    assert sorted(listed) == sorted(main.every()) and max(map(len, lines)) < 80


@pytest.mark.parametrize('words, completed', [
    ('startracker run star_', ['star_identifier', 'star_tracker']),
    ('startracker dat', ['datasheet']), ('startracker solve --near', ['--near'])])
def test_tab_completes_nodes_commands_and_options(words, completed):
    done = startracker(env={'_STARTRACKER_COMPLETE': 'bash_complete', 'COMP_WORDS': words,
                            'COMP_CWORD': str(len(words.split()) - 1)}, prog_name='startracker')
    assert done.stdout.split() == [f'plain,{word}' for word in completed]


def test_the_reference_of_the_commands_is_current():
    assert (ROOT / PAGE).read_text() == page_text(), \
        'run python -m startracker_ros.commands_page'


def test_solve_without_arguments_shows_examples():
    examples = startracker('solve').stderr.split('Examples:\n')[1].splitlines()
    assert len(examples) == 3
    assert all(line.strip().startswith('startracker solve ') for line in examples)
    assert max(map(len, examples)) < 80


def test_a_node_lists_its_parameters():
    done = startracker('run', 'bag_player', '--help')
    assert done.exit_code == 0
    assert 'startracker run bag_player' in done.stdout and 'start_offset_s' in done.stdout
    for node in ('star_tracker', 'star_identifier'):
        assert f'parameters of {node}' in startracker('run', 'composed_pipeline', '-h').stdout


def test_every_output_has_the_same_short_option():
    for names, command in LEAVES.items():
        for option in command.params:
            if '--output' in option.opts:
                assert '-o' in option.opts, names


@pytest.mark.parametrize('kind', ['missing', 'text', 'folder'])
@pytest.mark.parametrize('line', READERS, ids=lambda line: ' '.join(
    Path(word).name for word in line))
def test_a_wrong_file_is_one_line(folder, capfd, line, kind):
    file = folder / 'in' / {'missing': 'nothing.png', 'text': 'notes.png', 'folder': 'empty'}[kind]
    (folder / 'in' / 'empty').mkdir(parents=True)
    (folder / 'in' / 'notes.png').write_text('notes, 42')
    line = [str(file) if word == 'FILE' else word for word in line]
    done = startracker(*line)
    # Nothing of OpenCV or another library in addition to it.
    assert capfd.readouterr().err == ''
    if kind == 'missing':
        assert done.exit_code == 1 and done.stdout == ''
        assert done.stderr == f'startracker: {file}: No such file or directory\n'
        return
    if line[:2] == ['solve', str(file)] and kind != 'folder':
        assert done.exit_code == 1 and file.name in done.stdout
        return
    assert_failed(done, 1, 2)
    assert file.name in ' '.join(done.stderr.split())
    assert {path.name for path in folder.iterdir()} <= {'in', 'live', 'reprocessed'}


@pytest.mark.parametrize('line', READERS_OF_MISSING, ids=' '.join)
def test_a_missing_file_is_the_same_line_everywhere(line):
    done = startracker(*(word.replace('FILE', 'no/such') for word in line))
    assert (done.exit_code, done.stdout) == (1, '')
    assert done.stderr == 'startracker: no/such: No such file or directory\n'


def test_a_missing_file_among_others_is_a_row_of_its_own():
    done = startracker('solve', 'no.png', IMAGES[0], '--fov-deg', '11.4', '--json')
    rows = json.loads(done.stdout)['rows']
    assert done.exit_code == 1 and [row['solved'] for row in rows] == [False, True]
    assert rows[0]['reason'] == 'no.png: No such file or directory'


def test_help_and_wrong_arguments_load_nothing(folder):
    lines = [[*names, '--help'] for names in ALL] + WRONG + [
        [word.replace('FILE', 'no/such') for word in line] for line in READERS]
    code = ('import contextlib, json, sys\nfrom startracker_ros.command_line import main\n'
            'for line in json.loads(sys.argv[1]):\n'
            '    with contextlib.suppress(SystemExit):\n'
            '        main(line)\n'
            f'    loaded = {HEAVY} & set(sys.modules)\n'
            '    assert not loaded, (line, loaded)\n')
    done = subprocess.run([sys.executable, '-c', code, json.dumps(lines)], capture_output=True,
                          text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr[-2000:]
    # The help pages, and one line for each of the others.
    assert done.stdout.count('Usage: ') == len(ALL)
    assert done.stderr.count('Error: ') + done.stderr.count('startracker: ') >= len(lines) - len(
        ALL) - 2


@pytest.mark.parametrize('line', [['--help'], ['solve', '--help'], ['solve', 'nofile'],
                                  ['solve', IMAGES[0], '--epoch', 'noon']], ids=' '.join)
def test_help_and_wrong_arguments_take_little_time(line):
    def cpu_s(*command):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                       timeout=HANGS_S)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    # As many times the start of a program that only parses arguments: machines differ.
    startracker_s, click_s = (
        min(cpu_s(sys.executable, *arguments) for _ in range(5))
        for arguments in (['-m', 'startracker_ros', *line], ['-c', 'import click']))
    assert startracker_s <= 5 * click_s


def test_a_pipe_gets_lines_of_progress_and_a_document_none(monkeypatch):
    monkeypatch.setattr('startracker_ros.io.progress.EVERY_S', 0.002)
    line = ['solve', *IMAGES[:2], '--fov-deg', '11.4']
    done = startracker(*line)
    for number, path in enumerate(map(Path, IMAGES[:2]), 1):
        assert re.search(rf'^solve: {path.name}, {number} of 2, \d+ s$', done.stderr,
                         re.MULTILINE), done.stderr
    assert 'of 2,' not in done.stdout and startracker(*line, '--json').stderr == ''


def test_solve_says_what_it_took_and_wrote():
    line = ['solve', *IMAGES[:2], '--fov-deg', '11.4', '--annotate', 'a', '--wcs', 'w', '--json']
    done = startracker(*line)
    document = json.loads(done.stdout)
    for row, path in zip(document['rows'], map(Path, IMAGES)):
        # Of the first one, too: it does not count the loading of code.
        assert row['cpu_ms'] > 0 and 0 < row['solve_ms'] < 5000
        assert row['solved'] and row['reason'] == ''
        assert row['written'] == [f'a/{path.stem}.png', f'w/{path.stem}.wcs']
        assert all(Path(file).is_file() for file in row['written'])
    assert document['conditions']['written'].split(', ') == [
        file for row in document['rows'] for file in row['written']]
    done = startracker('solve', *IMAGES, '--fov-deg', '11.4', '--annotate', 'a', '--wcs', 'w')
    assert 'written: 3 files in a, 3 files in w' in done.stdout


@pytest.mark.parametrize('line', [
    ['info', 'nothing'], ['solve'], ['solve', 'nothing'], ['trend', 'nothing'],
    ['campaign', 'nothing'], ['bench', 'pipeline', '--only', 'nothing'],
    ['report', BAG, '-o', 'nothing/report.html']], ids=' '.join)
def test_an_error_with_json_is_a_document(line):
    done = startracker(*line, '--json')
    document = json.loads(done.stdout)
    assert document['status'] == done.exit_code > 0
    assert document['error'] and document['rows'] == [] and document['conditions'] == {}
    assert ' '.join(line).startswith(document['name'])
    assert_failed(done, 1, 2)


@contextmanager
def small_files():
    """Let no file grow, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL_BYTES, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def content(folder):
    return {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}


@pytest.mark.parametrize('name', [name for name in WRITERS if name != 'simulate'])
def test_an_output_is_whole_or_not_there(folder, name):
    output = folder / 'out'
    line = [str(output) if word == 'OUT' else word for word in WRITERS[name]]
    done = startracker(*line, '--json')
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert {'name', 'conditions', 'rows'} <= set(document) and document['rows']
    before = content(folder)
    assert before and max(map(len, before.values())) > SMALL_BYTES
    with small_files():
        done = startracker(*line)
    assert_failed(done, 1)
    assert 'File too large' in done.stderr
    # What was there before is, and nothing else.
    assert content(folder) == before


@pytest.mark.parametrize('name', WRITERS)
def test_a_place_that_cannot_be_is_one_line(folder, name):
    (folder / 'file').write_text('a file')
    done = startracker(*['file/out' if word == 'OUT' else word for word in WRITERS[name]])
    assert_failed(done, 1)
    assert 'file/out: ' in done.stderr
    assert content(folder) == {folder / 'file': b'a file'}


@pytest.mark.parametrize('line', EARLY, ids=lambda line: ' '.join(
    Path(word).name for word in line))
def test_long_work_begins_when_there_is_a_place_for_its_output(folder, line):
    (folder / 'file').write_text('a file')
    done = startracker(*line, '-o', 'file/out')
    assert_failed(done, 1)
    assert 'file' in done.stderr


def test_a_device_is_written_and_not_replaced():
    done = startracker('report', BAG, '-o', '/dev/full')
    assert_failed(done, 1)
    assert '/dev/full: No space left on device' in done.stderr
    assert startracker('report', BAG, '-o', '/dev/null').exit_code == 0
    assert Path('/dev/null').is_char_device() and Path('/dev/full').is_char_device()


def test_ctrl_c_is_status_130(monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt
    monkeypatch.setattr('startracker_ros.io.bags.info.describe', interrupted)
    done = startracker('info', BAG)
    assert done.exit_code == 130 and done.stdout == ''
    assert done.stderr.split('\n')[-2] == 'startracker: stopped'


@pytest.fixture
def process():
    """Return a function that starts a command, in a session of its own that ends with the test."""
    started = []

    def start(*arguments, **options):
        started.append(subprocess.Popen(
            [sys.executable, '-m', 'startracker_ros', *arguments], stderr=subprocess.PIPE,
            text=True, env=dict(os.environ), start_new_session=True, **options))
        return started[-1]
    yield start
    for each in started:
        if each.poll() is None:
            os.killpg(each.pid, signal.SIGKILL)


def test_a_process_ends_by_ctrl_c_without_a_traceback(folder, process):
    os.mkfifo(folder / 'slow.png')
    solve = process('solve', str(folder / 'slow.png'), stdout=subprocess.DEVNULL)
    # Open as soon as solve reads it.
    with open(folder / 'slow.png', 'wb'):
        solve.send_signal(signal.SIGINT)
        _, stderr = solve.communicate(timeout=HANGS_S)
    assert solve.returncode == 130
    assert stderr.strip() == 'startracker: stopped'


def used_s(pid):
    """Return the processor time of a process."""
    fields = Path('/proc', str(pid), 'stat').read_text().rpartition(')')[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf('SC_CLK_TCK')


@pytest.mark.slow
def test_ctrl_c_ends_a_search_at_once_whenever_it_comes(folder, process, monkeypatch):
    # It builds its databases in native functions.
    monkeypatch.setenv('XDG_CACHE_HOME', str(folder / 'cache'))
    rng = np.random.default_rng(1)
    image = rng.normal(20, 2, (768, 1024))
    for v, u in rng.integers(5, 760, (60, 2)):
        image[v - 1:v + 2, u - 1:u + 2] += 60
    cv2.imwrite('no_sky.png', image.clip(0, 255).astype(np.uint8))
    took_s = []
    for moment_s in (0.06, 0.3, 0.9, 1.5, 2.5):
        solve = process('solve', 'no_sky.png', stdout=subprocess.PIPE)
        while used_s(solve.pid) < moment_s:
            assert solve.poll() is None
            time.sleep(0.002)
        begin_s = time.monotonic()
        os.killpg(solve.pid, signal.SIGINT)
        stdout, stderr = solve.communicate(timeout=HANGS_S)
        took_s.append(time.monotonic() - begin_s)
        assert (solve.returncode, stdout) == (130, ''), moment_s
        assert stderr.splitlines()[-1] == 'startracker: stopped' and 'Traceback' not in stderr
    # On a busy machine one may wait for a processor.
    assert sorted(took_s)[-2] < 0.5, took_s
    assert not [*folder.rglob('*.part')]


@pytest.mark.parametrize('line', [
    ['reprocess', BAG, '-o', 'out'], ['calibrate', *IMAGES, '--fov-deg', '11', '-o', 'o.yaml'],
    ['bench', 'attitude'], ['night', BAG, '--camera', 'none.yaml'], ['demo', '-o', 'out']],
    ids=lambda line: line[0])
def test_ctrl_c_ends_any_command_while_it_loads(folder, process, line):
    (folder / 'none.yaml').touch()
    command = process(*line, stdout=subprocess.DEVNULL)
    while used_s(command.pid) < 0.3:
        assert command.poll() is None
        time.sleep(0.002)
    os.killpg(command.pid, signal.SIGINT)
    _, stderr = command.communicate(timeout=HANGS_S)
    assert (command.returncode, stderr) == (130, 'startracker: stopped\n')


def test_ctrl_c_deletes_what_is_half_written(folder):
    code = ('import signal, time\nfrom pathlib import Path\n'
            'from startracker_ros.core.ctrl_c import end_at_once\n'
            'from startracker_ros.core.folders import replaced\n'
            'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
            'end_at_once()\n'
            'with replaced(Path("out/file")) as file:\n'
            '    file.write(b"half")\n'
            '    print("half", flush=True)\n'
            '    time.sleep(300)\n')
    with subprocess.Popen([sys.executable, '-c', code], stdout=subprocess.PIPE, text=True) as half:
        assert half.stdout.readline() == 'half\n' and len([*(folder / 'out').iterdir()]) == 1
        half.send_signal(signal.SIGINT)
        assert half.wait(HANGS_S) == 130
    assert not [*(folder / 'out').iterdir()]


def is_running(pid):
    """Return whether a process has not ended: one that nobody waits for is a zombie then."""
    try:
        stat = Path('/proc', pid, 'stat').read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rpartition(')')[2].split()[0] != 'Z'


@pytest.mark.parametrize('at_work', [False, True], ids=['starting', 'working'])
@pytest.mark.parametrize('ending', [signal.SIGINT, signal.SIGKILL], ids=['ctrl-c', 'killed'])
def test_the_workers_of_a_campaign_end_with_it(process, ending, at_work):
    campaign = process('campaign', 'hausdorff', '--trials', '100000', stdout=subprocess.DEVNULL)
    children = Path('/proc', str(campaign.pid), 'task', str(campaign.pid), 'children')

    def workers():
        return [pid for pid in children.read_text().split() if b'spawn_main' in
                Path('/proc', pid, 'cmdline').read_bytes()]

    def busy(pid):
        # It has mapped a database to search.
        return b'/startracker_ros/catalogue-' in Path('/proc', pid, 'maps').read_bytes()
    end_s = time.monotonic() + HANGS_S
    while not (workers() and (not at_work or all(map(busy, workers())))):
        assert campaign.poll() is None and time.monotonic() < end_s
        # Soon after the first one: the next one is being started.
        time.sleep(0.05 if at_work else 0.001)
    pids = workers()
    if ending == signal.SIGINT:
        # To all of them, as a terminal does.
        os.killpg(campaign.pid, ending)
        _, stderr = campaign.communicate(timeout=HANGS_S)
        assert campaign.returncode == 130
        assert stderr.strip() == 'startracker: stopped'
    else:
        campaign.kill()
        campaign.communicate(timeout=HANGS_S)
    while any(map(is_running, pids)):
        assert time.monotonic() < end_s
        time.sleep(0.05)


def test_workers_leave_ctrl_c_to_the_command():
    with cluster(1) as client:
        pid, = client.run(os.getpid).values()
        status = Path('/proc', str(pid), 'status').read_text()
        assert int(re.search(r'SigBlk:\s*(\w+)', status)[1], 16) & 1 << signal.SIGINT - 1
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_reader_that_leaves_is_not_a_traceback(process):
    read, write = os.pipe()
    os.close(read)
    listing = process('simulate', '--options', stdout=write)
    os.close(write)
    _, stderr = listing.communicate(timeout=HANGS_S)
    assert listing.returncode == 141 and stderr == ''


def test_without_colours_there_are_none(monkeypatch):
    monkeypatch.setenv('FORCE_COLOR', '1')
    monkeypatch.setenv('NO_COLOR', '1')
    assert not re.search(r'\x1b\[[0-9;]*[34]\d', startracker('info', BAG).stdout)


@pytest.mark.parametrize('line, words', [
    (['solve', IMAGES[0], '--epoch', '20190729'], 'not a Julian year'),
    (['solve', IMAGES[0], '--fov-deg', '0.001'], 'in less than 0.3 deg'),
    (['export', BAG, '--namespace', 'foo'], "no topic in the namespace 'foo'; it has /attitude"),
    (['record', '-o', '.'], 'not empty')])
def test_nonsense_is_rejected(folder, line, words):
    (folder / 'file').touch()
    done = startracker(*line)
    assert_failed(done, 1, 2)
    assert words in ' '.join(done.stderr.split())


def test_a_capture_without_a_packet_is_a_failure(folder):
    (folder / 'capture').write_bytes(bytes(range(256)))
    done = startracker('telemetry', 'decode', 'capture')
    assert_failed(done, 1)
    assert 'not one packet' in done.stderr


def test_an_annotated_picture_says_what_it_shows(folder):
    (folder / 'bad.png').write_text('not an image')
    cv2.imwrite('dark.png', cv2.imread(IMAGES[0], cv2.IMREAD_GRAYSCALE) // 255)
    startracker('solve', IMAGES[0], 'dark.png', 'bad.png', '--fov-deg', '11.4', '--annotate', '.')
    shown, image = cv2.imread(f'{Path(IMAGES[0]).stem}.png'), cv2.imread(IMAGES[0])
    assert shown.shape[1] == image.shape[1] and shown.shape[0] > image.shape[0] + 40
    # Two lines of text or more, the keys in the colours of the circles, blue first.
    strip = shown[image.shape[0]:].reshape(-1, 3)
    for colour in ((120, 230, 90), (60, 190, 255), (255, 190, 150), (235, 235, 235)):
        assert (abs(strip.astype(int) - colour).max(axis=1) < 30).sum() > 20


@pytest.mark.slow
def test_calibrate_takes_a_folder_as_solve_does(folder):
    for path in IMAGES:
        cv2.imwrite(str(folder / Path(path).name), cv2.imread(path, cv2.IMREAD_UNCHANGED))
    done = startracker('calibrate', '.', '--fov-deg', '11.4', '-o', 'camera.yaml', '--json')
    assert len(json.loads(done.stdout)['rows']) == len(IMAGES) and done.exit_code == 0
    text = startracker('calibrate', '.', '--fov-deg', '11.4', '-o', 'camera.yaml').stdout
    assert re.search(r'focal: \d+\.\d+ px$', text, re.MULTILINE)
