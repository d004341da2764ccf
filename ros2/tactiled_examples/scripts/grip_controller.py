#!/usr/bin/env python3
"""Tighten a grip at the first sign of slip, and hold it while nothing is known of the skin."""

import time

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64
from tactiled_msgs.msg import Slip, Status

STEP_N = 0.5  # how much more force at each slip
FRESH_S = 0.3  # three periods of the status
OLDEST_S = 0.2  # what is older says nothing of the present grip


class GripController(Node):
    """Publish the wanted grip force on `grip_force`."""

    def __init__(self) -> None:
        super().__init__("grip_controller")
        self.force_n, self.fresh_until_s = 2.0, 0.0  # no status yet
        self.output = self.create_publisher(Float64, "grip_force", 1)
        self.create_subscription(Status, "tactile/TS0001/status", self.on_status, QoSProfile(depth=1))
        self.create_subscription(Slip, "tactile/TS0001/slip", self.on_slip, QoSProfile(depth=10))

    def on_status(self, status: Status) -> None:
        """Note until when the skin may be trusted."""
        trusted_s = FRESH_S if status.valid else 0.0
        self.fresh_until_s = time.monotonic() + trusted_s

    def on_slip(self, slip: Slip) -> None:
        """Tighten at each valid onset that was detected just now."""
        age_s = time.time() - slip.detected.sec - 1e-9 * slip.detected.nanosec
        fresh = time.monotonic() < self.fresh_until_s and abs(age_s) <= OLDEST_S
        if fresh and slip.valid and slip.state == Slip.STATE_ONSET:
            self.force_n += STEP_N
            self.get_logger().info(f"{slip.kind} slip towards {slip.direction_rad:.2f} rad")
            self.output.publish(Float64(data=self.force_n))


rclpy.init()
rclpy.spin(GripController())
