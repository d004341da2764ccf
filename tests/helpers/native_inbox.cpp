// Plays streams of frames, replies and passing time to the inbox of C++; prints what comes out as JSON, a
// line for each line of the input:
//
//     inbox NAME STALE_AFTER_S NOW_S CATCH_UP BOARD TOPIC...   a new inbox; "-" for all boards
//     frames NOW_S UNIX_S FRAME...                             a message, each frame in hex after an "x"
//     reply NOW_S UNIX_S REPLY
//     tick NOW_S
//     sent NOW_S COUNT                                         so many requests have left
//     endpoint ENDPOINT                                        prints its endpoint for requests
//     pack                                                     prints a map of values of each type, in hex
#include <iomanip>
#include <iostream>
#include <memory>
#include <sstream>

#include "tactiled.hpp"

static std::string bytes_of(const std::string& hex)
{
    const auto digit = [&hex](std::size_t n) { return hex[n] <= '9' ? hex[n] - '0' : hex[n] - 'a' + 10; };
    std::string bytes;
    for (std::size_t n = 1; n + 1 < hex.size(); n += 2)
        bytes += static_cast<char>(16 * digit(n) + digit(n + 1));
    return bytes;
}

static std::string hex_of(const std::string& bytes)
{
    std::string hex;
    for (const unsigned char each : bytes)
        hex.append({"0123456789abcdef"[each >> 4], "0123456789abcdef"[each & 15]});
    return hex;
}

static std::string quoted(const std::string& text)
{
    std::ostringstream out;
    out << '"';
    for (const unsigned char each : text) {
        if (each < 0x20 || each == '"' || each == '\\')
            out << "\\u" << std::hex << std::setw(4) << std::setfill('0') << int(each);
        else
            out << each;
    }
    out << '"';
    return out.str();
}

static std::string number(double value)
{
    if (!std::isfinite(value))
        return std::isnan(value) ? "NaN" : value > 0 ? "Infinity" : "-Infinity";
    char text[40];
    std::snprintf(text, sizeof text, "%.17g", value);
    return text;
}

static void print(const tactiled::Item& item, double now_s)
{
    const tactiled::Message& message = item.message;
    switch (item.kind) {
    case tactiled::Kind::MESSAGE:
    case tactiled::Kind::RECOVERED:
        std::cout << (item.kind == tactiled::Kind::MESSAGE ? "[\"Message\"," : "[\"Recovered\",")
                  << quoted(message.topic) << "," << quoted(message.board) << "," << message.run << ","
                  << message.seq << "," << number(message.timestamp) << "," << number(message.received_s)
                  << "," << number(message.age_s(now_s)) << "," << number(message.onset_age_s(now_s)) << ","
                  << quoted(hex_of(message.payload)) << "]";
        break;
    case tactiled::Kind::LOST:
        std::cout << "[\"Lost\"," << quoted(item.topic) << "," << quoted(item.board) << "," << item.count
                  << "]";
        break;
    case tactiled::Kind::RESTARTED: std::cout << "[\"Restarted\"," << quoted(item.board) << "]"; break;
    case tactiled::Kind::STALE:
        std::cout << "[\"Stale\"," << quoted(item.reason) << "," << number(item.silent_s) << "]";
        break;
    case tactiled::Kind::FRESH: std::cout << "[\"Fresh\"]"; break;
    case tactiled::Kind::MALFORMED: std::cout << "[\"Malformed\"," << quoted(item.reason) << "]"; break;
    }
}

static std::string packed_values()
{
    std::string out;
    tactiled::detail::Packer packer(out);
    packer.pack_map(6).pack("true").pack(true).pack("false").pack(false);
    packer.pack("whole").pack_array(6).pack(0).pack(std::uint8_t{127}).pack(std::int8_t{-1});
    packer.pack(INT64_MIN).pack(INT64_MAX).pack(UINT64_MAX);
    packer.pack("floats").pack(std::vector<double>{0.5, -1e300, 0.25});
    packer.pack("texts").pack(std::vector<std::string>{"", "Gr\u00f6\u00dfe", std::string(70000, 'x')});
    packer.pack("map").pack(std::map<std::string, std::vector<float>>{{"a", {1.5f}}, {"b", {}}});
    return out;
}

int main()
{
    std::unique_ptr<tactiled::Inbox> inbox;
    tactiled::Items items;
    std::string line, what;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        const auto seconds = [&words] {
            std::string word;
            words >> word;
            return std::stod(word);
        };
        const auto text = [&words] {
            std::string word;
            words >> word;
            return word;
        };
        words >> what;
        if (what == "endpoint") {
            std::cout << quoted(tactiled::control_endpoint(text())) << "\n";
            continue;
        }
        if (what == "pack") {
            std::cout << quoted(hex_of(packed_values())) << "\n";
            continue;
        }
        double now_s = 0.0;
        if (what == "inbox") {
            const std::string name = text();
            const double stale_after_s = seconds();
            now_s = seconds();
            const bool catch_up = text() == "1";
            const std::string board = text();
            tactiled::Wanted wanted{{}, board == "-" ? "" : board};
            for (std::string topic = text(); !topic.empty(); topic = text())
                wanted.topics.push_back(topic);
            inbox = std::make_unique<tactiled::Inbox>(wanted, stale_after_s, now_s, catch_up, name);
        } else if (what == "frames") {
            now_s = seconds();
            const double unix_s = seconds();
            std::vector<std::string> frames;
            for (std::string frame = text(); !frame.empty(); frame = text())
                frames.push_back(bytes_of(frame));
            const std::size_t count = frames.size();
            frames.resize(2);
            inbox->receive({count, frames[0], frames[1]}, now_s, unix_s, items);
        } else if (what == "reply") {
            now_s = seconds();
            const double unix_s = seconds();
            inbox->answer(bytes_of(text()), now_s, unix_s, items);
        } else if (what == "tick") {
            now_s = seconds();
            inbox->tick(now_s, items);
        } else {
            now_s = seconds();
            for (int count = std::stoi(text()); count > 0; --count)
                inbox->requests().sent();
        }
        std::cout << "{\"items\":[";
        bool is_first = true;
        while (const tactiled::Item* item = items.take()) {
            std::cout << (is_first ? "" : ",");
            print(*item, now_s);
            is_first = false;
        }
        std::cout << "],\"unsent\":[";
        is_first = true;
        for (const tactiled::Request& request : inbox->requests().unsent()) {
            std::string packed;
            request.pack(packed);
            std::cout << (is_first ? "" : ",") << quoted(hex_of(packed));
            is_first = false;
        }
        std::cout << "],\"fresh\":" << (inbox->is_fresh(now_s) ? "true" : "false")
                  << ",\"deadline_s\":" << number(inbox->deadline_s()) << ",\"counts\":[" << inbox->lost()
                  << "," << inbox->recovered() << "," << inbox->malformed() << "]}\n";
    }
}
