"""Commands that run nodes, and the one that looks whether they can: run, demo, doctor."""

from pathlib import Path

import click
from startracker_ros.cli.shared import become_node, exit_1_on, finish, json_option, seed_option


@click.command(context_settings={'ignore_unknown_options': True, 'help_option_names': []})
@click.argument('node')
@click.argument('arguments', nargs=-1, type=click.UNPROCESSED)
def run(node: str, arguments: tuple[str, ...]) -> None:
    """Run one NODE, as `ros2 run startracker_ros NODE` does; takes --ros-args."""
    from startracker_ros.executables import EXECUTABLES
    if node not in EXECUTABLES:
        raise click.UsageError(f'no node {node!r}; there are {", ".join(EXECUTABLES)}')
    become_node(node, arguments)


@click.group(invoke_without_command=True)
@click.option('--output', type=click.Path(path_type=Path, file_okay=False), default='demo',
              show_default=True, help='Folder for bag, picture and logs.')
@click.option('--seconds', type=click.FloatRange(5, 3600), default=60.0, show_default=True,
              help='Sky time.')
@seed_option
@json_option
@click.pass_context
def demo(context: click.Context, output: Path, seconds: float, seed: int, as_json: bool) -> None:
    """Run all nodes on the simulated sky, record a bag, print and draw the result."""
    if context.invoked_subcommand is not None:
        return
    from startracker_ros.harness.demo import run_demo
    from startracker_ros.harness.processes import HarnessError
    with exit_1_on(HarnessError):
        result = run_demo(output, seconds=seconds, seed=seed)
    finish(result, as_json)


@demo.command('two-satellite')
@click.option('--output', type=click.Path(path_type=Path, file_okay=False),
              default='demo_two_satellite', show_default=True,
              help='Folder for bag, picture and logs.')
@click.option('--seconds', type=click.FloatRange(10, 90), default=60.0, show_default=True,
              help='Sky time, until the target leaves the field.')
@seed_option
@json_option
def demo_two_satellite(output: Path, seconds: float, seed: int, as_json: bool) -> None:
    """Two satellites, each with a star tracker of its own, locate a third."""
    from startracker_ros.harness.processes import HarnessError
    from startracker_ros.harness.two_satellite_demo import run_two_satellite_demo
    with exit_1_on(HarnessError):
        result = run_two_satellite_demo(output, seconds=seconds, seed=seed)
    finish(result, as_json)


@demo.command('closed-loop')
@click.option('--output', type=click.Path(path_type=Path, file_okay=False),
              default='demo_closed_loop', show_default=True,
              help='Folder for bag, pictures, report page and logs.')
@seed_option
@json_option
def demo_closed_loop(output: Path, seed: int, as_json: bool) -> None:
    """Control a spacecraft of Basilisk by what the star tracker sees."""
    from startracker_ros.gnc.basilisk_messages import import_basilisk
    import_basilisk()
    from startracker_ros.harness.closed_loop_demo import run_closed_loop_demo
    from startracker_ros.harness.processes import HarnessError
    with exit_1_on(HarnessError):
        result = run_closed_loop_demo(output, seed=seed)
    finish(result, as_json)


@click.command()
@click.option('--camera', 'camera_file', type=click.Path(path_type=Path),
              help='Camera YAML to look at, too.')
@click.option('--listen', 'listen_s', type=click.FloatRange(0.5, 600), metavar='SECONDS',
              help='Listen to image_raw and camera_info for so long.')
@click.option('--namespace', default='', help='That of the camera, as tracker_1.')
@json_option
def doctor(camera_file: Path | None, listen_s: float | None, namespace: str, as_json: bool
           ) -> None:
    """Look at install, DDS, caches, disk and camera; say what to mend."""
    from startracker_ros.doctor.examination import examine
    finish(examine(camera_file=camera_file, listen_s=listen_s or 0.0, namespace=namespace),
           as_json)
