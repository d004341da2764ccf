// Standard messages of ROS 2 from the structures of tactiled, and the verdict in /diagnostics.
// Pure: no node, no clock. own_messages.hpp has the messages of tactiled_msgs.
#pragma once

#include <cctype>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <limits>
#include <string>
#include <tactiled_events.hpp>

#include "tactiled_driver/header.hpp"

namespace tactiled_driver {

constexpr double FRESH_S = 0.5;  // five periods of the status, as in the client

// Name of a board in topics and frames, by the rule of tactiled.ros2.names: TS_0001 for TS-0001.
inline std::string name_of(const std::string& board)
{
    std::string name = "_";
    for (const unsigned char c : board)
        if (std::isalnum(c) || name.back() != '_')
            name += std::isalnum(c) ? static_cast<char>(c) : '_';
    if (name.back() == '_')
        name.pop_back();
    return name.size() > 1 && std::isalpha(name[1]) ? name.substr(1) : "board" + name;
}

// Frame of the array of a board.
inline std::string frame_of(const std::string& board) { return "tactile_" + name_of(board); }

// True for a force in newtons that may be acted on. A nominal one, of published sensitivities, counts only where
// `calibrated_only` is false: standard messages cannot say that a force is nominal.
inline bool is_in_newtons(const tactiled::Force& force, bool calibrated_only)
{
    return force.valid && force.calibration != "none" && !(calibrated_only && force.calibration == "nominal");
}

// Force of the object on the skin in newtons, torque about the origin of the array in newton metres.
inline void convert(const tactiled::Force& from, geometry_msgs::msg::WrenchStamped& to, const std::string& frame_id)
{
    constexpr double M_PER_MM = 1e-3;
    to.header = header(from.timestamp, frame_id);
    to.wrench.force.x = from.fx_n;
    to.wrench.force.y = from.fy_n;
    to.wrench.force.z = from.fz_n;
    to.wrench.torque.x = M_PER_MM * from.tx_nmm;
    to.wrench.torque.y = M_PER_MM * from.ty_nmm;
    to.wrench.torque.z = M_PER_MM * from.tz_nmm;
}

// Contact as a status implies it: after an interruption that of the status, without taxels; during one (`is_lost`)
// unknown and not valid, so that a late subscriber does not receive the state before it. `seq` is -1, because the
// daemon did not send it.
inline tactiled::Contact contact_of(const tactiled::Status& status, const std::string& previous, bool is_lost,
                                    double unix_s)
{
    tactiled::Contact contact;
    contact.v = status.v;
    contact.timestamp = unix_s;
    contact.seq = -1;
    contact.board = status.board;
    contact.run = status.run;
    contact.state = is_lost ? tactiled::Contact::STATE_UNKNOWN : status.contact.c_str();
    contact.previous = previous;
    contact.valid = !is_lost;
    return contact;
}

// What the driver knows of its board, with the rules of `tactiled ros2` for what is fresh.
struct BoardState {
    std::string board;
    bool is_active = false;
    tactiled::Status status;  // newest one; its version is 0 before the first one
    double status_s = -std::numeric_limits<double>::infinity();  // when it was received, monotonic
    double status_age_s = 0.0;                                   // its age then
    std::string calibration = "none";                            // of the newest force
    // Messages that were not published: old ones; those that cannot be read; those the middleware did not take.
    std::uint64_t too_old = 0, malformed = 0, refused = 0;

    // True while messages about the skin may be published.
    bool is_fresh(double now_s) const
    {
        return status.valid && now_s - status_s <= FRESH_S && std::abs(status_age_s) <= FRESH_S;
    }
};

// Level and text in the diagnostics.
struct Verdict {
    unsigned char level;
    std::string text;
};

inline Verdict verdict(const BoardState& state, double now_s)
{
    using diagnostic_msgs::msg::DiagnosticStatus;
    const tactiled::Status& status = state.status;
    const double silent_s = now_s - state.status_s, age_s = std::abs(state.status_age_s);
    char text[96];
    if (!state.is_active)
        return {DiagnosticStatus::STALE, "the node is not active"};
    if (status.v == 0)
        return {DiagnosticStatus::STALE, "no status was received: is tactiled running?"};
    if (silent_s > FRESH_S) {
        std::snprintf(text, sizeof text, "no status for %.1f s: is tactiled running?", silent_s);
        return {DiagnosticStatus::STALE, text};
    }
    if (age_s > FRESH_S) {
        std::snprintf(text, sizeof text, "status is %.1f s off: messages wait, or the clocks differ", age_s);
        return {DiagnosticStatus::STALE, text};
    }
    if (!status.valid)
        return {DiagnosticStatus::ERROR, status.reason.empty() ? status.state : status.reason};
    if (!status.warning.empty())
        return {DiagnosticStatus::WARN, status.warning};
    return {DiagnosticStatus::OK, status.state};
}

inline diagnostic_msgs::msg::DiagnosticArray diagnostics(const BoardState& state, double now_s, double unix_s)
{
    diagnostic_msgs::msg::DiagnosticArray array;
    array.header = header(unix_s, "");
    auto& entry = array.status.emplace_back();
    const Verdict found = verdict(state, now_s);
    entry.level = found.level;
    entry.message = found.text;
    entry.name = "tactiled " + state.board;
    entry.hardware_id = state.board;
    const auto add = [&entry](const char* key, const std::string& value) {
        auto& pair = entry.values.emplace_back();
        pair.key = key;
        pair.value = value;
    };
    if (state.status.v != 0) {
        char rate_hz[32];
        std::snprintf(rate_hz, sizeof rate_hz, "%.6g", state.status.rate_hz);
        add("state", state.status.state);
        add("contact", state.status.contact);
        add("rate_hz", rate_hz);
        add("scans", std::to_string(state.status.scans));
        add("scans_missing", std::to_string(state.status.scans_missing));
        add("frames_corrupt", std::to_string(state.status.frames_corrupt));
    }
    add("force_calibration", state.calibration);
    add("messages_too_old", std::to_string(state.too_old));
    add("messages_malformed", std::to_string(state.malformed));
    add("messages_refused", std::to_string(state.refused));
    return array;
}

}  // namespace tactiled_driver
