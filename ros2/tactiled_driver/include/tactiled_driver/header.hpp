// Instants and headers of ROS 2.
#pragma once

#include <algorithm>
#include <builtin_interfaces/msg/time.hpp>
#include <cmath>
#include <cstdint>
#include <std_msgs/msg/header.hpp>
#include <string>

namespace tactiled_driver {

// Time of epoch seconds; instants before the epoch, and NaN, become 0.
inline builtin_interfaces::msg::Time ros_time(double unix_s)
{
    constexpr std::int64_t PER_S = 1'000'000'000, LAST_S = (std::int64_t{1} << 31) - 1;
    const auto nanoseconds = static_cast<std::int64_t>(std::fmin(std::fmax(0.0, std::nearbyint(unix_s * 1e9)), 9e18));
    builtin_interfaces::msg::Time time;
    time.sec = static_cast<std::int32_t>(std::min(nanoseconds / PER_S, LAST_S));
    time.nanosec = static_cast<std::uint32_t>(nanoseconds % PER_S);
    return time;
}

inline std_msgs::msg::Header header(double unix_s, const std::string& frame_id)
{
    std_msgs::msg::Header made;
    made.stamp = ros_time(unix_s);
    made.frame_id = frame_id;
    return made;
}

}  // namespace tactiled_driver
