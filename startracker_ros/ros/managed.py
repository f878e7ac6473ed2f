# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Managed nodes: states and transitions of the ROS 2 lifecycle over its standard services."""

from collections.abc import Callable
from dataclasses import dataclass
import traceback

from lifecycle_msgs.srv import ChangeState
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.timer import Timer
from startracker_ros.core.options import option, Options
from startracker_ros.ros.messages.rclpy_internals import answer_change_state, lifecycle_state


@dataclass(frozen=True)
class LifecycleOptions(Options):
    """Who configures and activates a node."""

    autostart: bool = option(
        True, 'configure and activate at the start; false: unconfigured until a lifecycle manager '
        'or `ros2 lifecycle set` configures it', read_only=True)


class StartError(RuntimeError):
    """A node that cannot be configured with its parameters; the text says what to change."""


class ManagedNode(LifecycleNode):
    """
    A node with the states unconfigured, inactive, active and finalized.

    Subclasses override configure(), activate(), deactivate() and cleanup(), which run within the
    transitions. configure() may raise StartError or ValueError: the node stays unconfigured.
    Another error returns the node to unconfigured by way of error processing.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.configured = self.active = False
        self._failure: Exception | None = None
        # The callback of rclpy 7.1.6 ends the process at a transition that the state has not.
        answer_change_state(self, self._on_change_state)

    def create_steady_timer(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """Return a timer of the steady clock, which runs while simulated time is stopped."""
        return self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def configure(self) -> None:
        """Build what the node needs, out of its parameters."""

    def activate(self) -> None:
        """Begin to process."""

    def deactivate(self) -> None:
        """Pause; the state is kept."""

    def cleanup(self) -> None:
        """Forget what configure() has built."""

    def on_state(self, label: str) -> None:
        """React to a state that a service has set."""

    def autostart(self) -> None:
        """Configure, then activate; raises what configure() or activate() raises."""
        for trigger in (self.trigger_configure, self.trigger_activate):
            trigger()
            if self._failure is not None:
                raise self._failure

    @property
    def state_label(self) -> str:
        """Return the state: unconfigured, inactive, active or finalized."""
        return lifecycle_state(self)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure."""
        result = self._do(self.configure)
        self.configured = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate."""
        result = self._do(self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        self.active = False
        return self._do(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        self.configured = False
        return self._do(self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop for good; the process ends by its signal."""
        return self._stop()

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to unconfigured after an error in a transition."""
        error = self._failure
        result = self._stop()
        self._failure = error
        return result

    def _stop(self) -> TransitionCallbackReturn:
        was_active, was_configured = self.active, self.configured
        self.configured = self.active = False

        def stop() -> None:
            if was_active:
                self.deactivate()
            if was_configured:
                self.cleanup()
        return self._do(stop)

    def _do(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Do the work of a transition and remember why it failed."""
        self._failure = None
        try:
            work()
        except (StartError, ValueError) as error:
            self._failure = error
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._failure = error
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _on_change_state(self, change_state: Callable, request: ChangeState.Request,
                         response: ChangeState.Response) -> ChangeState.Response:
        """Change the state; a transition that is not possible changes nothing."""
        try:
            change_state(request, response)
        except rclpy_implementation.RCLError:
            # rcl has logged the state and the transition.
            response.success = False
        else:
            self._log_failure()
            self.on_state(self.state_label)
        return response

    def _log_failure(self) -> None:
        error = self._failure
        if isinstance(error, StartError | ValueError):
            self.get_logger().error(str(error))
        elif error is not None:
            self.get_logger().error(''.join(traceback.format_exception(error)))
