// Messages of tactiled as JSON lines in, ROS 2 messages of tactiled_driver as YAML lines out.
#include <iomanip>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>

#include "tactiled_driver/conversions.hpp"
#include "tactiled_driver/own_messages.hpp"

using Json = nlohmann::json;
using namespace tactiled_driver;
namespace msg = tactiled_msgs::msg;

const std::string FRAME = frame_of("TS-0001");

template <class Ros> void print(const Ros& ros, bool is_made)
{
    if (is_made)
        to_flow_style_yaml(ros, std::cout);
    else
        std::cout << "null";
    std::cout << std::endl;
}

template <class Own, class Ros> void print_own(const Json& map)
{
    if (map.at("topic") != Own::TOPIC)
        return;
    Ros ros;
    convert(map.at("data").get<Own>(), ros, FRAME);
    print(ros, true);
}

void print_wrench(const Json& map)
{
    const auto force = map.at("data").get<tactiled::Force>();
    geometry_msgs::msg::WrenchStamped wrench;
    convert(force, wrench, FRAME);
    print(wrench, is_in_newtons(force, map.at("calibrated_only")));
}

void print_taxels(const Json& map)
{
    tactiled::Info info;
    if (map.contains("info"))
        info = map.at("info").get<tactiled::Info>();
    sensor_msgs::msg::PointCloud2 cloud;
    const bool is_made = convert(map.at("data").get<tactiled::Force>(), info, cloud, FRAME);
    print(cloud, is_made);
}

// Of a status that was received at 0 s, with an age, and diagnostics at `now_s`.
void print_diagnostics(const Json& map)
{
    BoardState state;
    state.board = "TS0001";
    state.is_active = map.at("is_active");
    if (map.contains("status")) {
        state.take(map.at("status").get<tactiled::Status>(), map.at("age_s"), 0.0);
        state.admit("status", map.at("age_s"), 0.0);
    }
    state.malformed = map.value("malformed", 0);
    state.lost = map.value("lost", 0);
    const double now_s = map.at("now_s");
    std::cout << "{is_fresh: " << std::boolalpha << state.is_fresh(now_s) << ", message: ";
    to_flow_style_yaml(diagnostics(state, now_s, 1.5), std::cout);
    std::cout << "}" << std::endl;
}

// Of messages by instant and age: which are admitted, and the contacts that replace the latched one.
void print_steps(const Json& map)
{
    BoardState state;
    state.board = "TS0001";
    state.is_active = true;
    std::cout << "[";
    for (const Json& step : map.at("steps")) {
        const std::string topic = step.at("topic");
        const double now_s = step.at("now_s"), age_s = step.at("age_s");
        if (topic == "status")
            state.take(step.at("data").get<tactiled::Status>(), age_s, now_s);
        const bool is_admitted = state.admit(topic, age_s, now_s);
        if (is_admitted && topic == "contact")
            state.contact = step.at("state");
        std::cout << "{is_admitted: " << std::boolalpha << is_admitted << ", too_old: " << state.too_old;
        if (const auto contact = state.changed_contact(now_s, 1.5)) {
            msg::Contact ros;
            convert(*contact, ros, FRAME);
            std::cout << ", contact: ";
            to_flow_style_yaml(ros, std::cout);
        }
        std::cout << "}, ";
    }
    std::cout << "]" << std::endl;
}

int main()
{
    std::cout << std::setprecision(17);
    for (std::string line; std::getline(std::cin, line);) {
        const Json map = Json::parse(line);
        print_own<tactiled::Slip, msg::Slip>(map);
        print_own<tactiled::Contact, msg::Contact>(map);
        print_own<tactiled::Texture, msg::Texture>(map);
        print_own<tactiled::Grip, msg::Grip>(map);
        print_own<tactiled::Force, msg::Force>(map);
        print_own<tactiled::Scan, msg::Scan>(map);
        print_own<tactiled::Info, msg::Info>(map);
        print_own<tactiled::Status, msg::Status>(map);
        print_own<tactiled::Recording, msg::Recording>(map);
        print_own<tactiled::Command, msg::Command>(map);
        if (map.at("topic") == "wrench")
            print_wrench(map);
        if (map.at("topic") == "taxels")
            print_taxels(map);
        if (map.at("topic") == "frame")
            std::cout << frame_of(map.at("data")) << std::endl;
        if (map.at("topic") == "instant")
            print(ros_time(std::stod(map.at("data").get<std::string>())), true);
        if (map.at("topic") == "diagnostics")
            print_diagnostics(map);
        if (map.at("topic") == "steps")
            print_steps(map);
    }
}
