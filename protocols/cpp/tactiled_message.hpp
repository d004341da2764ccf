// Messages as they arrive: checked bytes, the fields that every message has, and the structure of its topic.
//
// The same checks as tactiled.client.parse, and those of Python's msgpack, so that both clients take and
// refuse the same bytes. Pure: no input, no output, no clock.
//
// Needs C++17.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tactiled_events.hpp"
#include "tactiled_values.hpp"

namespace tactiled {

namespace detail {

constexpr std::size_t MOST_NESTED = 1024;  // containers in containers that Python's msgpack takes
constexpr std::uint64_t MESSAGE_VERSION = 1;
constexpr std::uint64_t SEQ_LIMIT = std::uint64_t{1} << 63;  // as in requests: protocols/control

// True for text that a strict decoder of UTF-8 takes: the shortest form, no surrogates, at most U+10FFFF.
inline bool is_utf8(std::string_view text)
{
    const auto byte = [text](std::size_t n) {
        return n < text.size() ? static_cast<unsigned char>(text[n]) : 0u;
    };
    std::size_t n = 0;
    while (n < text.size()) {
        const unsigned first = byte(n++);
        if (first < 0x80)
            continue;
        if (first < 0xC2 || first > 0xF4)
            return false;
        const unsigned second = byte(n);
        const unsigned least = first == 0xE0 ? 0xA0 : first == 0xF0 ? 0x90 : 0x80;
        const unsigned most = first == 0xED ? 0x9F : first == 0xF4 ? 0x8F : 0xBF;
        if (second < least || second > most)
            return false;
        const std::size_t end = n + (first < 0xE0 ? 1 : first < 0xF0 ? 2 : 3);
        for (++n; n < end; ++n)
            if ((byte(n) & 0xC0) != 0x80)
                return false;
    }
    return true;
}

// Fields that every message has, as bytes; empty where one is missing.
struct Head {
    std::string_view v, seq, timestamp, board, run;
    std::string_view evidence;     // empty where the timestamp is that of the evidence, too
    bool is_map_of_texts = false;  // the message is a map, and its keys are texts

    std::string_view* field_of(std::string_view key, std::string_view evidence_key)
    {
        return key == "v"            ? &v
               : key == "seq"        ? &seq
               : key == "timestamp"  ? &timestamp
               : key == "board"      ? &board
               : key == "run"        ? &run
               : key == evidence_key ? &evidence
                                     : nullptr;
    }
};

// True for type and data of an extension that Python's msgpack takes: types from 0 on, and -1 with a timestamp.
inline bool is_valid_ext(std::string_view ext)
{
    if (ext[0] != '\xFF')
        return static_cast<signed char>(ext[0]) >= 0;
    if (ext.size() == 5)
        return true;
    if (ext.size() != 9 && ext.size() != 13)
        return false;
    std::uint32_t nanoseconds = 0;
    for (std::size_t n = 1; n < 5; ++n)
        nanoseconds = nanoseconds << 8 | static_cast<unsigned char>(ext[n]);
    return (ext.size() == 9 ? nanoseconds >> 2 : nanoseconds) < 1'000'000'000;
}

// Take the key of a map, and return its text, which is empty for binary data. Throws Unreadable for other keys.
inline std::string_view take_key(Values& values)
{
    if (values.is_binary())
        return values.skip().substr(0, 0);
    const std::string_view text = values.take_text();
    if (!is_utf8(text))
        throw Unreadable();
    return text;
}

// Pass over a value in so many containers. Throws Unreadable for what Python's msgpack refuses.
inline void check_value(Values& values, std::size_t n_around)
{
    if (values.is_array() || values.is_map()) {
        if (n_around == MOST_NESTED)
            throw Unreadable();
        const bool is_map = values.is_map();
        for (std::uint64_t n_left = is_map ? values.take_map() : values.take_array(); n_left > 0; --n_left) {
            if (is_map)
                take_key(values);
            check_value(values, n_around + 1);
        }
    } else if (values.is_text()) {
        if (!is_utf8(values.take_text()))
            throw Unreadable();
    } else if (values.is_ext()) {
        if (!is_valid_ext(values.take_ext()))
            throw Unreadable();
    } else {
        values.skip();
    }
}

// Check that bytes are one value that Python's msgpack takes, and take note of the head of a message. Of a
// repeated key the last value counts.
inline bool check(std::string_view bytes, std::string_view evidence_key, Head& head)
{
    Values values(bytes);
    head = Head();
    head.is_map_of_texts = values.is_map();
    try {
        if (!values.is_map()) {
            check_value(values, 0);
            return values.is_at_end();
        }
        for (std::uint64_t n_left = values.take_map(); n_left > 0; --n_left) {
            head.is_map_of_texts = head.is_map_of_texts && values.is_text();
            const std::string_view key = take_key(values);
            const Values before = values;
            check_value(values, 1);
            if (std::string_view* const field = head.field_of(key, evidence_key))
                *field = before.until(values);
        }
        return values.is_at_end();
    } catch (const Unreadable&) {
        return false;
    }
}

// Read a field of a head by a method of Values; false where it is missing or of another type.
template <class Take, class T> bool read_field(std::string_view value, const Take& take, T& out)
{
    try {
        Values values(value);
        out = take(values);
        return true;
    } catch (const Unreadable&) {
        return false;
    }
}

// The same for a number that counts something.
inline bool read_count(std::string_view value, std::uint64_t& out)
{
    return read_field(value, [](Values& values) { return values.take_count(SEQ_LIMIT); }, out);
}

// The same for a floating-point number.
inline bool read_float(std::string_view value, double& out)
{
    return read_field(value, [](Values& values) { return values.take_float(); }, out);
}

inline bool is_true(std::string_view value) { return value == "\xC3"; }

// Text of a value; empty where it is none.
inline std::string_view text_of(std::string_view value)
{
    std::string_view text;
    read_field(value, [](Values& values) { return values.take_text(); }, text);
    return text;
}

// Keep one entry of each key, as a dict of Python does: in the place of the first, with the value of the last.
inline void keep_last(std::vector<Entry>& entries)
{
    const auto place = [](const Entry& entry) { return entry.key.data(); };  // all are views of one map
    std::sort(entries.begin(), entries.end(), [&place](const Entry& one, const Entry& other) {
        return std::pair(one.key, place(one)) < std::pair(other.key, place(other));
    });
    std::size_t n_kept = 0;
    for (const Entry& entry : entries) {
        if (n_kept > 0 && entries[n_kept - 1].key == entry.key)
            entries[n_kept - 1].value = entry.value;
        else
            entries[n_kept++] = entry;
    }
    entries.resize(n_kept);
    std::sort(entries.begin(), entries.end(),
              [&place](const Entry& one, const Entry& other) { return place(one) < place(other); });
}

// Check a map with string keys and a supported version, and read its head; false with the reason.
inline bool check_map(std::string_view payload, std::string_view name, Head& head, std::string& reason)
{
    const auto refuse = [&](const std::string& words) {
        reason.assign(name).append(": ").append(words);
        return false;
    };
    if (!check(payload, evidence_key(name), head))
        return refuse("not msgpack");
    if (!head.is_map_of_texts)
        return refuse("not a map with string keys");
    std::uint64_t version = 0;
    const bool has_version = read_count(head.v, version);
    if (!has_version || version != MESSAGE_VERSION) {
        const std::string found = has_version ? std::to_string(version) : "unknown";
        return refuse("version " + found + ", this client reads " + std::to_string(MESSAGE_VERSION));
    }
    return true;
}

}  // namespace detail

// Published event. `read` gives its fields.
struct Message {
    std::string topic;      // "slip", "grip", ...: one of TOPICS
    std::string board;      // serial number
    std::int64_t run = 0;   // identifies the run of the daemon
    std::uint64_t seq = 0;  // counts within board, topic and run
    // Physical instant that it is about, epoch seconds: of a slip, its onset or its end.
    double timestamp = 0.0;
    // Instant of its evidence, epoch seconds: `detected` of a slip, `answered` of a texture, else `timestamp`.
    double evidence = 0.0;
    double received_s = 0.0;       // `monotonic_s()` when it was read from the socket
    double received_unix_s = 0.0;  // the same instant by `unix_s()`
    std::string payload;           // msgpack map, as it came

    // Age of the evidence in seconds, where `now_s` is `monotonic_s()`. Act on a message by this age: a slip may
    // have begun long before anything could show it.
    double age_s(double now_s) const { return received_unix_s - evidence + now_s - received_s; }

    // The same of the timestamp: age of the beginning of a slip, or of its end.
    double onset_age_s(double now_s) const { return received_unix_s - timestamp + now_s - received_s; }

    // Read the fields into the structure of this topic, such as Slip (tactiled_events.hpp). False where the
    // message is of another topic, or where a field is missing or of another type; `out` may then hold some of
    // them. Keep `out` for the next message: its memory is used again.
    template <class T> bool read(T& out) const
    {
        if (topic != T::TOPIC)
            return false;
        thread_local std::vector<detail::Entry> entries;
        try {
            from_json(detail::MapView(payload, entries), out);
        } catch (const detail::Unreadable&) {
            return false;
        }
        return true;
    }
};

namespace detail {

// Fill the fields of a message, except its payload, from its head; false with the reason.
inline bool read_head(std::string_view topic, const Head& head, double now_s, double unix_s, Message& out,
                      std::string& reason)
{
    const auto refuse = [&](std::string_view words) {
        reason.assign(topic).append(": ").append(words);
        return false;
    };
    const auto read_instant = [](std::string_view value, double& instant) {
        return read_float(value, instant) && std::isfinite(instant);
    };
    std::uint64_t run = 0;
    std::string_view board;
    if (!read_count(head.seq, out.seq) || !read_instant(head.timestamp, out.timestamp))
        return refuse("seq or timestamp is missing or no number");
    if (!read_field(head.board, [](Values& values) { return values.take_text(); }, board) ||
        !read_count(head.run, run))
        return refuse("board or run is missing, or not what it should be");
    const std::string_view key = evidence_key(topic);
    if (!read_instant(key == "timestamp" ? head.timestamp : head.evidence, out.evidence))
        return refuse(std::string(key) + " is missing or no number");
    out.topic = topic;
    out.board = board;
    out.run = static_cast<std::int64_t>(run);
    out.received_s = now_s;
    out.received_unix_s = unix_s;
    return true;
}

}  // namespace detail

}  // namespace tactiled
