// Values of msgpack: read from their bytes one after the other, without an allocation, and written.
//
// After a wait, caches are cold: a parser that makes an object of each value delays a message. Whatever the bytes
// claim, nothing beyond their end is read.
//
// Needs C++17.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <exception>
#include <map>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace tactiled {

namespace detail {

// The bytes are no value, or one of another type than what is asked for.
struct Unreadable : std::exception {};

// Values in their order (github.com/msgpack/msgpack, spec.md). All that takes one throws Unreadable.
class Values {
public:
    explicit Values(std::string_view bytes) : at_(bytes.data()), end_(bytes.data() + bytes.size()) {}

    bool is_at_end() const { return at_ == end_; }
    bool is_text() const { return (peek() & 0xE0) == 0xA0 || (peek() >= 0xD9 && peek() <= 0xDB); }
    bool is_bool() const { return peek() == 0xC2 || peek() == 0xC3; }
    bool is_binary() const { return peek() >= 0xC4 && peek() <= 0xC6; }
    bool is_ext() const { return (peek() >= 0xC7 && peek() <= 0xC9) || (peek() >= 0xD4 && peek() <= 0xD8); }
    bool is_array() const { return (peek() & 0xF0) == 0x90 || peek() == 0xDC || peek() == 0xDD; }
    bool is_map() const { return (peek() & 0xF0) == 0x80 || peek() == 0xDE || peek() == 0xDF; }

    // Bytes from here to a later place.
    std::string_view until(const Values& later) const
    {
        return {at_, static_cast<std::size_t>(later.at_ - at_)};
    }

    bool take_bool()
    {
        const unsigned head = take_head();
        need(head == 0xC2 || head == 0xC3);
        return head == 0xC3;
    }

    double take_float()
    {
        const unsigned head = take_head();
        need(head == 0xCA || head == 0xCB);
        return head == 0xCB ? as<double>(number<std::uint64_t>()) : as<float>(number<std::uint32_t>());
    }

    // Float, or a whole number.
    double take_number()
    {
        if (peek() == 0xCA || peek() == 0xCB)
            return take_float();
        const Whole whole = take_whole();
        return whole.is_negative ? static_cast<double>(static_cast<std::int64_t>(whole.bits))
                                 : static_cast<double>(whole.bits);
    }

    std::int64_t take_int()
    {
        const Whole whole = take_whole();
        need(whole.is_negative || whole.bits <= static_cast<std::uint64_t>(INT64_MAX));
        return static_cast<std::int64_t>(whole.bits);
    }

    // Whole number from 0 on, below a limit.
    std::uint64_t take_count(std::uint64_t limit)
    {
        const Whole whole = take_whole();
        need(!whole.is_negative && whole.bits < limit);
        return whole.bits;
    }

    // Whole number from 0 to a limit; what is beyond counts as the limit.
    std::uint64_t take_clamped(std::uint64_t most)
    {
        const Whole whole = take_whole();
        return whole.is_negative ? 0 : std::min(whole.bits, most);
    }

    std::string_view take_text()
    {
        need(is_text());
        const unsigned head = take_head();
        return take_bytes(head < 0xC0 ? head & 0x1F : size_of(head - 0xD9));
    }

    // Type and data of an extension.
    std::string_view take_ext()
    {
        need(is_ext());
        const unsigned head = take_head();
        return take_bytes((head < 0xD4 ? size_of(head - 0xC7) : std::uint64_t{1} << (head - 0xD4)) + 1);
    }

    // Number of entries, which follow.
    std::uint64_t take_array()
    {
        need(is_array());
        return take_entries(0xDB);
    }

    // Number of pairs, which follow.
    std::uint64_t take_map()
    {
        need(is_map());
        return take_entries(0xDD);
    }

    // Pass over the next value with all that it contains, and return it as bytes.
    std::string_view skip()
    {
        const Values before = *this;
        for (std::uint64_t n_left = 1; n_left > 0; --n_left) {
            const unsigned head = take_head();
            if (head < 0x80 || head >= 0xE0)  // small whole numbers
                continue;
            if (head < 0x90)  // map
                n_left += 2 * (head & 0x0F);
            else if (head < 0xA0)  // array
                n_left += head & 0x0F;
            else if (head < 0xC0)  // text
                take_bytes(head & 0x1F);
            else if (head < 0xC4)  // nil, false, true; 0xC1 begins nothing
                need(head != 0xC1);
            else if (head < 0xC7)  // binary data
                take_bytes(size_of(head - 0xC4));
            else if (head < 0xCA)  // extension
                take_bytes(size_of(head - 0xC7) + 1);
            else if (head < 0xCC)  // float
                take_bytes(head == 0xCA ? 4 : 8);
            else if (head < 0xD4)  // whole number
                take_bytes(std::uint64_t{1} << (head & 3));
            else if (head < 0xD9)  // extension of a fixed size
                take_bytes((std::uint64_t{1} << (head - 0xD4)) + 1);
            else if (head < 0xDC)  // text
                take_bytes(size_of(head - 0xD9));
            else if (head < 0xDE)  // array
                n_left += size_of(head - 0xDB);
            else  // map
                n_left += 2 * size_of(head - 0xDD);
        }
        return before.until(*this);
    }

private:
    struct Whole {
        std::uint64_t bits;
        bool is_negative;
    };

    static void need(bool holds)
    {
        if (!holds)
            throw Unreadable();
    }

    // Head of the next value; at the end 0xC1, which begins none.
    unsigned peek() const { return at_ < end_ ? static_cast<std::uint8_t>(*at_) : 0xC1; }

    unsigned take_head()
    {
        need(at_ < end_);
        return static_cast<std::uint8_t>(*at_++);
    }

    std::string_view take_bytes(std::uint64_t size)
    {
        need(size <= static_cast<std::uint64_t>(end_ - at_));
        at_ += size;
        return {at_ - size, static_cast<std::size_t>(size)};
    }

    // Number of entries, by a head that counts in 2 bytes where it is `before` + 1, and in 4 one further on.
    std::uint64_t take_entries(unsigned before)
    {
        const unsigned head = take_head();
        const std::uint64_t count = head < 0xC0 ? head & 0x0F : size_of(head - before);
        // Each entry has a byte or more: no memory is taken for what a head claims alone.
        need(count <= static_cast<std::uint64_t>(end_ - at_));
        return count;
    }

    // Number in big-endian order.
    template <class T> T number()
    {
        T found = 0;
        for (const char byte : take_bytes(sizeof found))
            found = static_cast<T>(found << 8 | static_cast<std::uint8_t>(byte));
        return found;
    }

    // Size in 1, 2 or 4 bytes.
    std::uint64_t size_of(unsigned log2_bytes)
    {
        return log2_bytes == 0   ? number<std::uint8_t>()
               : log2_bytes == 1 ? number<std::uint16_t>()
                                 : number<std::uint32_t>();
    }

    Whole take_whole()
    {
        const unsigned head = take_head();
        if (head < 0x80)
            return {head, false};
        if (head >= 0xE0)
            return of_signed(static_cast<std::int8_t>(head));
        switch (head) {
        case 0xCC: return {number<std::uint8_t>(), false};
        case 0xCD: return {number<std::uint16_t>(), false};
        case 0xCE: return {number<std::uint32_t>(), false};
        case 0xCF: return {number<std::uint64_t>(), false};
        case 0xD0: return of_signed(static_cast<std::int8_t>(number<std::uint8_t>()));
        case 0xD1: return of_signed(static_cast<std::int16_t>(number<std::uint16_t>()));
        case 0xD2: return of_signed(static_cast<std::int32_t>(number<std::uint32_t>()));
        case 0xD3: return of_signed(static_cast<std::int64_t>(number<std::uint64_t>()));
        default: throw Unreadable();
        }
    }

    static Whole of_signed(std::int64_t number)
    {
        return {static_cast<std::uint64_t>(number), number < 0};
    }

    template <class T, class Bits> static T as(Bits bits)
    {
        T number;
        static_assert(sizeof number == sizeof bits);
        std::memcpy(&number, &bits, sizeof number);
        return number;
    }

    const char *at_, *end_;
};

// Entry of a map whose key is a text; its value as bytes.
struct Entry {
    std::string_view key, value;
};

// Read the entries of a map whose keys are texts.
inline void read_entries(std::string_view map, std::vector<Entry>& out)
{
    Values values(map);
    out.clear();
    for (std::uint64_t n_left = values.take_map(); n_left > 0; --n_left) {
        const bool has_text = values.is_text();
        const std::string_view key = has_text ? values.take_text() : values.skip();
        const std::string_view value = values.skip();
        if (has_text)
            out.push_back({key, value});
    }
}

// Value of a key; empty without one. Of a repeated key the last one counts.
inline std::string_view find(const std::vector<Entry>& entries, std::string_view key)
{
    for (std::size_t n = entries.size(); n-- > 0;)
        if (entries[n].key == key)
            return entries[n].value;
    return {};
}

// Map with the interface that `from_json` of tactiled_events.hpp asks for. `entries` are its memory.
class MapView {
public:
    struct Field {
        Values values;
        template <class T> void get_to(T& out) { fill(values, out); }
    };

    MapView(std::string_view bytes, std::vector<Entry>& entries) : entries_(entries)
    {
        read_entries(bytes, entries_);
    }

    // Value of a key; without one, a value that cannot be read.
    Field at(std::string_view key) const { return {Values(find(entries_, key))}; }

private:
    static void fill(Values& values, bool& out) { out = values.take_bool(); }
    static void fill(Values& values, double& out) { out = values.take_number(); }
    static void fill(Values& values, std::int64_t& out) { out = values.take_int(); }
    static void fill(Values& values, std::string& out) { out = values.take_text(); }

    template <class T> static void fill(Values& values, std::vector<T>& out)
    {
        out.resize(static_cast<std::size_t>(values.take_array()));
        for (std::size_t n = 0; n < out.size(); ++n) {
            if constexpr (std::is_same_v<T, bool>)
                out[n] = values.take_bool();
            else
                fill(values, out[n]);
        }
    }

    template <class T> static void fill(Values& values, T& out)  // a structure within a message
    {
        std::vector<Entry> entries;
        from_json(MapView(values.skip(), entries), out);
    }

    std::vector<Entry>& entries_;
};

// Writes values one after the other.
class Packer {
public:
    explicit Packer(std::string& out) : out_(out) {}

    // Begin a map or an array, whose entries follow.
    Packer& pack_map(std::size_t n_pairs) { return put_head(0xDF, n_pairs, 4); }
    Packer& pack_array(std::size_t n_values) { return put_head(0xDD, n_values, 4); }

    Packer& pack(std::string_view text)
    {
        put_head(0xDB, text.size(), 4);
        out_.append(text);
        return *this;
    }

    template <class T> Packer& pack(const std::vector<T>& values)
    {
        pack_array(values.size());
        for (const T& value : values)
            pack(value);
        return *this;
    }

    template <class T> Packer& pack(const std::map<std::string, T>& values)
    {
        pack_map(values.size());
        for (const auto& [key, value] : values)
            pack(key).pack(value);
        return *this;
    }

    template <class T, class = std::enable_if_t<std::is_arithmetic_v<T>>> Packer& pack(T number)
    {
        if constexpr (std::is_same_v<T, bool>) {
            out_ += number ? '\xC3' : '\xC2';
            return *this;
        } else if constexpr (std::is_floating_point_v<T>) {
            const double wide = static_cast<double>(number);
            std::uint64_t bits;
            std::memcpy(&bits, &wide, sizeof bits);
            return put_head(0xCB, bits, 8);
        } else {
            return put_head(number < 0 ? 0xD3 : 0xCF, static_cast<std::uint64_t>(number), 8);
        }
    }

private:
    // Write a head, and a number in big-endian order.
    Packer& put_head(unsigned head, std::uint64_t number, unsigned n_bytes)
    {
        out_ += static_cast<char>(head);
        while (n_bytes-- > 0)
            out_ += static_cast<char>(number >> 8 * n_bytes);
        return *this;
    }

    std::string& out_;
};

}  // namespace detail

}  // namespace tactiled
