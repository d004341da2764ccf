// Tighten a grip at the first sign of slip, and hold it while nothing is known of the skin.
#include <chrono>
#include <cmath>
#include <memory>

#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/float64.hpp"
#include "tactiled_msgs/msg/slip.hpp"
#include "tactiled_msgs/msg/status.hpp"

using tactiled_msgs::msg::Slip;
using tactiled_msgs::msg::Status;
using Steady = std::chrono::steady_clock;

constexpr double STEP_N = 0.5;                               // how much more force at each slip
constexpr auto FRESH = std::chrono::milliseconds(300);       // three periods of the status
constexpr double OLDEST_S = 0.2;                             // what is older says nothing of the present grip

// Seconds since an instant of the system clock.
double age_s(const builtin_interfaces::msg::Time& instant) {
    const std::chrono::duration<double> now = std::chrono::system_clock::now().time_since_epoch();
    return now.count() - instant.sec - 1e-9 * instant.nanosec;
}

class GripController : public rclcpp::Node {
public:
    GripController() : Node("grip_controller") {
        output_ = create_publisher<std_msgs::msg::Float64>("grip_force", 1);
        status_ = create_subscription<Status>("tactile/TS0001/status", 1, [this](const Status& status) {
            fresh_until_ = status.valid ? Steady::now() + FRESH : Steady::time_point();
        });
        slip_ = create_subscription<Slip>("tactile/TS0001/slip", 10, [this](const Slip& slip) {
            if (Steady::now() >= fresh_until_ || std::abs(age_s(slip.detected)) > OLDEST_S) return;
            if (!slip.valid || slip.state != Slip::STATE_ONSET) return;
            std_msgs::msg::Float64 force;
            force.data = force_n_ += STEP_N;
            output_->publish(force);
        });
    }

private:
    double force_n_ = 2.0;
    Steady::time_point fresh_until_;
    rclcpp::Publisher<std_msgs::msg::Float64>::SharedPtr output_;
    rclcpp::Subscription<Status>::SharedPtr status_;
    rclcpp::Subscription<Slip>::SharedPtr slip_;
};

int main(int count, char** words) {
    rclcpp::init(count, words);
    rclcpp::spin(std::make_shared<GripController>());
    rclcpp::shutdown();
}
