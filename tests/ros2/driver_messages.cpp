// Messages of tactiled as JSON lines in, ROS 2 messages of tactiled_driver as YAML lines out.
#include <cmath>
#include <iomanip>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>

#include "tactiled_driver/conversions.hpp"
#include "tactiled_driver/own_messages.hpp"

using Json = nlohmann::json;
using namespace tactiled_driver;

const std::string FRAME = frame_of("TS-0001");

template <class Own, class Ros> void print(const Json& map)
{
    if (map.at("topic") != Own::TOPIC)
        return;
    Ros ros;
    convert(map.at("data").get<Own>(), ros, FRAME);
    to_flow_style_yaml(ros, std::cout);
    std::cout << std::endl;
}

void print_wrench(const tactiled::Force& force, bool calibrated_only)
{
    geometry_msgs::msg::WrenchStamped wrench;
    if (!is_in_newtons(force, calibrated_only)) {
        std::cout << "null" << std::endl;
        return;
    }
    convert(force, wrench, FRAME);
    to_flow_style_yaml(wrench, std::cout);
    std::cout << std::endl;
}

// Of a status that was received at 0 s, with an age, and diagnostics at `now_s`.
void print_diagnostics(const Json& map)
{
    BoardState state;
    state.board = "TS0001";
    state.is_active = map.at("is_active");
    if (map.contains("status")) {
        state.status = map.at("status").get<tactiled::Status>();
        state.status_s = 0.0;
        state.status_age_s = map.at("age_s");
        state.too_old = std::abs(state.status_age_s) > FRESH_S;  // as the node counts it
    }
    const double now_s = map.at("now_s");
    std::cout << "{is_fresh: " << std::boolalpha << state.is_fresh(now_s) << ", message: ";
    to_flow_style_yaml(diagnostics(state, now_s, 1.5), std::cout);
    std::cout << "}" << std::endl;
}

int main()
{
    namespace msg = tactiled_msgs::msg;
    std::cout << std::setprecision(17);
    for (std::string line; std::getline(std::cin, line);) {
        const Json map = Json::parse(line);
        print<tactiled::Slip, msg::Slip>(map);
        print<tactiled::Contact, msg::Contact>(map);
        print<tactiled::Texture, msg::Texture>(map);
        print<tactiled::Grip, msg::Grip>(map);
        print<tactiled::Force, msg::Force>(map);
        print<tactiled::Scan, msg::Scan>(map);
        print<tactiled::Info, msg::Info>(map);
        print<tactiled::Status, msg::Status>(map);
        print<tactiled::Recording, msg::Recording>(map);
        print<tactiled::Command, msg::Command>(map);
        if (map.at("topic") == "wrench")
            print_wrench(map.at("data").get<tactiled::Force>(), map.at("calibrated_only"));
        if (map.at("topic") == "frame")
            std::cout << frame_of(map.at("data")) << std::endl;
        if (map.at("topic") == "diagnostics")
            print_diagnostics(map);
        if (map.at("topic") == "lost contact") {
            msg::Contact ros;
            convert(contact_of(map.at("data").get<tactiled::Status>(), "holding", map.at("is_lost"), 1.5), ros, FRAME);
            to_flow_style_yaml(ros, std::cout);
            std::cout << std::endl;
        }
    }
}
