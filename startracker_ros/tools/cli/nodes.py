# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands that run nodes, and the one that looks whether they can: run, demo, live, doctor."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TYPE_CHECKING

import click
from startracker_ros.core.options import yaml_value
from startracker_ros.ros.executables import EXECUTABLES, NODES, STAGES
from startracker_ros.tools.cli.outcome import (
    Commands, exit_1_on, FOV_DEG, InputName, InputPath, NeedsArguments, usage_error_on)
from startracker_ros.tools.cli.shared import (
    become_node, finish, finish_measured, json_option, output_option, print_result, seed_option)

if TYPE_CHECKING:
    from startracker_ros.io.table import Result


@click.command(cls=NeedsArguments, no_args_is_help=True,
               context_settings={'ignore_unknown_options': True, 'allow_interspersed_args': False},
               epilog=f'Nodes: {", ".join(EXECUTABLES)}.')
@click.argument('node', shell_complete=lambda context, argument, incomplete: [
    name for name in EXECUTABLES if name.startswith(incomplete)])
@click.argument('arguments', nargs=-1, type=click.UNPROCESSED, metavar='[--ros-args ...]')
def run(node: str, arguments: tuple[str, ...]) -> None:
    """
    Run one NODE, as `ros2 run startracker_ros NODE` does.

    It takes --ros-args; NODE --help lists its parameters.
    """
    if node not in EXECUTABLES:
        raise click.UsageError(f'no node {node!r}; there are {", ".join(EXECUTABLES)}')
    if arguments[:1] in (('--help',), ('-h',)):
        _print_parameters(node)
        return
    become_node(node, arguments)


def _print_parameters(node: str) -> None:
    """Print the parameters of a node, or of the nodes that composed_pipeline runs."""
    from startracker_ros.io.table import Result
    from startracker_ros.ros.tables import node_rows
    click.echo(f'Usage: startracker run {node} [--ros-args -p NAME:=VALUE -r FROM:=TO '
               '--params-file FILE ...]\n')
    for each in (node,) if node in NODES else STAGES:
        print_result(Result(f'parameters of {each}', [
            {'name': row.name, 'default': yaml_value(row.default), 'unit': row.unit,
             'range': row.range_text, 'meaning': row.description}
            for row in node_rows(each)]), as_json=False)


@click.group(cls=Commands, joined='startracker.demos', elsewhere=('closed-loop',),
             invoke_without_command=True,
             subcommand_metavar='[COMMAND] [ARGS]...')
@output_option('demo', 'Folder for bag, picture and logs.')
@click.option('--seconds', type=click.FloatRange(5, 3600), default=60.0, show_default=True,
              metavar='SECONDS', help='Sky time.')
@seed_option
@json_option
@click.pass_context
def demo(context: click.Context, output: Path, seconds: float, seed: int, as_json: bool) -> None:
    """Run all nodes on a simulated sky; record, print, draw the result."""
    if context.invoked_subcommand is not None:
        return
    from startracker_ros.tools.demos.demo import run_demo
    _finish_demo(run_demo, output, seconds, seed, as_json)


def _finish_demo(run: Callable[..., 'Result'], output: Path, seconds: float, seed: int,
                 as_json: bool) -> None:
    from startracker_ros.ros.processes import HarnessError
    with exit_1_on(HarnessError):
        result = run(output, seconds=seconds, seed=seed)
    finish_measured(result, as_json)


@demo.command('two-satellite')
@output_option('demo_two_satellite', 'Folder for bag, picture and logs.')
@click.option('--seconds', type=click.FloatRange(10, 90), default=60.0, show_default=True,
              metavar='SECONDS', help='Sky time, until the target leaves the field.')
@seed_option
@json_option
def demo_two_satellite(output: Path, seconds: float, seed: int, as_json: bool) -> None:
    """Two satellites, each with a star tracker of its own, locate a third."""
    from startracker_ros.tools.demos.two_satellite_demo import run_two_satellite_demo
    _finish_demo(run_two_satellite_demo, output, seconds, seed, as_json)


@demo.command('heads')
@output_option('demo_heads', 'Folder for bag, picture, report page, mounts and logs.')
@click.option('--seconds', type=click.FloatRange(10, 600), default=600.0, show_default=True,
              metavar='SECONDS', help='Sky time; each head is blinded three times in 600 s.')
@seed_option
@json_option
def demo_heads(output: Path, seconds: float, seed: int, as_json: bool) -> None:
    """Three heads, one attitude; each is blinded in turn by Moon, Sun and Earth."""
    from startracker_ros.tools.demos.heads_demo import run_heads_demo
    _finish_demo(run_heads_demo, output, seconds, seed, as_json)


@click.command()
@click.option('--device', default='/dev/video0', show_default=True, type=InputName(),
              metavar='DEVICE',
              help='Camera of Video4Linux, or a video, or a folder or pattern of images.')
@click.option('--camera', 'camera_file', type=InputPath(), metavar='FILE',
              help='Camera YAML.  [default: estimated from the first image that is solved]')
@click.option('--fov-deg', type=FOV_DEG, metavar='DEG',
              help='Horizontal field of view to 5 %, to find the lens sooner.')
@click.option('--exposure-ms', type=click.FloatRange(0, 600_000), default=0.0, metavar='MS',
              help='Exposure time.  [default: as the camera has it]')
@click.option('--gain', type=click.FloatRange(-1, 1e6), default=-1.0, metavar='GAIN',
              help='Gain in units of the driver.  [default: as the camera has it]')
@click.option('--frame-rate-hz', type=click.FloatRange(0, 1000), default=0.0, metavar='HZ',
              help='Images a second.  [default: as the camera has it, of files 10]')
@click.option('--width', type=click.IntRange(0, 20_000), default=0, metavar='PX',
              help='Image width of the camera.  [default: 640]')
@click.option('--height', type=click.IntRange(0, 20_000), default=0, metavar='PX',
              help='Image height of the camera.  [default: 480]')
@click.option('--pixel-format', default='auto', metavar='FOURCC',
              help='Format of V4L2, as Y16 or RGGB.  [default: 8 bit]')
@click.option('--record', is_flag=True, help='Record a bag, too.')
@click.option('--host', default='127.0.0.1', show_default=True, metavar='ADDRESS',
              help='Address of the page; 0.0.0.0: for all in the networks of this machine, as a '
              'phone, without a password.')
@click.option('--port', type=click.IntRange(0, 65535), default=8000, show_default=True,
              metavar='PORT', help='Port of the page; 0: any free one.')
@click.option('--seconds', type=click.FloatRange(1), default=float('inf'), metavar='SECONDS',
              help='End after this time.  [default: Ctrl-C]')
@output_option('live', 'Folder for picture, bags, camera YAML and logs.')
@json_option
def live(camera_file: Path | None, fov_deg: float | None, record: bool, host: str,
         port: int, seconds: float, output: Path, as_json: bool, **capture: Any) -> None:
    """
    Run a camera and the star tracker; show state and sky.

    Until Ctrl-C, on the terminal and on a page.
    """
    from startracker_ros.core.camera.model import CameraError
    from startracker_ros.io.images.capture import CaptureOptions
    from startracker_ros.ros.processes import HarnessError
    from startracker_ros.tools.live.live import run_live
    with usage_error_on(CameraError, ValueError), exit_1_on(HarnessError, output=output):
        result = run_live(output, CaptureOptions(**capture), camera_file=camera_file,
                          fov_deg=fov_deg, record=record, host=host, port=port,
                          seconds=seconds)
    print_result(result, as_json)


@click.command()
@click.option('--camera', 'camera_file', type=InputPath(), metavar='FILE',
              help='Camera YAML to look at, too.')
@click.option('--listen', 'listen_s', type=click.FloatRange(0.5, 600), metavar='SECONDS',
              help='Listen to image_raw and camera_info for so long.')
@click.option('--namespace', default='', metavar='NAME', help='That of the camera, as tracker_1.')
@json_option
def doctor(camera_file: Path | None, listen_s: float | None, namespace: str, as_json: bool
           ) -> None:
    """Check install, DDS, caches, disk and camera; say what to fix."""
    from startracker_ros.tools.doctor.examination import examine
    finish(examine(camera_file=camera_file, listen_s=listen_s or 0.0, namespace=namespace),
           as_json)
