// Subscriber and bare publisher of wrenches for `./run bench native`.
//
//     wrenches listen TOPIC COUNT    prints "ready", then number and time of each wrench until there are COUNT
//     wrenches publish TOPIC         publishes a wrench for each line of its input; then number and time of each
//
// The number of a wrench is its force.z. Times are ns of CLOCK_MONOTONIC: before `publish`, and in the callback.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <iostream>
#include <rclcpp/rclcpp.hpp>
#include <string>
#include <vector>

using geometry_msgs::msg::WrenchStamped;

struct Instant {
    long long number, at_ns;
};

static long long now_ns()
{
    timespec now{};
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

static std::vector<Instant> listen(const std::string& topic, std::size_t count)
{
    std::vector<Instant> instants;
    instants.reserve(count);
    const auto node = std::make_shared<rclcpp::Node>("listener");
    rclcpp::executors::SingleThreadedExecutor executor;
    const auto subscription =
        node->create_subscription<WrenchStamped>(topic, rclcpp::SensorDataQoS(), [&](const WrenchStamped& wrench) {
            const long long at_ns = now_ns();
            if (instants.empty())
                std::puts("ready"), std::fflush(stdout);
            if (instants.size() < count)
                instants.push_back({std::llround(wrench.wrench.force.z), at_ns});
            else
                executor.cancel();
        });
    executor.add_node(node);
    executor.spin();
    return instants;
}

static std::vector<Instant> publish(const std::string& topic)
{
    std::vector<Instant> instants;
    const auto node = std::make_shared<rclcpp::Node>("publisher");
    const auto publisher = node->create_publisher<WrenchStamped>(topic, rclcpp::SensorDataQoS());
    WrenchStamped wrench;
    wrench.header.frame_id = "tactile_TS0001";
    for (std::string line; std::getline(std::cin, line);) {
        const auto number = static_cast<long long>(instants.size());
        wrench.wrench.force.z = static_cast<double>(number);
        instants.push_back({number, now_ns()});
        publisher->publish(wrench);
    }
    return instants;
}

int main(int argc, char** argv)
{
    const std::string mode = argc > 2 ? argv[1] : "";
    if (!(mode == "listen" && argc == 4) && !(mode == "publish" && argc == 3))
        return 2;
    rclcpp::init(0, nullptr);
    const std::vector<Instant> instants =
        mode == "listen" ? listen(argv[2], std::strtoul(argv[3], nullptr, 10)) : publish(argv[2]);
    rclcpp::shutdown();
    for (const Instant& instant : instants)
        std::printf("%lld %lld\n", instant.number, instant.at_ns);
}
