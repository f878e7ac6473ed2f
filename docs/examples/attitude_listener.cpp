// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cmath>
#include <memory>

#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/imu.hpp"

class AttitudeListener : public rclcpp::Node
{
public:
  AttitudeListener()
  : Node("attitude_listener")
  {
    subscription_ = create_subscription<sensor_msgs::msg::Imu>(
      "attitude_imu", rclcpp::QoS(10),
      [this](const sensor_msgs::msg::Imu & message) {on_attitude(message);});
  }

private:
  void on_attitude(const sensor_msgs::msg::Imu & message)
  {
    const auto & covariance = message.orientation_covariance;
    if (covariance[0] < 0.0) {
      RCLCPP_WARN(get_logger(), "no trusted attitude");
      return;
    }
    const auto & q = message.orientation;  // q_icrf_from_sensor
    const auto & stamp = message.header.stamp;
    const double sigma_rad = std::sqrt(std::max({covariance[0], covariance[4], covariance[8]}));
    RCLCPP_INFO(
      get_logger(), "%d.%09u x %+.6f y %+.6f z %+.6f w %+.6f, worst axis %.1f arcsec",
      stamp.sec, stamp.nanosec, q.x, q.y, q.z, q.w, sigma_rad * 206265.0);
  }

  rclcpp::Subscription<sensor_msgs::msg::Imu>::SharedPtr subscription_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<AttitudeListener>());
  rclcpp::shutdown();
  return 0;
}
