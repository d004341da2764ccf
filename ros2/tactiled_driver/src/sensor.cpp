// Sensor of ros2_control: calibrated force and torque of one board, for force_torque_sensor_broadcaster.
//
// urdf/tactile_array.xacro has its parameters, `board` and `endpoint`, and its six state interfaces. They are NaN
// while no force is known to be fresh.
#include <array>
#include <cmath>
#include <cstddef>
#include <hardware_interface/sensor_interface.hpp>
#include <limits>
#include <memory>
#include <pluginlib/class_list_macros.hpp>
#include <rclcpp/rclcpp.hpp>
#include <string>
#include <tactiled.hpp>
#include <vector>

#include "tactiled_driver/conversions.hpp"

namespace tactiled_driver {

class Sensor final : public hardware_interface::SensorInterface {
public:
    using Result = hardware_interface::CallbackReturn;

    Result on_init(const hardware_interface::HardwareInfo& info) override
    {
        const Result result = SensorInterface::on_init(info);
        if (result != Result::SUCCESS)
            return result;
        board_ = parameter("board", "");
        endpoint_ = parameter("endpoint", tactiled::DEFAULT_ENDPOINT);
        if (board_.empty() || info_.sensors.size() != 1 || info_.sensors[0].state_interfaces.size() != N_VALUES) {
            RCLCPP_ERROR(get_logger(), "it needs <param name=\"board\">, a serial number, and one <sensor> with %zu "
                                       "state interfaces, force.x to torque.z", N_VALUES);
            return Result::ERROR;
        }
        for (std::size_t n = 0; n < N_VALUES; ++n) {
            interfaces_[n] = info_.sensors[0].name + "/" + NAMES[n];
            if (sensor_state_interfaces_.count(interfaces_[n]) == 0) {
                RCLCPP_ERROR(get_logger(), "it needs the state interface %s", interfaces_[n].c_str());
                return Result::ERROR;
            }
        }
        return Result::SUCCESS;
    }

    Result on_configure(const rclcpp_lifecycle::State&) override
    {
        publish(UNKNOWN);
        tactiled::Options options;
        options.board = board_;
        try {
            events_ = std::make_unique<tactiled::Subscription>(endpoint_, std::vector<std::string>{"force"}, options);
        } catch (const tactiled::Error& error) {
            RCLCPP_ERROR(get_logger(), "parameter endpoint: %s", error.what());
            return Result::FAILURE;
        }
        return Result::SUCCESS;
    }

    Result on_cleanup(const rclcpp_lifecycle::State&) override
    {
        events_.reset();
        publish(UNKNOWN);
        return Result::SUCCESS;
    }

    hardware_interface::return_type read(const rclcpp::Time&, const rclcpp::Duration&) override
    {
        for (int n = 0; n < MOST_ITEMS; ++n) {
            const tactiled::Item* item = events_->poll();
            if (!item)
                break;
            if (item->kind == tactiled::Kind::MESSAGE && item->message.read(force_))
                fresh_until_s_ = is_in_newtons(force_, true) ? fresh_until_s(item->message) : 0.0;
        }
        const bool is_known = events_->fresh() && tactiled::monotonic_s() <= fresh_until_s_;
        if (is_known) {
            convert(force_, message_, "");
            const auto &force = message_.wrench.force, &torque = message_.wrench.torque;
            publish({force.x, force.y, force.z, torque.x, torque.y, torque.z});
        } else {
            publish(UNKNOWN);
        }
        return hardware_interface::return_type::OK;
    }

private:
    static constexpr std::size_t N_VALUES = 6;
    using Values = std::array<double, N_VALUES>;
    static constexpr std::array<const char*, N_VALUES> NAMES = {"force.x",  "force.y",  "force.z",
                                                                "torque.x", "torque.y", "torque.z"};
    static constexpr double NOT_KNOWN = std::numeric_limits<double>::quiet_NaN();
    static constexpr Values UNKNOWN = {NOT_KNOWN, NOT_KNOWN, NOT_KNOWN, NOT_KNOWN, NOT_KNOWN, NOT_KNOWN};
    // Of one turn: after a pause the control loop is not held up by all that waits, some 20 us each. The age of
    // what was read keeps the values unknown until the rest has been read.
    static constexpr int MOST_ITEMS = 20;

    std::string parameter(const std::string& name, const std::string& otherwise) const
    {
        const auto found = info_.hardware_parameters.find(name);
        return found == info_.hardware_parameters.end() ? otherwise : found->second;
    }

    static double fresh_until_s(const tactiled::Message& message)
    {
        const double now_s = tactiled::monotonic_s();
        return now_s + FRESH_S - std::abs(message.age_s(now_s));
    }

    void publish(const Values& values)
    {
        for (std::size_t n = 0; n < N_VALUES; ++n)
            set_state(interfaces_[n], values[n]);
    }

    std::string board_, endpoint_;
    std::array<std::string, N_VALUES> interfaces_;  // names of the state interfaces
    std::unique_ptr<tactiled::Subscription> events_;
    tactiled::Force force_;  // newest one; kept because its memory is used again
    geometry_msgs::msg::WrenchStamped message_;
    double fresh_until_s_ = 0.0;  // monotonic; 0 without a force that may be acted on
};

}  // namespace tactiled_driver

PLUGINLIB_EXPORT_CLASS(tactiled_driver::Sensor, hardware_interface::SensorInterface)
