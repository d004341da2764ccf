// Messages as they arrive: checked bytes, the fields that every message has, and the structure of its topic.
//
// The same checks as tactiled.client.parse, and those of Python's msgpack, so that both clients take and
// refuse the same bytes. Pure: no input, no output, no clock.
//
// Needs C++17, msgpack-cxx and tactiled_events.hpp.
#pragma once

#ifndef MSGPACK_NO_BOOST
#define MSGPACK_NO_BOOST
#endif

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <msgpack.hpp>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "tactiled_events.hpp"

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

// Fields that every message has; NIL where one is missing or cannot be what it should. Texts refer to the payload.
struct Head {
    msgpack::object v, seq, timestamp, board, run;
    msgpack::object evidence;  // NIL where the timestamp is that of the evidence, too
};

// Refuses what Python's msgpack refuses, and takes note of the head, without allocating, whatever sizes the bytes
// claim. After a wait, caches are cold: each further pass over the bytes would delay the message.
class Checker : public msgpack::null_visitor {
public:
    Checker(Head& head, std::string_view evidence_key) : head_(head), evidence_key_(evidence_key) {}

    bool is_map_with_texts() const { return is_map_ && !has_other_key_; }

    bool visit_nil() { return note({}); }
    bool visit_boolean(bool) { return note({}); }
    bool visit_positive_integer(std::uint64_t value) { return note(msgpack::object(value)); }
    bool visit_negative_integer(std::int64_t value)  // a signed form, which may hold a number above zero
    {
        return value < 0 ? note({}) : visit_positive_integer(static_cast<std::uint64_t>(value));
    }
    bool visit_float32(float value) { return note(msgpack::object(value)); }
    bool visit_float64(double value) { return note(msgpack::object(value)); }
    bool visit_ext(const char* data, std::uint32_t size) { return note({}) && is_ext({data, size}); }
    bool visit_bin(const char*, std::uint32_t)
    {
        has_other_key_ = has_other_key_ || (in_key_ && depth_ == 1);
        return note({}) || in_key_;
    }
    bool visit_str(const char* text, std::uint32_t size)
    {
        msgpack::object value;
        value.type = msgpack::type::STR;
        value.via.str = {size, text};
        if (in_key_ && depth_ == 1)
            field_ = field_of({text, size});
        return (in_key_ || note(value)) && is_utf8({text, size});
    }
    bool start_array(std::uint32_t) { return begin(); }
    bool start_map(std::uint32_t) { return begin() && ((is_map_ |= depth_ == 1), true); }
    bool end_array() { return end(); }
    bool end_map() { return end(); }
    bool start_map_key() { return in_key_ = true; }
    bool end_map_key() { return !(in_key_ = false); }

private:
    bool begin() { return note({}) && ++depth_ <= MOST_NESTED; }
    bool end() { return depth_-- > 0; }

    // Of a repeated key the last value counts. False for a key.
    bool note(const msgpack::object& value)
    {
        if (field_ && depth_ == 1 && !in_key_)
            *field_ = value;
        return !in_key_;
    }

    msgpack::object* field_of(std::string_view key)
    {
        return key == "v"             ? &head_.v
               : key == "seq"         ? &head_.seq
               : key == "timestamp"   ? &head_.timestamp
               : key == "board"       ? &head_.board
               : key == "run"         ? &head_.run
               : key == evidence_key_ ? &head_.evidence
                                      : nullptr;
    }

    // Type and data; a timestamp, which has type -1, must be one.
    static bool is_ext(std::string_view ext)
    {
        if (ext[0] != '\xFF' || ext.size() == 5)
            return ext[0] != '\xFF' || ext.size() == 5;
        if (ext.size() != 9 && ext.size() != 13)
            return false;
        std::uint32_t nanoseconds = 0;
        for (std::size_t n = 1; n < 5; ++n)
            nanoseconds = nanoseconds << 8 | static_cast<unsigned char>(ext[n]);
        return (ext.size() == 9 ? nanoseconds >> 2 : nanoseconds) < 1'000'000'000;
    }

    Head& head_;
    std::string_view evidence_key_;
    msgpack::object* field_ = nullptr;  // of the newest key
    bool in_key_ = false, is_map_ = false, has_other_key_ = false;
    std::size_t depth_ = 0;
};

inline bool is_number(const msgpack::object* value)
{
    return value && (value->type == msgpack::type::FLOAT64 || value->type == msgpack::type::FLOAT32);
}

// True for whole numbers from 0 on, below a limit.
inline bool is_count(const msgpack::object* value, std::uint64_t limit = SEQ_LIMIT)
{
    return value && value->type == msgpack::type::POSITIVE_INTEGER && value->via.u64 < limit;
}

inline bool is_text(const msgpack::object& value) { return value.type == msgpack::type::STR; }

inline bool is_true(const msgpack::object* value)
{
    return value && value->type == msgpack::type::BOOLEAN && value->via.boolean;
}

inline std::string_view text_of(const msgpack::object& value)
{
    return {value.via.str.ptr, value.via.str.size};
}

// Entry of a map; nullptr without one. Of a repeated key the last one counts.
inline const msgpack::object_kv* find_entry(const msgpack::object& map, std::string_view key)
{
    for (std::uint32_t n = map.via.map.size; n-- > 0;) {
        const msgpack::object_kv& entry = map.via.map.ptr[n];
        if (is_text(entry.key) && text_of(entry.key) == key)
            return &entry;
    }
    return nullptr;
}

inline const msgpack::object* find(const msgpack::object& map, std::string_view key)
{
    const msgpack::object_kv* entry = find_entry(map, key);
    return entry ? &entry->val : nullptr;
}

// Entries of a map with one key: number of the first, which has the place, and of the last, which has the
// value.
using KeyEntries = std::pair<std::uint32_t, std::uint32_t>;

// Entries of each key of a checked map, in the order of a dict of Python.
inline void find_keys(const msgpack::object_map& map, std::vector<KeyEntries>& out)
{
    const auto key = [&map](const KeyEntries& entries) {
        const msgpack::object& found = map.ptr[entries.first].key;
        if (found.type == msgpack::type::BIN)  // no other type than this and text passes the check
            return std::pair(true, std::string_view(found.via.bin.ptr, found.via.bin.size));
        return std::pair(false, text_of(found));
    };
    out.clear();
    for (std::uint32_t n = 0; n < map.size; ++n)
        out.emplace_back(n, n);
    std::sort(out.begin(), out.end(), [&key](const KeyEntries& one, const KeyEntries& other) {
        return std::pair(key(one), one.first) < std::pair(key(other), other.first);
    });
    std::size_t count = 0;
    for (const KeyEntries& entries : out) {
        if (count > 0 && key(out[count - 1]) == key(entries))
            out[count - 1].second = entries.second;
        else
            out[count++] = entries;
    }
    out.resize(count);
    std::sort(out.begin(), out.end());
}

// Take the first of the values that begin here, as bytes. msgpack-cxx cannot pack again what it has unpacked:
// it makes integers of floats like 1.0.
inline std::string_view take_value(std::string_view& values)
{
    msgpack::null_visitor visitor;
    std::size_t size = 0;
    msgpack::parse(values.data(), values.size(), size, visitor);
    const std::string_view first = values.substr(0, size);
    values.remove_prefix(size);
    return first;
}

// What follows a key that is not empty, in the payload that was unpacked.
inline std::string_view behind_key(const msgpack::object& key, std::string_view payload)
{
    return payload.substr(static_cast<std::size_t>(key.via.str.ptr + key.via.str.size - payload.data()));
}

// What follows the head of an array or a map.
inline std::string_view behind_head(std::string_view values)
{
    const char head = values[0];
    return values.substr(head == '\xDC' || head == '\xDE' ? 3 : head == '\xDD' || head == '\xDF' ? 5 : 1);
}

// Unpack a checked payload, which the object refers to, as it does to the zone.
inline msgpack::object unpack(msgpack::zone& zone, std::string_view payload)
{
    zone.clear();
    const auto refer = [](msgpack::type::object_type, std::size_t, void*) { return true; };
    return msgpack::unpack(zone, payload.data(), payload.size(), refer);
}

// Check that the payload is one value.
inline bool check(std::string_view payload, Checker& checker)
{
    std::size_t end = 0;
    return !payload.empty() && msgpack::parse(payload.data(), payload.size(), end, checker) &&
           end == payload.size();
}

// Check a map with string keys and a supported version, and read its head; false with the reason.
inline bool check_map(std::string_view payload, std::string_view name, Head& head, std::string& reason)
{
    const auto refuse = [&](const std::string& words) {
        reason.assign(name).append(": ").append(words);
        return false;
    };
    head = Head();
    Checker checker(head, evidence_key(name));
    if (!check(payload, checker))
        return refuse("not msgpack");
    if (!checker.is_map_with_texts())
        return refuse("not a map with string keys");
    if (!is_count(&head.v) || head.v.via.u64 != MESSAGE_VERSION) {
        const std::string found = is_count(&head.v) ? std::to_string(head.v.via.u64) : "unknown";
        return refuse("version " + found + ", this client reads " + std::to_string(MESSAGE_VERSION));
    }
    return true;
}

// Map with the interface that `from_json` of tactiled_events.hpp asks for.
class MapView {
public:
    struct Value {
        const msgpack::object& object;
        template <class T> void get_to(T& out) const { fill(object, out); }
    };

    explicit MapView(const msgpack::object& object) : map_(object)
    {
        if (object.type != msgpack::type::MAP)
            throw msgpack::type_error();
    }

    Value at(std::string_view key) const
    {
        if (const msgpack::object* value = find(map_, key))
            return Value{*value};
        throw std::out_of_range(std::string(key));
    }

private:
    template <class T> static void fill(const msgpack::object& object, T& out)
    {
        if constexpr (std::is_arithmetic_v<T> || std::is_same_v<T, std::string>)
            object.convert(out);
        else
            from_json(MapView(object), out);
    }

    template <class T> static void fill(const msgpack::object& object, std::vector<T>& out)
    {
        if (object.type != msgpack::type::ARRAY)
            throw msgpack::type_error();
        out.resize(object.via.array.size);
        for (std::uint32_t n = 0; n < object.via.array.size; ++n) {
            if constexpr (std::is_same_v<T, bool>)
                out[n] = object.via.array.ptr[n].as<bool>();
            else
                fill(object.via.array.ptr[n], out[n]);
        }
    }

    msgpack::object map_;
};

}  // namespace detail

// Published event.
struct Message {
    std::string topic;
    std::string board;      // serial number
    std::int64_t run = 0;   // of the daemon
    std::uint64_t seq = 0;  // within board, topic and run
    double timestamp =
        0.0;  // physical instant that it is about, epoch seconds: of a slip, its onset or its end
    double evidence = 0.0;    // instant of its evidence: `detected` of a slip, `answered` of a texture
    double received_s = 0.0;  // monotonic clock when it was read from the socket
    double received_unix_s = 0.0;
    std::string payload;  // msgpack map, as it came

    // Age of the evidence, seconds. Act on a message by this age: a slip may have begun long before anything
    // could show it.
    double age_s(double now_s) const { return received_unix_s - evidence + now_s - received_s; }

    // Age of the timestamp: of the beginning of a slip, or of its end.
    double onset_age_s(double now_s) const { return received_unix_s - timestamp + now_s - received_s; }

    // Read the fields into the structure of this topic. False where the message is of another topic, or where
    // a field is missing or of another type; `out` may then hold some of them. Keep `out` for the next
    // message: its memory is used again.
    template <class T> bool read(T& out) const
    {
        if (topic != T::TOPIC)
            return false;
        thread_local msgpack::zone zone;
        try {
            from_json(detail::MapView(detail::unpack(zone, payload)), out);
        } catch (const std::exception&) {  // std::out_of_range, msgpack::type_error
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
    const auto is_instant = [](const msgpack::object& value) {
        return is_number(&value) && std::isfinite(value.via.f64);
    };
    if (!is_count(&head.seq) || !is_instant(head.timestamp))
        return refuse("seq or timestamp is missing or no number");
    if (!is_text(head.board) || !is_count(&head.run))
        return refuse("board or run is missing, or not what it should be");
    const std::string_view key = evidence_key(topic);
    const msgpack::object& evidence = key == "timestamp" ? head.timestamp : head.evidence;
    if (!is_instant(evidence))
        return refuse(std::string(key) + " is missing or no number");
    out.topic = topic;
    out.board = text_of(head.board);
    out.run = static_cast<std::int64_t>(head.run.via.u64);
    out.seq = head.seq.via.u64;
    out.timestamp = head.timestamp.via.f64;
    out.evidence = evidence.via.f64;
    out.received_s = now_s;
    out.received_unix_s = unix_s;
    return true;
}

}  // namespace detail

}  // namespace tactiled
