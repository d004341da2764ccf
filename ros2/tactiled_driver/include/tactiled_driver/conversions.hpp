// Standard messages of ROS 2 from the structures of tactiled, what may be published, and the verdict in /diagnostics.
// Pure: no node, no clock. own_messages.hpp has the messages of tactiled_msgs.
#pragma once

#include <array>
#include <cctype>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <limits>
#include <optional>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <string>
#include <string_view>
#include <tactiled_events.hpp>

#include "tactiled_driver/header.hpp"

namespace tactiled_driver {

constexpr double FRESH_S = 0.5;  // five periods of the status, as in the client
constexpr double M_PER_MM = 1e-3;

// Name of a board in topics and frames: letters and digits of ASCII, single underscores; TS_0001 for TS-0001.
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
    to.header = header(from.timestamp, frame_id);
    to.wrench.force.x = from.fx_n;
    to.wrench.force.y = from.fy_n;
    to.wrench.force.z = from.fz_n;
    to.wrench.torque.x = M_PER_MM * from.tx_nmm;
    to.wrench.torque.y = M_PER_MM * from.ty_nmm;
    to.wrench.torque.z = M_PER_MM * from.tz_nmm;
}

// Place of each taxel in metres, and force of the object on it in newtons; false where info or force has none.
inline bool convert(const tactiled::Force& from, const tactiled::Info& info, sensor_msgs::msg::PointCloud2& to,
                    const std::string& frame_id)
{
    using Point = std::array<float, 6>;
    static constexpr std::array<const char*, 6> NAMES = {"x", "y", "z", "fx", "fy", "fz"};
    const std::size_t n_taxels = info.x_mm.size();
    for (const auto* values : {&info.y_mm, &from.taxel_fx_n, &from.taxel_fy_n, &from.taxel_fz_n})
        if (n_taxels == 0 || values->size() != n_taxels)
            return false;
    to.header = header(from.timestamp, frame_id);
    to.height = 1;
    to.width = static_cast<std::uint32_t>(n_taxels);
    to.fields.resize(NAMES.size());
    for (std::size_t n = 0; n < NAMES.size(); ++n) {
        to.fields[n].name = NAMES[n];
        to.fields[n].offset = static_cast<std::uint32_t>(n * sizeof(float));
        to.fields[n].datatype = sensor_msgs::msg::PointField::FLOAT32;
        to.fields[n].count = 1;
    }
    to.is_bigendian = __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__;
    to.point_step = sizeof(Point);
    to.row_step = to.point_step * to.width;
    to.is_dense = true;
    to.data.resize(to.row_step);
    for (std::size_t n = 0; n < n_taxels; ++n) {
        const auto real = [](double value) { return static_cast<float>(value); };
        const Point point = {real(M_PER_MM * info.x_mm[n]), real(M_PER_MM * info.y_mm[n]), 0.0F,
                             real(from.taxel_fx_n[n]),      real(from.taxel_fy_n[n]),      real(from.taxel_fz_n[n])};
        std::memcpy(&to.data[n * sizeof(Point)], point.data(), sizeof(Point));
    }
    return true;
}

// True for topics that are silent while data may be old.
inline bool is_about_skin(std::string_view topic)
{
    return topic != "status" && topic != "info" && topic != "recording" && topic != "command";
}

// What the driver knows of its board, and what may be published of it.
struct BoardState {
    std::string board;
    bool is_active = false;
    tactiled::Status status;  // newest one; its version is 0 before the first one
    double status_s = -std::numeric_limits<double>::infinity();  // when it was received, monotonic
    double status_age_s = 0.0;                                   // its age then
    std::string calibration = "none";                            // of the newest force
    std::string contact = tactiled::Contact::STATE_UNKNOWN;      // newest state that was published
    bool is_contact_missed = false;                              // the newest status had another one when it came
    bool was_fresh = false;                                      // at the newest `changed_contact`
    // Messages that were not published: old ones; those that did not arrive; those that cannot be read; those the
    // middleware did not take.
    std::uint64_t too_old = 0, lost = 0, malformed = 0, refused = 0;

    // True while messages about the skin may be published.
    bool is_fresh(double now_s) const
    {
        return is_active && status.valid && now_s - status_s <= FRESH_S && std::abs(status_age_s) <= FRESH_S;
    }

    void take(const tactiled::Status& newest, double age_s, double now_s)
    {
        status = newest;
        status_s = now_s;
        status_age_s = age_s;
        is_contact_missed = status.contact != contact;  // the daemon had sent its change before
    }

    // True where a message that was received now may be published; others are counted. An age below 0 shows that a
    // clock was set.
    bool admit(std::string_view topic, double age_s, double now_s)
    {
        const bool is_admitted = std::abs(age_s) <= FRESH_S && (!is_about_skin(topic) || is_fresh(now_s));
        too_old += !is_admitted;
        return is_admitted;
    }

    // Contact in place of the latched one. When the board becomes stale, it is unknown and not valid, so that a late
    // subscriber does not receive the state before it. When the board is fresh again, or a contact was missed, it is
    // that of the status, without taxels. Otherwise there is none. `seq` is -1, because the daemon did not send it.
    std::optional<tactiled::Contact> changed_contact(double now_s, double unix_s)
    {
        const bool is_fresh_now = is_fresh(now_s);
        if (is_fresh_now == was_fresh && !(is_fresh_now && is_contact_missed))
            return std::nullopt;
        was_fresh = is_fresh_now;
        is_contact_missed = false;
        tactiled::Contact made;
        made.v = status.v;
        made.timestamp = unix_s;
        made.seq = -1;
        made.board = board;
        made.run = status.run;
        made.state = was_fresh ? status.contact : tactiled::Contact::STATE_UNKNOWN;
        made.previous = contact;
        made.valid = was_fresh;
        contact = made.state;
        return made;
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
    if (status.v == 0 && state.malformed > 0)
        return {DiagnosticStatus::STALE, "no status can be read: is tactiled of another version?"};
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
    add("messages_lost", std::to_string(state.lost));
    add("messages_malformed", std::to_string(state.malformed));
    add("messages_refused", std::to_string(state.refused));
    return array;
}

}  // namespace tactiled_driver
