"""Touchline as a lifecycle node of ROS 2.

The topics are those of `touchline live ros`. Parameters, services and states are on the page docs/how-to-ros.md.
"""

from __future__ import annotations

import math
from pathlib import Path

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_srvs.srv import Empty, SetBool, Trigger

from touchline.config import load_settings
from touchline.errors import TouchlineError
from touchline.live.loop import LiveLoop
from touchline.live.ros_link import RosLink, RosOptions
from touchline.live.ros_node import RosNode
from touchline.localizer import Localizer
from touchline.sources.bags.standard import Frames
from touchline.systems import system_info
from touchline_ros.parameters import PARAMETERS, Parameter

try:
    from nav2_msgs.srv import SetInitialPose
except ImportError:  # nav2 is not installed
    SetInitialPose = None


class TouchlineNode(LifecycleNode):
    """configure: field, camera, topics. activate: localises. deactivate: stops. cleanup: forgets all of it."""

    def __init__(self, **options: object) -> None:
        super().__init__("touchline", **options)
        for parameter in PARAMETERS:
            self.declare_parameter(parameter.name, parameter.default, _descriptor(parameter))
        self.active = False
        self._localizer: Localizer | None = None
        self._link: RosLink | None = None
        self.create_service(Empty, "reinitialize_global_localization", self._forget)
        self.create_service(Trigger, "~/own_half", self._own_half)
        self.create_service(Trigger, "~/start_pose", self._start_pose)
        self.create_service(SetBool, "~/penalised", self._penalised)
        if SetInitialPose is not None:
            self.create_service(SetInitialPose, "set_initial_pose", self._set_initial_pose)

    def run(self) -> None:
        """Localise until the node is deactivated, or ROS ends."""
        loop = LiveLoop(self._link, self._localizer, self._report, team_evidence=self._value("team_evidence"))
        loop.run(lambda: not (self.active and rclpy.ok()))

    def on_configure(self, state: object) -> TransitionCallbackReturn:
        """Open field, camera and system, and announce the topics."""
        try:
            self._localizer = self._new_localizer()
            self._link = RosLink(RosNode(node=self), self._options())
        except (TouchlineError, OSError) as error:
            self.get_logger().error(str(error))
            self._localizer = None
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: object) -> TransitionCallbackReturn:
        """Localise from now on."""
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: object) -> TransitionCallbackReturn:
        """Stop; the pose is kept."""
        self.active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: object) -> TransitionCallbackReturn:
        """Let go of topics, field and camera."""
        self.active = False
        if self._link is not None:
            self._link.close()
        self._link = self._localizer = None
        return super().on_cleanup(state)

    def on_shutdown(self, state: object) -> TransitionCallbackReturn:
        """As cleanup."""
        return self.on_cleanup(state)

    def _new_localizer(self) -> Localizer:
        field, camera, config = self._value("field"), self._value("camera"), self._value("config")
        if not field:
            raise TouchlineError("parameter field: is empty; the name of a preset, or the path of a field.yaml")
        system = self._value("system")
        chosen = load_settings(system_info(system).settings, Path(config) if config else None, self._words("settings"))
        wheels = tuple(self._value("wheels"))
        has_wheels = len(wheels) == 2 and wheels[0] != wheels[1]
        localizer = Localizer(
            field, camera or None, system, wheels if has_wheels else None, chosen, self._value("seed")
        )
        if self._value("own_half"):
            localizer.reset(own_half=True)
        return localizer

    def _options(self) -> RosOptions:
        pairs = [each.partition("=") for each in self._words("topics")]
        wrong = next((f"{role}{equals}{name}" for role, equals, name in pairs if not equals or not name), None)
        if wrong is not None:
            raise TouchlineError(f"parameter topics: {wrong}: expected ROLE=/NAME")
        base = self._value("base_frame")
        return RosOptions(
            {role: name for role, _, name in pairs},
            base or None,
            self._localizer.field,
            self._localizer.camera,
            self._value("late_ms"),
            Frames(self._value("map_frame"), self._value("odom_frame"), base or Frames().base),
            self._value("tf_while_searching"),
            self._value("publish_tf"),
        )

    def _report(self, published: object) -> None:
        estimate = published.estimate
        if estimate.problems:
            self.get_logger().warning("; ".join(map(str, estimate.problems)), throttle_duration_sec=5.0)
        self.get_logger().info(repr(estimate), throttle_duration_sec=5.0)

    def _forget(self, request: object, response: object) -> object:
        self._reset()
        return response

    def _own_half(self, request: object, response: object) -> object:
        return self._answered(response, own_half=True)

    def _start_pose(self, request: object, response: object) -> object:
        return self._answered(response, pose=list(self._value("start_pose")))

    def _penalised(self, request: object, response: object) -> object:
        return self._answered(response, state="penalised" if request.data else "back from a penalty")

    def _set_initial_pose(self, request: object, response: object) -> object:
        at, turn = request.pose.pose.pose.position, request.pose.pose.pose.orientation
        heading = 2.0 * math.atan2(turn.z, turn.w)
        if problem := self._reset(pose=[at.x, at.y, heading]):
            self.get_logger().error(problem)
        return response

    def _answered(self, response: object, **start: object) -> object:
        response.message = self._reset(**start)
        response.success = not response.message
        return response

    def _reset(self, **start: object) -> str:
        """Why it could not be done; empty if it was."""
        if self._localizer is None:
            return "the node is not configured"
        try:
            self._localizer.reset(**start)
        except TouchlineError as error:
            return str(error)
        return ""

    def _value(self, name: str) -> object:
        return self.get_parameter(name).value

    def _words(self, name: str) -> list[str]:
        return [each for each in self._value(name) if each]


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    described = ParameterDescriptor(name=parameter.name, description=parameter.description)
    if not parameter.live:
        described.additional_constraints = "Read when the node is configured."
    if parameter.range is not None:
        least, most = parameter.range
        if isinstance(parameter.default, float):
            described.floating_point_range = [FloatingPointRange(from_value=float(least), to_value=float(most))]
        else:
            described.integer_range = [IntegerRange(from_value=int(least), to_value=int(most), step=1)]
    return described


def main(args: list[str] | None = None) -> None:
    """Run the node until ROS ends."""
    rclpy.init(args=args)
    node, executor = TouchlineNode(), SingleThreadedExecutor()
    executor.add_node(node)
    try:
        if node.get_parameter("autostart").value:
            done = node.trigger_configure()
            if done == TransitionCallbackReturn.SUCCESS:
                node.trigger_activate()
        while rclpy.ok():
            if node.active:
                node.run()
            else:
                executor.spin_once(timeout_sec=0.1)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # it ends
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
